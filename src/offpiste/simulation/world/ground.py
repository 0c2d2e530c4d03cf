"""Kinds of ground: where they lie, and their properties (grounds.toml)."""

import tomllib
from functools import cache
from importlib import resources

import msgspec
import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter

from offpiste.logs.ground_truth import GROUND_KINDS, GROUND_PROPERTIES
from offpiste.simulation.world.noise import smooth_noise, smooth_step
from offpiste.simulation.world.terrain import HALF_WIDTH
from offpiste.simulation.world.world import BareTerrain, WorldPreset

PATCH_GRAIN = 13.0
"""Grain of the patches [m]: the ground changes every 8 to 25 m."""

SHARPNESS = 20.0
"""Sharpness of the borders between kinds, which are about 1 m wide."""

_GUMBEL = np.sqrt(6) / np.pi
"""Scale of the Gumbel distribution with variance 1: with it, the largest of noise + scale log(w) has share about w."""


class Property(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One property of one kind of ground at wetness 0 and 1, with the source of the numbers."""

    dry: float
    wet: float
    source: str


class Colour(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """sRGB [0..1] at wetness 0 and 1."""

    dry: tuple[float, float, float]
    wet: tuple[float, float, float]


class GroundKind(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One kind of ground: a table of grounds.toml, which explains the entries."""

    friction: Property
    cornering_stiffness: Property
    rolling_resistance: Property
    sinkage_drag: Property
    colour: Colour
    likes_water: float


@cache
def grounds() -> tuple[GroundKind, ...]:
    """All kinds of ground, in the order of `GROUND_KINDS`."""
    text = resources.files("offpiste.simulation.world").joinpath("grounds.toml").read_text(encoding="utf-8")
    rows = msgspec.convert(tomllib.loads(text), dict[str, GroundKind])
    return tuple(rows[kind] for kind in GROUND_KINDS)


def property_table() -> Float[np.ndarray, "2 K 4"]:
    """Properties of each kind of ground, dry and wet."""
    properties = [[getattr(ground, name) for name in GROUND_PROPERTIES] for ground in grounds()]
    return np.array([[[p.dry for p in row] for row in properties], [[p.wet for p in row] for row in properties]])


def colour_table() -> Float[np.ndarray, "2 K 3"]:
    """Colours of each kind of ground, dry and wet, sRGB [0..1]."""
    return np.array([[g.colour.dry for g in grounds()], [g.colour.wet for g in grounds()]])


def lay_grounds(
    rng: np.random.Generator,
    preset: WorldPreset,
    bare: BareTerrain,
) -> tuple[Float[np.ndarray, "K ny nx"], Float[np.ndarray, "ny nx"]]:
    """Shares of the kinds at each node (they sum to 1), and wetness 0..1.

    Every kind has its own smooth noise; at each place the strongest wins, softly. Open ground and trails differ in how
    often a kind wins, not in where its patches lie.
    """
    x, y, elevation, trail_distance = bare
    water = _water(rng, preset, x, y, elevation)
    edge = trail_distance + 0.35 * smooth_noise(rng, x, y, 1.5)
    on_trail = smooth_step(edge, HALF_WIDTH + 0.6, HALF_WIDTH - 0.4)
    open_weight, trail_weight = (
        _GUMBEL * np.log(np.maximum([mix.get(kind, 0.0) for kind in GROUND_KINDS], 1e-4))
        for mix in (preset.open_ground, preset.trail_ground)
    )
    kinds = np.empty((len(GROUND_KINDS), len(y), len(x)), np.float32)
    for k, ground in enumerate(grounds()):
        kinds[k] = smooth_noise(rng, x, y, PATCH_GRAIN) + 0.10 * smooth_noise(rng, x, y, 1.5)
        kinds[k] += ground.likes_water * (water - preset.wetness)
        kinds[k] += np.float32(open_weight[k]) + np.float32(trail_weight[k] - open_weight[k]) * on_trail
    _soft_maximum(kinds)
    wetness = water + np.float32(0.1) * weighted_sum(kinds, np.array([ground.likes_water for ground in grounds()]))
    return kinds, np.clip(wetness, 0, 1).astype(np.float32)


def mix_properties(
    kinds: Float[np.ndarray, "K ny nx"], wetness: Float[np.ndarray, "ny nx"], contrast: float
) -> Float[np.ndarray, "ny nx 4"]:
    """Properties of mixed ground.

    Args:
        kinds: shares; sum to 1.
        contrast: 1 as in the table; 0: everywhere the mean over the table's kinds, half wet; between, in proportion.
    """
    table = property_table()
    mean = table.mean(axis=(0, 1))
    # Deviations from the mean are mixed, so that without contrast not even rounding tells the kinds apart.
    dry, wet = (contrast * (table - mean)).astype(np.float32)
    mixed = np.empty((*wetness.shape, len(GROUND_PROPERTIES)), np.float32)
    for p in range(len(GROUND_PROPERTIES)):
        mixed[..., p] = np.float32(mean[p]) + weighted_sum(kinds, dry[:, p])
        mixed[..., p] += wetness * weighted_sum(kinds, wet[:, p] - dry[:, p])
    return mixed


def weighted_sum(kinds: Float[np.ndarray, "K ny nx"], weights: Float[np.ndarray, " K"]) -> Float[np.ndarray, "ny nx"]:
    """Sum over the kinds, in their order: a matrix product's last bits would depend on the number of threads."""
    total = np.zeros(kinds.shape[1:], np.float32)
    for share, weight in zip(kinds, weights, strict=True):
        total += np.float32(weight) * share
    return total


def _water(
    rng: np.random.Generator,
    preset: WorldPreset,
    x: Float[np.ndarray, " nx"],
    y: Float[np.ndarray, " ny"],
    elevation: Float[np.ndarray, "ny nx"],
) -> Float[np.ndarray, "ny nx"]:
    """Wetness before the ground is known, around the preset's: more where the terrain is low and level."""
    step = x[1] - x[0]
    low = (elevation.mean() - elevation) / (elevation.std() + np.float32(0.1))
    slope = np.hypot(*np.gradient(gaussian_filter(elevation, 2.0 / step), step))
    varied = 0.8 * smooth_noise(rng, x, y, 14.0) + 0.4 * low + np.float32(0.6) * (1 - slope / (slope.mean() + 1e-3))
    return np.float32(preset.wetness) + np.float32(preset.wetness_spread) * varied


def _soft_maximum(strength: Float[np.ndarray, "K ny nx"]) -> None:
    """Strengths to shares that sum to 1, in place."""
    strength -= strength.max(axis=0)
    strength *= np.float32(SHARPNESS)
    np.exp(strength, out=strength)
    strength /= strength.sum(axis=0)
