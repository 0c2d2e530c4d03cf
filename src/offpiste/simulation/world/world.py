"""A world: its settings and presets, and the grids, trails and plants that everything drives on and looks at.

The shipped worlds follow the sites where the paper's vehicle drove. They are made to look and drive like such country;
nothing was measured there.
"""

import tomllib
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np
from jaxtyping import Float

from offpiste.core.errors import OffpisteError
from offpiste.core.field_names import suggestion
from offpiste.core.limits import parsed, read_small
from offpiste.core.registry import Registry
from offpiste.logs.ground_truth import GROUND_KINDS


@dataclass(frozen=True)
class WorldSettings:
    """Settings of a world; the same settings make the same world.

    Attributes:
        preset: a world's name (`preset.WORLDS`), or the path of a TOML file.
        seed: seed of everything random in it.
        grip_contrast: 1: ground as in grounds.toml; 0: all of it drives like the mean; between, in proportion.
        appearance_noise: how far light, shade, colour and texture vary for reasons that have nothing to do with grip.
        size: side of the square [m].
        resolution: distance between nodes [m].
        relief: factor of the height of hills.
        forks: whether trails part into two ways, one of them through mud (`world.forks`).
    """

    preset: str = "mojave"
    seed: int = 0
    grip_contrast: float = 1.0
    appearance_noise: float = 1.0
    size: float = 320.0
    resolution: float = 0.25
    relief: float = 1.0
    forks: bool = False

    @property
    def name(self) -> str:
        """The world's name: that of its preset, or its file's without folder and suffix."""
        return Path(self.preset).stem if self.preset.endswith(".toml") else self.preset


class BareTerrain(NamedTuple):
    """Terrain before anything grows on it.

    Attributes:
        x, y: places of the nodes [m].
        elevation: of each node [m].
        trail_distance: from each node to the middle of the nearest trail [m].
    """

    x: Float[np.ndarray, " nx"]
    y: Float[np.ndarray, " ny"]
    elevation: Float[np.ndarray, "ny nx"]
    trail_distance: Float[np.ndarray, "ny nx"]


@dataclass(frozen=True)
class Trees:
    """Trees: obstacles.

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
    """Bushes: plants that a vehicle can drive through with a little drag.

    Attributes:
        foot: where they stand, in the world frame [m].
        radius, height: [m].
        drag: force on a vehicle that drives through one [N].
    """

    foot: Float[np.ndarray, "n 3"]
    radius: Float[np.ndarray, " n"]
    height: Float[np.ndarray, " n"]
    drag: Float[np.ndarray, " n"]


@dataclass(frozen=True)
class Fork:
    """Two ways of a trail between the same two points (`world.forks`).

    Attributes:
        loop: index of the trail that begins with the left way.
        left, right: points of the ways, the first and the last in common [m].
        muddy: the way through mud: 0 left, 1 right.
    """

    loop: int
    left: Float[np.ndarray, "n 2"]
    right: Float[np.ndarray, "n 2"]
    muddy: int


@dataclass(frozen=True)
class World:
    """A square of ground; node [j, i] of its grids lies at (origin[0] + i resolution, origin[1] + j resolution).

    Attributes:
        origin: x, y of node [0, 0] in the world frame [m].
        resolution: distance between nodes [m].
        elevation: height of the ground [m].
        kinds: share of each of `logs.ground_truth.GROUND_KINDS`; they sum to 1.
        wetness: 0 dry ... 1 wet.
        properties: values of `logs.ground_truth.GROUND_PROPERTIES`, mixed from kinds and wetness, contrast applied.
        grass_height: height of tall grass, 0 where there is none [m].
        trails: centre lines, in the order of driving [m].
        forks: where trails part into two ways.
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
    forks: tuple[Fork, ...] = ()


_RANGES: Final = {
    **dict.fromkeys(("dunes", "bank", "ditch", "rut", "roughness"), (0.0, 50.0)),
    **dict.fromkeys(("wetness", "wetness_spread", "grass"), (0.0, 1.0)),
    **dict.fromkeys(("trees", "bushes"), (0.0, 2000.0)),
    "grass_height": (0.0, 10.0),
    "grip": (0.0, 5.0),
}
"""Smallest and largest values of a preset, in its units."""


class WorldPreset(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a world's landscape is made of; the seed decides on everything else.

    Attributes:
        hills: (grain [m], height [m]) of layers of smooth noise; a bump is about three grains wide.
        dunes: height of ridges with sharp crests [m].
        bank: height of steep steps in the open ground [m].
        ditch: depth of the ditches beside trails [m].
        rut: depth of the ruts [m].
        roughness: standard deviation of the open ground's unevenness [m].
        open_ground, trail_ground: approximate shares of the kinds of ground; they need not sum to 1.
        wetness: mean, 0..1.
        wetness_spread: approximate standard deviation of the wetness.
        trees, bushes: number per hectare.
        tree_height: lowest, highest [m].
        grass: share of the grassy ground with tall grass.
        grass_height: height of the tallest grass [m].
        grip: factor of the grip contrast; 0: ground looks different but drives the same.
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
            raise ValueError(f"unknown ground {', '.join(sorted(unknown))}; known are {', '.join(GROUND_KINDS)}")
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name} is {value:g}, not between {low:g} and {high:g}")
        if not all(1 <= grain <= 1000 and abs(height) <= 100 for grain, height in self.hills):
            raise ValueError("hills are pairs of a grain from 1 to 1000 m and a height of at most 100 m")
        if not 0 < self.tree_height[0] <= self.tree_height[1] <= 100:
            raise ValueError("tree_height is not a lowest and a highest from 0 to 100 m")
        for shares in (self.open_ground, self.trail_ground):
            if not (all(0 <= share <= 1e3 for share in shares.values()) and sum(shares.values()) > 0):
                raise ValueError("shares of open_ground and trail_ground are numbers from 0 on, and not all 0")


def read_world_preset(file: Path | Traversable) -> WorldPreset:
    """A world preset from a TOML file.

    Raises:
        OffpisteError: the file is missing, is not TOML, or a key is missing, unknown or wrong.
    """
    try:
        return msgspec.convert(parsed(read_small(file), tomllib.loads), WorldPreset)
    except OSError as error:
        raise OffpisteError(f"cannot read the world: {error.strerror}", where=str(file)) from error
    except msgspec.ValidationError as error:
        how = "see docs/proving-ground.md, or copy one from offpiste/simulation/world/presets"
        how = f"{suggestion(error, WorldPreset)}{how}"
        raise OffpisteError(f"{error}".replace("$.", ""), where=str(file), how=how) from error
    except ValueError as error:
        raise OffpisteError(f"not TOML: {error}", where=str(file)) from error


WORLDS: Final[Registry[WorldPreset]] = Registry("world")
"""World presets by name."""

for _file in sorted(resources.files(__package__).joinpath("presets").iterdir(), key=lambda file: file.name):
    WORLDS.register(_file.name.removesuffix(".toml"))(read_world_preset(_file))


def find_world_preset(world: str) -> WorldPreset:
    """The preset of a world that is given by its name, or by the path of a TOML file.

    Raises:
        OffpisteError: there is no such name or file, or the file is wrong.
    """
    if world.endswith(".toml"):
        return read_world_preset(Path(world))
    if Path(world).suffix and world not in WORLDS:
        how = f"give a TOML file, or one of: {', '.join(WORLDS)}"
        raise OffpisteError(f"no world '{world}', and no TOML file", how=how)
    return WORLDS[world]
