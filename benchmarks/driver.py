"""How the proving ground's driver drives, by world: how drives end, speed, changes of ground, sliding.

`python benchmarks/driver.py [--seeds 301 302 303 304 305] [--seconds 120]`: one drive for each world and seed, without
sensors. Windows are the 5 s stretches that start above 1.5 m/s. A window changes ground when a wheel's main kind of
ground at some moment differs from that wheel's at the start. The share of sliding is that of the moments above 1.5 m/s
at which some wheel's slip angle exceeds 0.2 rad.
"""

import argparse
from collections import Counter
from collections.abc import Sequence

import numpy as np

from offpiste.conventions import DT, HORIZON_STEPS, MIN_EVALUATION_SPEED
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.simulate import FINAL_EVENTS, STUCK, drive, start_and_driver
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import WorldSettings

WORLDS = ("mojave", "halter-ranch", "coastal-scrub", "dunes")
SLIDING = 0.2
"""Slip angle from which a wheel counts as sliding [rad]."""


def samples_of_drive(world_name: str, seed: int, seconds: float) -> list[VehicleSample]:
    """A drive in a world of its own."""
    world, parameters = make_world(WorldSettings(world_name, seed)), load_vehicle()
    start, driver = start_and_driver(world, parameters, seed=seed)
    return list(drive(world, parameters, start, driver, steps=round(seconds / DT)))


def ending(samples: Sequence[VehicleSample]) -> str:
    """The event that ended a drive, or `complete`."""
    return next((event for event in samples[-1].events if event in (*FINAL_EVENTS, STUCK)), "complete")


def figures_of_drive(samples: Sequence[VehicleSample]) -> dict[str, np.ndarray]:
    """Speed at every moment, sliding at those of motion, distance and change of ground of every window."""
    position = np.array([s.position[:2] for s in samples])
    speed = np.array([np.hypot(*s.velocity[:2]) for s in samples])
    kind = np.array([s.truth.kind for s in samples])
    slip = np.array([np.abs(s.truth.slip_angle).max() for s in samples])
    travelled = np.append(0.0, np.cumsum(np.hypot(*np.diff(position, axis=0).T)))
    starts = np.flatnonzero(speed[:-HORIZON_STEPS] > MIN_EVALUATION_SPEED)
    return {
        "speed": speed,
        "sliding": slip[speed > MIN_EVALUATION_SPEED] > SLIDING,
        "distance": travelled[starts + HORIZON_STEPS] - travelled[starts],
        "changes": np.array([(kind[t : t + HORIZON_STEPS + 1] != kind[t]).any() for t in starts], bool),
    }


def report(world_name: str, drives: Sequence[Sequence[VehicleSample]]) -> str:
    """A line for one world."""
    ends = Counter(ending(samples) for samples in drives)
    each = [figures_of_drive(samples) for samples in drives]
    all_of = {name: np.concatenate([figures[name] for figures in each]) for name in each[0]}
    return (
        f"{world_name:14} {', '.join(f'{count} {end}' for end, count in ends.items())}; "
        f"median {np.median(all_of['speed']):.1f} m/s, {np.median(all_of['distance']):.0f} m in 5 s; "
        f"{100 * all_of['changes'].mean():.0f} % of the windows change ground; "
        f"a wheel slides {100 * all_of['sliding'].mean():.0f} % of the time"
    )


def main() -> None:
    """Print a line for each world."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[301, 302, 303, 304, 305])
    parser.add_argument("--seconds", type=float, default=120.0)
    options = parser.parse_args()
    for world_name in WORLDS:
        drives = [samples_of_drive(world_name, seed, options.seconds) for seed in options.seeds]
        print(report(world_name, drives), flush=True)


if __name__ == "__main__":
    main()
