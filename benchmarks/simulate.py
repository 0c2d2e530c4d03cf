"""How much faster than real time the proving ground runs: medians over several runs, on a world with hills.

`python benchmarks/simulate.py [--seconds 20] [--runs 5]`. The vehicle alone: rigid bodies, tyres, drive train and a
sample every 0.02 s.
"""

import argparse
import statistics
import time

import numpy as np

from offpiste.conventions import DT
from offpiste.simulation.build import make_world
from offpiste.simulation.parameters import load_vehicle
from offpiste.simulation.vehicle import VehicleSimulation
from offpiste.simulation.world import World, WorldSettings


def physics(world: World, seconds: float, *, sampled: bool) -> float:
    """Real time over computing time of a vehicle that circles at moderate speed."""
    x, y = np.array(world.origin) + world.settings.size / 2
    vehicle = VehicleSimulation(world, load_vehicle(), x=float(x), y=float(y), yaw=0.0, speed=5.0)
    begin = time.perf_counter()
    for _ in range(round(seconds / DT)):
        vehicle.step(0.3, 0.0, 0.4)
        if sampled:
            vehicle.sample()
    return seconds / (time.perf_counter() - begin)


def main() -> None:
    """Print a line a part."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="of driving in a run")
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    world = make_world(WorldSettings(preset="mojave"))
    physics(world, DT, sampled=True)  # compiles
    for name, sampled in (("physics alone", False), ("physics and samples", True)):
        ratios = [physics(world, options.seconds, sampled=sampled) for _ in range(options.runs)]
        spread = f"{min(ratios):.0f} to {max(ratios):.0f} in {options.runs} runs"
        print(f"{name:20} {statistics.median(ratios):6.0f} x real time ({spread})")


if __name__ == "__main__":
    main()
