"""What a world is to everything that drives on it or looks at it: grids of nodes, trails and plants.

Presets of worlds, after the sites where the paper's vehicle drove (presets.toml).
"""

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib import resources

import msgspec
import numpy as np
from jaxtyping import Float

from offpiste.conventions import GROUND_KINDS, GROUND_PROPERTIES
from offpiste.errors import OffpisteError

__all__ = ["GROUND_KINDS", "GROUND_PROPERTIES", "Bushes", "Trees", "World", "WorldSettings"]


@dataclass(frozen=True)
class WorldSettings:
    """What a world is made from; the same settings make the same world.

    Attributes:
        preset: name of a preset (`offpiste.simulation.world.world`).
        seed: of everything random in it.
        grip_contrast: 1: ground as in grounds.toml; 0: all of it drives like the mean; between, in proportion.
        appearance_noise: how far light, shade, colour and texture vary for reasons that have nothing to do with grip.
        size: of the square [m].
        resolution: distance of the nodes [m].
    """

    preset: str = "mojave"
    seed: int = 0
    grip_contrast: float = 1.0
    appearance_noise: float = 1.0
    size: float = 320.0
    resolution: float = 0.25


@dataclass(frozen=True)
class Trees:
    """Obstacles.

    Attributes:
        foot: where the trunk leaves the ground, in the world frame [m].
        trunk_radius, crown_radius, height: [m].
    """

    foot: Float[np.ndarray, "n 3"]
    trunk_radius: Float[np.ndarray, " n"]
    crown_radius: Float[np.ndarray, " n"]
    height: Float[np.ndarray, " n"]


@dataclass(frozen=True)
class Bushes:
    """Plants that a vehicle can drive over at the price of a little drag.

    Attributes:
        foot: in the world frame [m].
        radius, height: [m].
        drag: force on a vehicle that drives through [N].
    """

    foot: Float[np.ndarray, "n 3"]
    radius: Float[np.ndarray, " n"]
    height: Float[np.ndarray, " n"]
    drag: Float[np.ndarray, " n"]


@dataclass(frozen=True)
class World:
    """A square of ground. Node [j, i] of a grid lies at (origin[0] + i resolution, origin[1] + j resolution).

    Attributes:
        origin: x, y of node [0, 0] in the world frame [m].
        resolution: distance of the nodes [m].
        elevation: [m].
        kinds: share of each of `GROUND_KINDS`; sums to 1.
        wetness: 0 dry ... 1 wet.
        properties: of `GROUND_PROPERTIES`, mixed from kinds and wetness, contrast applied.
        grass_height: of tall grass, 0 where there is none [m].
        trails: centre lines, in the order of driving [m].
    """

    settings: WorldSettings
    origin: tuple[float, float]
    resolution: float
    elevation: Float[np.ndarray, "ny nx"]
    kinds: Float[np.ndarray, "K ny nx"]
    wetness: Float[np.ndarray, "ny nx"]
    properties: Float[np.ndarray, "ny nx 4"]
    grass_height: Float[np.ndarray, "ny nx"]
    trees: Trees
    bushes: Bushes
    trails: tuple[Float[np.ndarray, "_ 2"], ...]


class Preset(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A kind of country.

    Attributes:
        hills: (grain [m], height [m]) of layers of smooth noise; a bump is about three grains wide.
        dunes: height of ridges with sharp crests [m].
        bank: height of steep steps in the open ground [m].
        ditch: depth of the ditches beside trails [m].
        rut: depth of the ruts [m].
        roughness: of the open ground [m].
        open_ground, trail_ground: shares of the kinds, about; they need not sum to 1.
        wetness: on average, 0..1.
        wetness_spread: its standard deviation, about.
        trees, bushes: a hectare.
        tree_height: (lowest, highest) [m].
        grass: share of the grassy ground with tall grass.
        grass_height: where it is tallest [m].
        grip: multiplies the grip contrast; 0: ground looks different but drives the same.
    """

    hills: tuple[tuple[float, float], ...]
    dunes: float
    bank: float
    ditch: float
    rut: float
    roughness: float
    open_ground: dict[str, float]
    trail_ground: dict[str, float]
    wetness: float
    wetness_spread: float
    trees: float
    bushes: float
    tree_height: tuple[float, float]
    grass: float
    grass_height: float
    grip: float = 1.0

    def __post_init__(self) -> None:
        unknown = {*self.open_ground, *self.trail_ground} - {*GROUND_KINDS}
        if unknown:
            raise ValueError(f"unknown ground {', '.join(sorted(unknown))}")


def load_preset(name: str) -> Preset:
    """A preset by its name.

    Raises:
        OffpisteError: there is none with this name.
    """
    if name not in _presets():
        raise OffpisteError(f"there is no world '{name}'", how=f"choose one of {', '.join(_presets())}")
    return _presets()[name]


def preset_names() -> tuple[str, ...]:
    """Names of all presets."""
    return tuple(_presets())


@cache
def _presets() -> dict[str, Preset]:
    text = resources.files("offpiste.simulation.world").joinpath("presets.toml").read_text(encoding="utf-8")
    return msgspec.convert(tomllib.loads(text), dict[str, Preset])
