"""A world: its settings and presets, and its grids, trails and plants.

The shipped worlds resemble the sites where the paper's vehicle drove; they are not based on measurements.
"""

import tomllib
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

import msgspec
import numpy as np
from jaxtyping import Float

from offpiste.core.errors import OffpisteError
from offpiste.core.field_names import suggestion
from offpiste.core.limits import parsed, read_small
from offpiste.core.registry import Registry
from offpiste.logs.ground_truth import GROUND_KINDS
from offpiste.simulation.world.grids import Axis, Grid, Line

Kind = TypeVar("Kind")


@dataclass(frozen=True)
class WorldSettings:
    """Settings of a world; the same settings make the same world."""

    preset: str = "mojave"  # name of a world in `WORLDS`, or path of a TOML file
    seed: int = 0
    grip_contrast: float = 1.0  # 1 uses grounds.toml; 0 uses the mean properties everywhere; interpolated in between
    appearance_noise: float = 1.0  # scale of variations of light, colour and texture that are unrelated to grip
    size: float = 320.0  # side of the square [m]
    resolution: float = 0.25  # distance between nodes [m]
    relief: float = 1.0  # factor on the height of hills
    forks: bool = False  # whether trails have forks (`world.forks`)

    @property
    def name(self) -> str:
        """Name of the preset, or of its file without folder and suffix."""
        return Path(self.preset).stem if self.preset.endswith(".toml") else self.preset


class BareTerrain(NamedTuple):
    """Terrain without plants."""

    x: Axis  # coordinates of the columns and rows [m]
    y: Axis
    elevation: Grid  # elevation of each node [m]
    trail_distance: Grid  # distance from each node to the centre line of the nearest trail [m]


@dataclass(frozen=True)
class Trees:
    """Trees, which are obstacles."""

    foot: Float[np.ndarray, "n 3"]  # foot of the trunk in the world frame [m]
    trunk_radius: Float[np.ndarray, " n"]  # [m]
    crown_radius: Float[np.ndarray, " n"]  # [m]
    height: Float[np.ndarray, " n"]  # [m]


@dataclass(frozen=True)
class Bushes:
    """Bushes, which slow a vehicle that drives through them."""

    foot: Float[np.ndarray, "n 3"]  # foot in the world frame [m]
    radius: Float[np.ndarray, " n"]  # [m]
    height: Float[np.ndarray, " n"]  # [m]
    drag: Float[np.ndarray, " n"]  # force on a vehicle that drives through the bush [N]


@dataclass(frozen=True)
class Fork:
    """Two ways of a trail between the same end points (`world.forks`)."""

    loop: int  # index of the trail that begins with the left way
    left: Float[np.ndarray, "n 2"]  # points of the ways [m]; the first and last points are shared
    right: Float[np.ndarray, "n 2"]
    muddy: int  # way through mud: 0 left, 1 right


@dataclass(frozen=True)
class World:
    """Square of ground; node [j, i] of its grids lies at (origin[0] + i resolution, origin[1] + j resolution)."""

    settings: WorldSettings
    origin: tuple[float, float]  # x, y of node [0, 0] in the world frame [m]
    resolution: float  # distance between nodes [m]
    elevation: Grid  # height of the ground [m]
    kinds: Float[np.ndarray, "K ny nx"]  # shares of `logs.ground_truth.GROUND_KINDS`, which sum to 1
    wetness: Grid  # 0 dry ... 1 wet
    properties: Float[np.ndarray, "ny nx 4"]  # values of `logs.ground_truth.GROUND_PROPERTIES` after grip contrast
    grass_height: Grid  # height of tall grass, 0 where there is none [m]
    trees: Trees
    bushes: Bushes
    trails: tuple[Line, ...]  # centre lines in driving order [m]
    forks: tuple[Fork, ...] = ()  # forks of the trails


_RANGES: Final = {
    **dict.fromkeys(("dunes", "bank", "ditch", "rut", "roughness"), (0.0, 50.0)),
    **dict.fromkeys(("wetness", "wetness_spread", "grass"), (0.0, 1.0)),
    **dict.fromkeys(("trees", "bushes"), (0.0, 2000.0)),
    "grass_height": (0.0, 10.0),
    "grip": (0.0, 5.0),
}
"""Allowed ranges of a preset's values, in its units."""


