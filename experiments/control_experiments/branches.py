"""Twins of a drive from many of its moments on: the same state and the same commands, other ground under the wheels."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from safetensors.numpy import load_file, save_file

from offpiste.conventions import DT, HORIZON_STEPS
from offpiste.files import write_whole
from offpiste.progress import track
from offpiste.simulation.simulate import (
    FINAL_EVENTS,
    DriveSettings,
    Start,
    drive,
    on_other_ground,
    record,
    start_and_driver,
)
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.simulation.vehicle.vehicle import VehicleSimulation
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import World

TWIN_SEED = 1_000_003
"""Added to a world's seed for the world that lends its ground."""


@dataclass(frozen=True)
class Branches:
    """Where a vehicle is after `HORIZON_STEPS` on its own and on other ground, from the same states.

    Attributes:
        path: of the drive itself, px, py at 50 Hz in the world frame [m].
        step: at which the other ground begins.
        other: px, py on it after the horizon; NaN where the vehicle rolled over or left the world [m].
    """

    path: Float[np.ndarray, "N 2"]
    step: Int[np.ndarray, " n"]
    other: Float[np.ndarray, "n 2"]

    def difference(self) -> Float[np.ndarray, "n 2"]:
        """What the other ground does to the place after the horizon, in the world frame [m]."""
        return self.other - self.path[self.step + HORIZON_STEPS]


def twin_worlds(settings: DriveSettings) -> tuple[World, World]:
    """The world of a drive, and the same hills, trails and plants on other ground."""
    world = make_world(settings.world)
    return world, on_other_ground(world, make_world(replace(settings.world, seed=settings.world.seed + TWIN_SEED)))


def branches_of(settings: DriveSettings, world: World, ground: World, at: Int[np.ndarray, " n"]) -> Branches:
    """Drive once more, without sensors, and let a twin part from it at some steps, rising.

    Args:
        ground: the same world with other ground.
        at: steps after which the drive is too short are left out.
    """
    parameters, steps = load_vehicle(), round(settings.seconds / DT)
    start, driver = start_and_driver(world, parameters, seed=settings.seed, settings=settings.driver)
    samples = list(drive(world, parameters, start, driver, steps=steps))
    path = np.array([sample.position[:2] for sample in samples])
    commands = [sample.command for sample in samples]
    at = at[at + HORIZON_STEPS < len(path)]
    return Branches(path, at, _ends(world, ground, start, commands, at))


def _ends(
    world: World, ground: World, start: Start, commands: Sequence[np.ndarray], at: Int[np.ndarray, " n"]
) -> Float[np.ndarray, "n 2"]:
    vehicle = VehicleSimulation(world, load_vehicle(), x=start.x, y=start.y, yaw=start.yaw, speed=start.speed)
    ends, step = np.full((len(at), 2), np.nan), 0
    for number, parting in enumerate(track(at.tolist(), "twins")):
        for command in commands[step:parting]:
            vehicle.step(*command)
        step = parting
        twin = vehicle.branch(ground)
        twin.sample()  # clears the events so far
        for command in commands[step : step + HORIZON_STEPS]:
            twin.step(*command)
        sample = twin.sample()
        if not set(sample.events) & set(FINAL_EVENTS):
            ends[number] = sample.position[:2]
    return ends


def record_on(settings: DriveSettings, world: World, ground: World, log: Path) -> None:
    """Record a drive once more, seeing other ground than it drives on; a log that is there stays."""
    if log.exists():
        return
    parameters = load_vehicle()
    start, driver = start_and_driver(world, parameters, seed=settings.seed, settings=settings.driver)
    partial = log.with_name(f"{log.stem}.partial{log.suffix}")
    partial.unlink(missing_ok=True)
    partial.parent.mkdir(parents=True, exist_ok=True)
    record(settings, world, parameters, start, driver, partial, steps=round(settings.seconds / DT), seen=ground)
    partial.rename(log)


def save_branches(path: Path, result: Branches) -> None:
    """Write them whole or not at all."""
    arrays = {"path": result.path, "step": result.step, "other": result.other}
    write_whole(path, lambda partial: save_file(arrays, partial))


def load_branches(path: Path) -> Branches:
    """What `save_branches` wrote."""
    return Branches(**load_file(path))
