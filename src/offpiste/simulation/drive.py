"""A drive: the vehicle and its controller in lockstep, one sample every `conventions.DT`."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from offpiste.simulation.driver.driver import Driver, DriverSettings
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.vehicle.parameters import VehicleParameters
from offpiste.simulation.vehicle.vehicle import VehicleSimulation
from offpiste.simulation.world.world import World

FINAL_EVENTS = ("rollover", "left the world")
"""Events that end a drive."""

STUCK = "stuck"
"""Event of a controller that gives up."""


@runtime_checkable
class Controller(Protocol):
    """A driver, a planner, or recorded commands."""

    @property
    def stuck(self) -> bool:
        """Whether it has given up."""
        ...

    def command(self, sample: VehicleSample) -> Float[np.ndarray, " 3"]:
        """Throttle [0..1], brake [0..1], steer [-1..1, + left] for the next `conventions.DT`."""
        ...


@dataclass(frozen=True)
class Start:
    """Start of a drive: x, y [m], yaw [rad], speed forwards [m/s]."""

    x: float
    y: float
    yaw: float
    speed: float


@dataclass
class Replay:
    """Commands of another drive, open loop."""

    commands: Float[np.ndarray, "N 3"]
    stuck: bool = False
    _row: int = 0

    def command(self, sample: VehicleSample) -> Float[np.ndarray, " 3"]:
        """The next recorded command; gives up after the last."""
        command = self.commands[self._row]
        self._row = min(self._row + 1, len(self.commands) - 1)
        return command


def drive(
    world: World, parameters: VehicleParameters, start: Start, controller: Controller, *, steps: int
) -> Iterator[VehicleSample]:
    """Samples of a drive; it ends early after a rollover, at the world's border, or if the controller gives up."""
    vehicle = VehicleSimulation(world, parameters, x=start.x, y=start.y, yaw=start.yaw, speed=start.speed)
    for _ in range(steps):
        sample = vehicle.sample()
        command = controller.command(sample)
        stuck = (STUCK,) if controller.stuck else ()
        yield replace(sample, command=command, events=sample.events + stuck)
        if stuck or set(sample.events) & set(FINAL_EVENTS):
            return
        vehicle.step(*command)


def start_and_driver(
    world: World, parameters: VehicleParameters, *, seed: int, settings: DriverSettings | None = None
) -> tuple[Start, Driver]:
    """A driver on a trail of a world."""
    driver = Driver(world, parameters, np.random.default_rng([seed, 0xD21]), settings)
    return Start(*driver.start()), driver


def on_other_ground(world: World, other: World) -> World:
    """A world's hills, trails and plants on the ground of another world of the same size: for twins.

    Raises:
        ValueError: the worlds' grids differ.
    """
    if world.elevation.shape != other.elevation.shape or world.resolution != other.resolution:
        raise ValueError("twins need worlds of one size and resolution")
    return replace(world, kinds=other.kinds, wetness=other.wetness, properties=other.properties)
