"""Presets of worlds, after the sites where the paper's vehicle drove (presets.toml)."""

import tomllib
from functools import cache
from importlib import resources

import msgspec

from offpiste.errors import OffpisteError
from offpiste.simulation.world import GROUND_KINDS


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
    text = resources.files("offpiste.simulation").joinpath("presets.toml").read_text(encoding="utf-8")
    return msgspec.convert(tomllib.loads(text), dict[str, Preset])
