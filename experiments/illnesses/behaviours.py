"""Ways in which a vehicle is driven, all of them healthy: each is a ground and a driver."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final, TypeVar

import numpy as np

from experiments.illnesses.drivers import Pausing, Weaving
from offpiste.simulation.driver.driver import DriverSettings
from offpiste.simulation.simulate import Controller, Start, start_and_driver
from offpiste.simulation.vehicle.parameters import VehicleParameters
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import Bushes, Trees, World, WorldSettings

_PRESETS: Final = ("mojave", "halter-ranch", "coastal-scrub", "dunes", "uniform")
Plants = TypeVar("Plants", Trees, Bushes)

_SIZE, _RESOLUTION = 260.0, 0.35
"""Side of a world and spacing of its nodes [m]: enough for a drive of minutes, and quickly built."""


@dataclass(frozen=True)
class Behaviour:
    """A way of driving.

    Attributes:
        share: of the drives.
        ground: changes a world of the proving ground.
        driver: a start and a controller on that ground.
    """

    share: float
    ground: Callable[[World, np.random.Generator], World]
    driver: Callable[[World, VehicleParameters, np.random.Generator], tuple[Start, Controller]]


def _as_it_is(world: World, random: np.random.Generator) -> World:
    return world


def _slippery(world: World, random: np.random.Generator) -> World:
    """Uniform grip between ice and wet grass."""
    properties = world.properties.copy()
    properties[..., 0] = random.uniform(0.15, 0.35)
    properties[..., 1] = random.uniform(1.5, 4.0)
    return replace(world, properties=properties)


def _bumpy(world: World, random: np.random.Generator) -> World:
    """Bumps of a few centimetres, about a metre apart."""
    bumps = random.standard_normal(tuple(-(-n // 2) for n in world.elevation.shape)).repeat(2, 0).repeat(2, 1)
    ny, nx = world.elevation.shape
    return replace(world, elevation=world.elevation + random.uniform(0.015, 0.035) * bumps[:ny, :nx])


def _open_pad(world: World, random: np.random.Generator) -> World:
    """Nearly level ground without plants."""
    return replace(world, elevation=0.15 * world.elevation, trees=_none_of(world.trees), bushes=_none_of(world.bushes))


def _slippery_pad(world: World, random: np.random.Generator) -> World:
    return _slippery(_open_pad(world, random), random)


def _none_of(plants: Plants) -> Plants:
    return replace(plants, **{name: values[:0] for name, values in vars(plants).items()})


def _on_trails(
    speed: tuple[float, float], **settings: float
) -> Callable[[World, VehicleParameters, np.random.Generator], tuple[Start, Controller]]:
    def driver(world: World, vehicle: VehicleParameters, random: np.random.Generator) -> tuple[Start, Controller]:
        hard = random.uniform(4.0, 8.0)
        median = random.uniform(*speed)
        chosen = DriverSettings(
            median_speed=median,
            top_speed=min(2 * median + 1, 14.0),
            cornering=(0.5 * hard, hard),
            pause=random.uniform(2.5, 8.0),
            **settings,  # type: ignore[arg-type]
        )
        return start_and_driver(world, vehicle, seed=int(random.integers(1 << 30)), settings=chosen)

    return driver


def _stopping(world: World, vehicle: VehicleParameters, random: np.random.Generator) -> tuple[Start, Controller]:
    start, driver = start_and_driver(world, vehicle, seed=int(random.integers(1 << 30)))
    return start, Pausing(driver, random)


def _weaving(
    bends: tuple[float, float], lateral: tuple[float, float], reverse_every: float = 0.0
) -> Callable[[World, VehicleParameters, np.random.Generator], tuple[Start, Controller]]:
    def driver(world: World, vehicle: VehicleParameters, random: np.random.Generator) -> tuple[Start, Controller]:
        x, y = random.uniform(-20, 20, 2)
        start = Start(x, y, random.uniform(-np.pi, np.pi), 0.0 if reverse_every else 3.0)
        weaving = Weaving(
            vehicle,
            random,
            bends=bends,
            lateral=random.uniform(*lateral),
            fastest=random.uniform(6.0, 12.0),
            reverse_every=reverse_every,
        )
        return start, weaving

    return driver


BEHAVIOURS: Final[dict[str, Behaviour]] = {
    "ordinary": Behaviour(0.40, _as_it_is, _on_trails((3.5, 7.5))),
    "slow": Behaviour(0.08, _as_it_is, _on_trails((1.0, 1.8))),
    "bumpy": Behaviour(0.08, _bumpy, _on_trails((3.0, 6.0))),
    "standing": Behaviour(0.10, _as_it_is, _stopping),
    "wheel spin": Behaviour(0.08, _slippery, _on_trails((3.0, 6.0))),
    "drifting": Behaviour(0.08, _slippery_pad, _weaving((0.2, 0.9), (3.0, 6.0))),
    "cornering": Behaviour(0.10, _open_pad, _weaving((0.5, 1.0), (3.5, 7.0))),
    "reversing": Behaviour(0.08, _open_pad, _weaving((0.1, 0.8), (2.0, 4.0), reverse_every=12.0)),
}
"""Behaviours by name."""


@lru_cache(maxsize=1)
def world_of(number: int) -> World:
    """A world of the proving ground; the last one is kept, so that drives in the same world follow each other."""
    preset = _PRESETS[number % len(_PRESETS)]
    return make_world(WorldSettings(preset=preset, seed=100 + number, size=_SIZE, resolution=_RESOLUTION))
