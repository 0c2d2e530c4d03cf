"""How the proving ground's driver drives, by world: how drives end, speed, changes of ground, sliding.

`python benchmarks/driver.py [--seeds 301 302 303 304 305] [--seconds 120] [--manoeuvres]`: one drive for each world and
seed, without sensors, and the share of the time by forward speed of them all. Windows are the 5 s stretches that start
above 1.5 m/s. A window changes ground when a wheel's main kind of ground at some moment differs from that wheel's at
the start. The share of sliding is that of the moments above 1.5 m/s at which some wheel's slip angle exceeds 0.2 rad.
"""

import argparse
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from offpiste.conventions import DT, HORIZON_STEPS, MIN_EVALUATION_SPEED
from offpiste.simulation.driver.driver import WITH_MANOEUVRES, pose_and_speed
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.simulate import FINAL_EVENTS, STUCK, drive, start_and_driver
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import WorldSettings

WORLDS = ("mojave", "halter-ranch", "coastal-scrub", "dunes")
SLIDING = 0.2
"""Slip angle from which a wheel counts as sliding [rad]."""
STANDING = 0.1
"""Speed up to which a vehicle stands [m/s]."""
SPEEDS = (1.5, 4.0, 8.0, 12.0, 16.0)
"""Limits of the bands of forward speed [m/s]."""


def samples_of_drive(world_name: str, seed: int, seconds: float, *, manoeuvres: bool = False) -> list[VehicleSample]:
    """A drive in a world of its own."""
    world, parameters = make_world(WorldSettings(world_name, seed)), load_vehicle()
    start, driver = start_and_driver(world, parameters, seed=seed, settings=WITH_MANOEUVRES if manoeuvres else None)
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


def shares_by_speed(drives: Sequence[Sequence[VehicleSample]]) -> str:
    """Share of the time by forward speed, and the highest, of all drives together."""
    speed = np.array([pose_and_speed(sample)[3] for samples in drives for sample in samples])
    edges = (STANDING, *SPEEDS)
    shares = {"standing": np.abs(speed) <= STANDING, "reverse": speed < -STANDING} | {
        f"{low:g} to {high:g} m/s": (speed > low) & (speed <= high) for low, high in pairwise(edges)
    }
    bands = ", ".join(f"{name} {100 * band.mean():.1f} %" for name, band in shares.items())
    return f"{len(speed) * DT:.0f} s: {bands}; {speed.max():.1f} m/s at the most"


def main() -> None:
    """Print a line for each world, and one for all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[301, 302, 303, 304, 305])
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--manoeuvres", action="store_true")
    options = parser.parse_args()
    every: list[list[VehicleSample]] = []
    for world_name in WORLDS:
        drives = [
            samples_of_drive(world_name, seed, options.seconds, manoeuvres=options.manoeuvres) for seed in options.seeds
        ]
        print(report(world_name, drives), flush=True)
        every += drives
    print(shares_by_speed(every))


if __name__ == "__main__":
    main()
