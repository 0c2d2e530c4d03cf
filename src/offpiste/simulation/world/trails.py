"""Trails: closed loops that cross each other, so that one can drive everywhere and never has to turn around."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

SPACING = 0.5
"""Spacing of the points of a centre line [m]."""

MARGIN = 15.0
"""Least distance of a trail from the world's border [m]."""

HALF_WIDTH = 2.0
"""Half the width of the driven surface [m]."""

NEAR = 8.0
"""Largest distance to a trail that is computed [m]."""

SHARPEST = (8.3, 11.0)
"""Least and greatest radius of a loop's tightest bend, drawn uniformly [m]."""


def make_trails(rng: np.random.Generator, size: float) -> tuple[Float[np.ndarray, "_ 2"], ...]:
    """Centre lines of a connected network in a square of `size` metres around the origin.

    One loop around the world, and smaller ones between its centre and its border, each of which crosses an earlier one.

    Returns:
        closed loops, counter-clockwise, points about `SPACING` apart, the first not repeated at the end.
    """
    reach = size / 2 - MARGIN
    loops = [_loop(rng, np.zeros(2), reach)]
    smaller = 3 if reach > 90 else 1
    first = rng.uniform(0, 2 * np.pi)
    for i in range(smaller):
        extent = reach * rng.uniform(0.42, 0.5)
        angle = first + 2 * np.pi * i / smaller + rng.uniform(-0.3, 0.3)
        # Drawn again, ever nearer to the border, until it crosses what is there.
        for away in np.linspace(0.5, 1.0, 26):
            direction = np.array([np.cos(angle), np.sin(angle)])
            centre = np.clip(away * reach * direction, extent - reach, reach - extent)
            loop = _loop(rng, centre, extent)
            if _cross(loop, np.concatenate(loops)):
                break
        loops.append(loop)
    return tuple(loops)


def distance_to_trails(
    trails: tuple[Float[np.ndarray, "_ 2"], ...], places: Float[np.ndarray, "m 2"]
) -> Float[np.ndarray, " m"]:
    """Distance to the nearest centre line, `NEAR` where it is farther [m]."""
    lines = np.concatenate([resample(loop, 0.1) for loop in trails])
    distance, _ = cKDTree(lines).query(places, distance_upper_bound=NEAR)
    return np.minimum(distance, NEAR).astype(np.float32)


def resample(loop: Float[np.ndarray, "n 2"], spacing: float) -> Float[np.ndarray, "m 2"]:
    """A closed loop with points evenly spaced along it, about `spacing` apart [m]."""
    closed = np.concatenate((loop, loop[:1]))
    arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))))
    at = np.linspace(0, arc[-1], max(round(arc[-1] / spacing), 8), endpoint=False)
    return np.stack([np.interp(at, arc, closed[:, axis]) for axis in range(2)], axis=1)


def curvature(loop: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    """Curvature of a closed, evenly spaced loop, + to the left, from central differences [1/m]."""
    ahead, behind = np.roll(loop, -1, axis=0) - loop, loop - np.roll(loop, 1, axis=0)
    turn = np.arctan2(ahead[:, 0] * -behind[:, 1] + ahead[:, 1] * behind[:, 0], (ahead * behind).sum(axis=1))
    return turn / ((np.linalg.norm(ahead, axis=1) + np.linalg.norm(behind, axis=1)) / 2)


def _loop(rng: np.random.Generator, centre: Float[np.ndarray, " 2"], extent: float) -> Float[np.ndarray, "n 2"]:
    """r(angle) = 1 + a sum of waves, as wavy as the sharpest bend allows, scaled to the square +-extent."""
    # Waves down to about 40 m long, whatever the loop's length.
    orders = np.arange(2, int(np.clip(extent / 6, 3, 24)) + 1)
    amplitude = rng.uniform(0.2, 1.0, len(orders)) / orders**0.9
    phase = rng.uniform(0, 2 * np.pi, len(orders))
    sharpest = min(rng.uniform(*SHARPEST), 0.6 * extent)
    angle = np.linspace(0, 2 * np.pi, 1440, endpoint=False)
    waves = (amplitude[:, None] * np.cos(orders[:, None] * angle + phase[:, None])).sum(axis=0)

    def shape(waviness: float) -> Float[np.ndarray, "n 2"]:
        radius = 1 + waviness * waves / np.abs(waves).max()
        loop = radius[:, None] * np.stack((np.cos(angle), np.sin(angle)), axis=1)
        low, high = loop.min(axis=0), loop.max(axis=0)
        return resample((2 * (loop - low) / (high - low) - 1) * extent, SPACING)

    low, high = 0.0, 0.7
    for _ in range(20):
        middle = (low + high) / 2
        gentle = np.abs(curvature(shape(middle))).max() < 1 / sharpest
        low, high = (middle, high) if gentle else (low, middle)
    return shape(low) + centre


def _cross(loop: Float[np.ndarray, "n 2"], others: Float[np.ndarray, "m 2"]) -> bool:
    near: Bool[np.ndarray, " n"] = cKDTree(others).query(loop)[0] < SPACING
    return bool(near.any())
