"""Ground cover: kinds of ground with their properties (grounds.toml), trees, bushes and tall grass."""

from functools import cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from offpiste.core.limits import packaged_table
from offpiste.logs.ground_truth import GROUND_KINDS, GROUND_PROPERTIES
from offpiste.simulation.world.grids import Axis, Grid, read_grid, smooth_noise, smooth_step
from offpiste.simulation.world.terrain import HALF_WIDTH
from offpiste.simulation.world.world import BareTerrain, Bushes, Trees, WorldPreset

PATCH_GRAIN = 13.0
"""Grain of the patches [m]; the ground changes every 8 to 25 m."""
SHARPNESS = 20.0
"""Sharpness of the borders between kinds, which are about 1 m wide."""
TREE_CLEARANCE = 3.0
"""Distance of tree trunks from the edge of a trail [m]."""
BUSH_DRAG = (100.0, 500.0)
"""Force on a vehicle that drives through the smallest and the largest bush [N].

An estimate, as no published value was found for single bushes; 500 N is a twentieth of the vehicle's weight.
"""
_GUMBEL = np.sqrt(6) / np.pi
"""Scale of a Gumbel distribution of variance 1; adding `scale log(w)` to its noise gives a kind a share of about w."""
_GRASSY = {"dry_grass": 1.0, "wet_grass": 1.0, "loose_sand": 0.15, "packed_sand": 0.1, "dirt_trail": 0.25}


@cache
def grounds() -> tuple[dict[str, Any], ...]:
    """Return the tables of grounds.toml, which explains the entries, in the order of `GROUND_KINDS`."""
    rows = packaged_table(__package__, "grounds.toml")
    return tuple(rows[kind] for kind in GROUND_KINDS)


def property_table() -> Float[np.ndarray, "2 K 4"]:
    """Return the properties of each kind of ground, dry and wet."""
    names = GROUND_PROPERTIES
    return np.array([[[ground[name][state] for name in names] for ground in grounds()] for state in ("dry", "wet")])


def colour_table() -> Float[np.ndarray, "2 K 3"]:
    """Return the colours of each kind of ground, dry and wet, sRGB [0..1]."""
    return np.array([[ground["colour"][state] for ground in grounds()] for state in ("dry", "wet")])