class WorldPreset(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Landscape of a world; the seed decides everything else."""

    # Layers of smooth noise: (grain [m], height [m]); a bump is about three grains wide
    hills: tuple[tuple[float, float], ...]
    dunes: float  # height of ridges with sharp crests [m]
    bank: float  # height of steep steps in open ground [m]
    ditch: float  # depth of ditches beside trails [m]
    rut: float  # depth of ruts [m]
    roughness: float  # standard deviation of unevenness in open ground [m]
    open_ground: dict[str, float]  # approximate shares of kinds of ground; they need not sum to 1
    trail_ground: dict[str, float]
    wetness: float  # mean wetness, 0..1
    wetness_spread: float  # approximate standard deviation of the wetness
    trees: float  # number per hectare
    bushes: float  # number per hectare
    tree_height: tuple[float, float]  # lowest and highest [m]
    grass: float  # share of grassy ground with tall grass
    grass_height: float  # height of the tallest grass [m]
    grip: float = 1.0  # factor on the grip contrast; at 0, kinds of ground look different but drive the same

    def __post_init__(self) -> None:
        unknown = {*self.open_ground, *self.trail_ground} - {*GROUND_KINDS}
        if unknown:
            raise ValueError(f"unknown ground {', '.join(sorted(unknown))}; known are {', '.join(GROUND_KINDS)}")
        for name, (low, high) in _RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name} must be between {low:g} and {high:g}, not {value:g}")
        if not all(1 <= grain <= 1000 and abs(height) <= 100 for grain, height in self.hills):
            raise ValueError("hills must be pairs of a grain (1 to 1000 m) and a height (at most 100 m)")
        if not 0 < self.tree_height[0] <= self.tree_height[1] <= 100:
            raise ValueError("tree_height must be a lowest and a highest value from 0 to 100 m")
        for shares in (self.open_ground, self.trail_ground):
            if not (all(0 <= share <= 1e3 for share in shares.values()) and sum(shares.values()) > 0):
                raise ValueError("shares of open_ground and trail_ground must be non-negative and not all 0")


def read_toml(file: Path | Traversable, kind: type[Kind], what: str, example: str) -> Kind:
    """Read a TOML file of a world or a vehicle.

    Raises:
        OffpisteError: the file is missing or not TOML, or a key is missing, unknown or wrong.
    """
    try:
        return msgspec.convert(parsed(read_small(file), tomllib.loads), kind)
    except OSError as error:
        raise OffpisteError(f"cannot read the {what}: {error.strerror}", where=str(file)) from error
    except msgspec.ValidationError as error:
        how = f"{suggestion(error, kind)}compare with offpiste/simulation/{example}"
        raise OffpisteError(f"{error}".replace("$.", ""), where=str(file), how=how) from error
    except ValueError as error:
        raise OffpisteError(f"not TOML: {error}", where=str(file)) from error


def read_world_preset(file: Path | Traversable) -> WorldPreset:
    """Read a world preset from a TOML file; errors as in `read_toml`."""
    return read_toml(file, WorldPreset, "world", "world/presets/mojave.toml")


WORLDS: Final[Registry[WorldPreset]] = Registry("world")
"""World presets by name."""

for _file in sorted(resources.files(__package__).joinpath("presets").iterdir(), key=lambda file: file.name):
    WORLDS.register(_file.name.removesuffix(".toml"))(read_world_preset(_file))


def find_world_preset(world: str) -> WorldPreset:
    """Return the preset of a world, given by name or by the path of a TOML file (`read_toml`)."""
    if world.endswith(".toml"):
        return read_world_preset(Path(world))
    if Path(world).suffix and world not in WORLDS:
        how = f"give a TOML file, or one of: {', '.join(WORLDS)}"
        raise OffpisteError(f"no world '{world}', and no TOML file", how=how)
    return WORLDS[world]
