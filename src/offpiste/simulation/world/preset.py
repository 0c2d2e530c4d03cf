"""Worlds by name: those that ship (`presets/NAME.toml`), registered ones, and TOML files of one's own.

The shipped worlds follow the sites where the paper's vehicle drove. They are made to look and drive like such country;
nothing was measured there.
"""

import tomllib
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Final

import msgspec

from offpiste.errors import OffpisteError
from offpiste.logs.ground_truth import GROUND_KINDS
from offpiste.registry import Registry


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


def read_world_preset(file: Path | Traversable) -> WorldPreset:
    """A world preset from a TOML file.

    Raises:
        OffpisteError: the file is missing, is not TOML, or a key is missing, unknown or wrong.
    """
    try:
        return msgspec.convert(tomllib.loads(file.read_text(encoding="utf-8")), WorldPreset)
    except OSError as error:
        raise OffpisteError(f"cannot read the world: {error.strerror}", where=str(file)) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise OffpisteError(f"not TOML: {error}", where=str(file)) from error
    except msgspec.ValidationError as error:
        how = "see docs/proving-ground.md, or copy one from offpiste/simulation/world/presets"
        raise OffpisteError(f"{error}".replace("$.", ""), where=str(file), how=how) from error


WORLDS: Final[Registry[WorldPreset]] = Registry("world")
"""World presets by name."""

for _file in sorted(resources.files(__package__).joinpath("presets").iterdir(), key=lambda file: file.name):
    WORLDS.register(_file.name.removesuffix(".toml"))(read_world_preset(_file))


def find_world_preset(world: str) -> WorldPreset:
    """The preset of a world that is given by its name, or by the path of a TOML file.

    Raises:
        OffpisteError: there is no such name or file, or the file is wrong.
    """
    return read_world_preset(Path(world)) if world.endswith(".toml") else WORLDS[world]