def lay_grounds(
    rng: np.random.Generator, preset: WorldPreset, bare: BareTerrain
) -> tuple[Float[np.ndarray, "K ny nx"], Grid]:
    """Return the shares of the kinds at each node, which sum to 1, and wetness 0..1.

    Each kind has its own smooth noise, and a soft maximum picks the strongest. A kind is more or less frequent on
    trails than on open ground, but its patches continue across.
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
        kinds[k] += ground["likes_water"] * (water - preset.wetness)
        kinds[k] += np.float32(open_weight[k]) + np.float32(trail_weight[k] - open_weight[k]) * on_trail
    kinds -= kinds.max(axis=0)
    kinds *= np.float32(SHARPNESS)
    np.exp(kinds, out=kinds)
    kinds /= kinds.sum(axis=0)
    wetness = water + np.float32(0.1) * weighted_sum(kinds, np.array([ground["likes_water"] for ground in grounds()]))
    return kinds, np.clip(wetness, 0, 1).astype(np.float32)


def mix_properties(kinds: Float[np.ndarray, "K ny nx"], wetness: Grid, contrast: float) -> Float[np.ndarray, "ny nx 4"]:
    """Return the properties of mixed ground.

    Args:
        kinds: shares, which sum to 1.
        contrast: 1 uses the table; 0 uses its mean over kinds and wetness everywhere; interpolated in between.
    """
    table = property_table()
    mean = table.mean(axis=(0, 1))
    # Mix deviations from the mean, so that kinds are exactly equal without contrast.
    dry, wet = (contrast * (table - mean)).astype(np.float32)
    mixed = np.empty((*wetness.shape, len(GROUND_PROPERTIES)), np.float32)
    for p in range(len(GROUND_PROPERTIES)):
        mixed[..., p] = np.float32(mean[p]) + weighted_sum(kinds, dry[:, p])
        mixed[..., p] += wetness * weighted_sum(kinds, wet[:, p] - dry[:, p])
    return mixed


def weighted_sum(kinds: Float[np.ndarray, "K ny nx"], weights: Float[np.ndarray, " K"]) -> Grid:
    """Sum over the kinds in a fixed order; rounding in a matrix product would depend on the number of threads."""
    total = np.zeros(kinds.shape[1:], np.float32)
    for share, weight in zip(kinds, weights, strict=True):
        total += np.float32(weight) * share
    return total


def _water(rng: np.random.Generator, preset: WorldPreset, x: Axis, y: Axis, elevation: Grid) -> Grid:
    """Return the wetness without the kinds' effect: the preset's on average, higher where terrain is low and level."""
    step = x[1] - x[0]
    low = (elevation.mean() - elevation) / (elevation.std() + np.float32(0.1))
    slope = np.hypot(*np.gradient(gaussian_filter(elevation, 2.0 / step), step))
    varied = 0.8 * smooth_noise(rng, x, y, 14.0) + 0.4 * low + np.float32(0.6) * (1 - slope / (slope.mean() + 1e-3))
    return np.float32(preset.wetness) + np.float32(preset.wetness_spread) * varied


def plant_trees(rng: np.random.Generator, preset: WorldPreset, bare: BareTerrain) -> Trees:
    """Plant trees in groves, at least `TREE_CLEARANCE` from trails and 3 m from each other."""
    x, y, elevation, trail_distance = bare
    place = _scatter(rng, preset.trees, x, y, grain=14.0, clumping=1.2)
    away = _read(trail_distance, x, y, place) - (HALF_WIDTH + TREE_CLEARANCE)
    place = place[away > 0.05 + (x[1] - x[0])]
    place = place[_apart(place, 3.0)]
    low, high = preset.tree_height
    height = rng.uniform(low, high, len(place))
    return Trees(
        foot=np.column_stack((place, _read(elevation, x, y, place))),
        trunk_radius=0.022 * height + rng.uniform(0.02, 0.08, len(place)),
        crown_radius=height * rng.uniform(0.28, 0.45, len(place)),
        height=height,
    )


def plant_bushes(rng: np.random.Generator, preset: WorldPreset, bare: BareTerrain) -> Bushes:
    """Plant bushes in thickets; a few grow at the edges of trails, none in the middle."""
    x, y, elevation, trail_distance = bare
    place = _scatter(rng, preset.bushes, x, y, grain=9.0, clumping=0.9)
    tolerated = smooth_step(_read(trail_distance, x, y, place), 0.6 * HALF_WIDTH, 2.0 * HALF_WIDTH)
    place = place[rng.uniform(size=len(place)) < tolerated]
    size = rng.beta(1.5, 3.0, len(place))
    radius, (least, most) = 0.25 + 0.75 * size, BUSH_DRAG
    height = radius * rng.uniform(0.9, 1.7, len(place))
    return Bushes(
        np.column_stack((place, _read(elevation, x, y, place))), radius, height, least + (most - least) * size
    )


def grow_grass(
    rng: np.random.Generator, preset: WorldPreset, bare: BareTerrain, kinds: Float[np.ndarray, "K ny nx"]
) -> Grid:
    """Return the height of tall grass in patches [m]: mostly on grassy ground, worn short on trails."""
    x, y, _, trail_distance = bare
    grassy = weighted_sum(kinds, np.array([_GRASSY.get(kind, 0.0) for kind in GROUND_KINDS]))
    threshold = 1.2 - 2.4 * preset.grass  # of normal noise: the share above it is about `grass`
    patches = smooth_step(smooth_noise(rng, x, y, 5.0) + 0.3 * smooth_noise(rng, x, y, 1.0), threshold, threshold + 1.0)
    worn = smooth_step(trail_distance, 0.5 * HALF_WIDTH, 1.4 * HALF_WIDTH)
    height = np.float32(preset.grass_height) * patches * smooth_step(grassy, 0.05, 0.9) * worn
    return np.where(height < 0.05, 0, height).astype(np.float32)


def _scatter(
    rng: np.random.Generator, per_hectare: float, x: Axis, y: Axis, grain: float, clumping: float
) -> Float[np.ndarray, "n 2"]:
    """Return random places with a smooth log-normal density and a given mean number per hectare."""
    low, high = np.array([x[0], y[0]]), np.array([x[-1], y[-1]])
    largest = 4.0
    candidates = rng.poisson(per_hectare * np.prod(high - low) / 1e4 * largest)
    place = rng.uniform(low, high, (candidates, 2))
    density = np.exp(clumping * smooth_noise(rng, x, y, grain) - clumping**2 / 2)
    return place[rng.uniform(0, largest, candidates) < _read(density, x, y, place)]


def _apart(place: Float[np.ndarray, "n 2"], distance: float) -> Bool[np.ndarray, " n"]:
    """Return a mask that drops places within `distance` of an earlier kept place."""
    keep = np.ones(len(place), bool)
    for first, second in sorted(cKDTree(place).query_pairs(distance)) if len(place) else ():
        keep[second] &= not keep[first]
    return keep


def _read(grid: Grid, x: Axis, y: Axis, place: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    return read_grid(grid, (float(x[0]), float(y[0])), float(x[1] - x[0]), place)
