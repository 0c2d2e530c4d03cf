"""Plants: trees that stop a vehicle, bushes that slow it, tall grass that hides the ground."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from offpiste.logs.ground_truth import GROUND_KINDS
from offpiste.simulation.world.ground import weighted_sum
from offpiste.simulation.world.noise import smooth_noise, smooth_step
from offpiste.simulation.world.surface import read_grid
from offpiste.simulation.world.terrain import HALF_WIDTH
from offpiste.simulation.world.world import BareTerrain, Bushes, Trees, WorldPreset

CLEARANCE = 3.0
"""Distance of tree trunks from the trail's edge [m]."""

BUSH_DRAG = (100.0, 500.0)
"""Force on a vehicle that drives through the smallest and the largest bush [N].

An estimate: no published table was found for single bushes; 500 N is a twentieth of the vehicle's weight.
"""

_GRASSY = {"dry_grass": 1.0, "wet_grass": 1.0, "loose_sand": 0.15, "packed_sand": 0.1, "dirt_trail": 0.25}


def plant_trees(
    rng: np.random.Generator,
    preset: WorldPreset,
    bare: BareTerrain,
) -> Trees:
    """Trees in groves, at least `CLEARANCE` from trails and 3 m from each other."""
    x, y, elevation, trail_distance = bare
    place = _scatter(rng, preset.trees, x, y, grain=14.0, clumping=1.2)
    away = _read(trail_distance, x, y, place) - (HALF_WIDTH + CLEARANCE)
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


def plant_bushes(
    rng: np.random.Generator,
    preset: WorldPreset,
    bare: BareTerrain,
) -> Bushes:
    """Bushes in thickets; a few grow into the edges of trails, none on their middle."""
    x, y, elevation, trail_distance = bare
    place = _scatter(rng, preset.bushes, x, y, grain=9.0, clumping=0.9)
    tolerated = smooth_step(_read(trail_distance, x, y, place), 0.6 * HALF_WIDTH, 2.0 * HALF_WIDTH)
    place = place[rng.uniform(size=len(place)) < tolerated]
    size = rng.beta(1.5, 3.0, len(place))
    radius = 0.25 + 0.75 * size
    least, most = BUSH_DRAG
    return Bushes(
        foot=np.column_stack((place, _read(elevation, x, y, place))),
        radius=radius,
        height=radius * rng.uniform(0.9, 1.7, len(place)),
        drag=least + (most - least) * size,
    )


def grow_grass(
    rng: np.random.Generator,
    preset: WorldPreset,
    bare: BareTerrain,
    kinds: Float[np.ndarray, "K ny nx"],
) -> Float[np.ndarray, "ny nx"]:
    """Height of tall grass, in patches, mostly on grassy ground; trails are worn short [m]."""
    x, y, _, trail_distance = bare
    grassy = weighted_sum(kinds, np.array([_GRASSY.get(kind, 0.0) for kind in GROUND_KINDS]))
    threshold = 1.2 - 2.4 * preset.grass  # of normal noise: the share above it is about `grass`
    patches = smooth_step(smooth_noise(rng, x, y, 5.0) + 0.3 * smooth_noise(rng, x, y, 1.0), threshold, threshold + 1.0)
    worn = smooth_step(trail_distance, 0.5 * HALF_WIDTH, 1.4 * HALF_WIDTH)
    height = np.float32(preset.grass_height) * patches * smooth_step(grassy, 0.05, 0.9) * worn
    return np.where(height < 0.05, 0, height).astype(np.float32)


def _scatter(
    rng: np.random.Generator,
    per_hectare: float,
    x: Float[np.ndarray, " nx"],
    y: Float[np.ndarray, " ny"],
    grain: float,
    clumping: float,
) -> Float[np.ndarray, "n 2"]:
    """Random places, dense where a smooth noise is high (log-normal density).

    Args:
        per_hectare: mean number per hectare.
    """
    low, high = np.array([x[0], y[0]]), np.array([x[-1], y[-1]])
    largest = 4.0
    candidates = rng.poisson(per_hectare * np.prod(high - low) / 1e4 * largest)
    place = rng.uniform(low, high, (candidates, 2))
    density = np.exp(clumping * smooth_noise(rng, x, y, grain) - clumping**2 / 2)
    return place[rng.uniform(0, largest, candidates) < _read(density, x, y, place)]


def _apart(place: Float[np.ndarray, "n 2"], distance: float) -> Bool[np.ndarray, " n"]:
    """Mask of places to keep, so that none lies within `distance` of an earlier one that is kept."""
    keep = np.ones(len(place), bool)
    for first, second in sorted(cKDTree(place).query_pairs(distance)) if len(place) else ():
        keep[second] &= not keep[first]
    return keep


def _read(
    grid: Float[np.ndarray, "ny nx"],
    x: Float[np.ndarray, " nx"],
    y: Float[np.ndarray, " ny"],
    place: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, " n"]:
    return read_grid(grid, (float(x[0]), float(y[0])), float(x[1] - x[0]), place)
