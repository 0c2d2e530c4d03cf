"""The heightfield: hills, dunes and banks, and trails with ditches and ruts carved into it."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from offpiste.native.library import entry
from offpiste.simulation.world.grids import Axis, Grid, Line, smooth_noise, smooth_step
from offpiste.simulation.world.world import WorldPreset

_lower_to_nearest = entry("lower_to_nearest", "f8", "i8", int, "f8", "f8", int, "f8")
_slump = entry("slump", "f4", int, int, float)

SPACING = 0.5
"""Spacing of the points of a centre line [m]."""
MARGIN = 15.0
"""Smallest distance of a trail from the world's border [m]."""
HALF_WIDTH = 2.0
"""Half the width of the driven surface [m]."""
NEAR = 8.0
"""Upper limit of computed distances to a trail [m]."""
SHARPEST = (8.3, 11.0)
"""Range of the radius of a loop's tightest bend, drawn uniformly [m]."""
STEEPEST = np.radians(39.0)
"""Slope beyond which ground slumps [rad]."""
RUT_OFFSET = 0.65
"""Distance of each rut from the centre line: half the track of a side-by-side [m]."""


def make_trails(rng: np.random.Generator, size: float) -> tuple[Line, ...]:
    """Return the centre lines of a connected network in a square of `size` metres around the origin.

    One loop runs around the world; smaller loops between its centre and its border each cross an earlier one. Loops
    are closed and counter-clockwise, with points about `SPACING` apart and the first not repeated at the end.
    """
    reach = size / 2 - MARGIN
    loops = [_loop(rng, np.zeros(2), reach)]
    smaller = 3 if reach > 90 else 1
    first = rng.uniform(0, 2 * np.pi)
    for i in range(smaller):
        extent = reach * rng.uniform(0.42, 0.5)
        angle = first + 2 * np.pi * i / smaller + rng.uniform(-0.3, 0.3)
        # Draw again, each time nearer to the border, until it crosses an earlier loop.
        for away in np.linspace(0.5, 1.0, 26):
            direction = np.array([np.cos(angle), np.sin(angle)])
            centre = np.clip(away * reach * direction, extent - reach, reach - extent)
            loop = _loop(rng, centre, extent)
            if _cross(loop, np.concatenate(loops)):
                break
        loops.append(loop)
    return tuple(loops)


def trail_distance_grid(trails: tuple[Line, ...], x: Axis, y: Axis) -> Grid:
    """Return the distance from the nodes of a grid to the nearest centre line, at most `NEAR` [m].

    Args:
        x, y: evenly spaced coordinates of the columns and rows [m].
    """
    square = np.full((len(y), len(x)), NEAR * NEAR)
    points = np.concatenate([resample(loop, 0.1) for loop in trails])
    ends = [np.searchsorted(axis, points[:, k] + reach) for k, axis in enumerate((x, y)) for reach in (-NEAR, NEAR)]
    _lower_to_nearest(points, np.stack(ends, axis=1), len(points), x, y, len(x), square)
    return np.sqrt(square).astype(np.float32)


def resample(loop: Float[np.ndarray, "n 2"], spacing: float) -> Float[np.ndarray, "m 2"]:
    """Resample a closed loop with evenly spaced points, about `spacing` apart [m]."""
    closed = np.concatenate((loop, loop[:1]))
    arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))))
    at = np.linspace(0, arc[-1], max(round(arc[-1] / spacing), 8), endpoint=False)
    return np.stack([np.interp(at, arc, closed[:, axis]) for axis in range(2)], axis=1)


def curvature(loop: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    """Return the curvature of a closed, evenly spaced loop by central differences, positive to the left [1/m]."""
    ahead, behind = np.roll(loop, -1, axis=0) - loop, loop - np.roll(loop, 1, axis=0)
    turn = np.arctan2(ahead[:, 0] * -behind[:, 1] + ahead[:, 1] * behind[:, 0], (ahead * behind).sum(axis=1))
    return turn / ((np.linalg.norm(ahead, axis=1) + np.linalg.norm(behind, axis=1)) / 2)


def _loop(rng: np.random.Generator, centre: Float[np.ndarray, " 2"], extent: float) -> Float[np.ndarray, "n 2"]:
    """Return a loop r(angle) = 1 + sum of waves, as wavy as the sharpest bend allows, scaled to the square +-extent."""
    # The shortest waves are about 40 m long.
    orders = np.arange(2, int(np.clip(extent / 6, 3, 24)) + 1)
    amplitude = rng.uniform(0.2, 1.0, len(orders)) / orders**0.9
    phase = rng.uniform(0, 2 * np.pi, len(orders))
    sharpest = min(rng.uniform(*SHARPEST), 0.6 * extent)
    angle = np.linspace(0, 2 * np.pi, 1440, endpoint=False)
    waves = (amplitude[:, None] * np.cos(orders[:, None] * angle + phase[:, None])).sum(axis=0)

    def shape(waviness: float) -> np.ndarray:
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


def make_hills(rng: np.random.Generator, preset: WorldPreset, x: Axis, y: Axis) -> Grid:
    """Return the elevation of the landscape without trails [m]."""
    elevation = np.zeros((len(y), len(x)), np.float32)
    for grain, height in preset.hills:
        elevation += np.float32(height) * smooth_noise(rng, x, y, grain)
    elevation += _dunes(rng, x, y, preset.dunes)
    elevation += _banks(rng, x, y, preset.bank)
    return elevation


def carve_trails(
    rng: np.random.Generator,
    preset: WorldPreset,
    x: Axis,
    y: Axis,
    elevation: Grid,
    trails: tuple[Line, ...],
    trail_distance: Grid,
) -> Grid:
    """Carve trails, level across and smooth along, with ditches and banks in places, ruts and roughness."""
    step = x[1] - x[0]
    bed = _trail_bed(gaussian_filter(elevation, 7.0 / step), trails, float(x[0]), float(y[0]), float(step))
    on_trail = smooth_step(trail_distance, HALF_WIDTH + 4.5, HALF_WIDTH + 0.2)
    carved = elevation + on_trail * (bed - elevation)

    ditched = smooth_step(smooth_noise(rng, x, y, 12.0), 0.2, 0.8)
    carved += np.float32(preset.ditch) * ditched * (_bump(trail_distance, 5.6, 0.8) - _bump(trail_distance, 3.9, 0.7))
    _slump(carved, *carved.shape, float(np.tan(STEEPEST) * step))
    rutted = smooth_step(smooth_noise(rng, x, y, 9.0), -0.6, 1.2)
    carved -= np.float32(preset.rut) * rutted * _bump(trail_distance, RUT_OFFSET, 0.22)
    smoother = 1 - 0.7 * on_trail
    for grain, share in ((1.6, 1.0), (0.7, 0.4)):
        carved += np.float32(share * preset.roughness) * smoother * smooth_noise(rng, x, y, grain)
    return carved.astype(np.float32)


def _dunes(rng: np.random.Generator, x: Axis, y: Axis, height: float) -> Grid:
    """Return ridges along y with a sharp crest where the noise is zero."""
    noise = smooth_noise(rng, x, y, (16.0, 34.0))
    strength = 0.5 + smooth_step(smooth_noise(rng, x, y, 30.0), -1.0, 1.5) / 2
    return np.float32(height) * strength * np.exp(-np.sqrt(2.5 * noise**2 + np.float32(0.02)))


def _banks(rng: np.random.Generator, x: Axis, y: Axis, height: float) -> Grid:
    """Return local banks along the zero contour of a noise field, about as steep as `STEEPEST`."""
    noise = smooth_noise(rng, x, y, 22.0)
    slope_y, slope_x = np.gradient(noise, x[1] - x[0])
    from_line = noise / np.maximum(np.hypot(slope_x, slope_y), np.float32(0.02))
    present = smooth_step(smooth_noise(rng, x, y, 16.0), 0.2, 1.0)
    half = 0.75 * height / np.tan(STEEPEST)  # smooth_step is 1.5 times as steep in the middle as on average
    return np.float32(height) * present * (smooth_step(from_line, -half, half) - np.float32(0.5))


def _trail_bed(smoothed: Grid, trails: tuple[Line, ...], x0: float, y0: float, step: float) -> Grid:
    """Return the Gaussian-weighted mean elevation of the centre lines around each place.

    The bed is level across a straight trail, since the weights along it do not depend on the distance, and smooth where
    trails cross.
    """
    lines = np.concatenate([resample(loop, step / 2) for loop in trails])
    column, row = np.round((lines - [x0, y0]) / step).astype(int).T
    mass = np.zeros_like(smoothed)
    np.add.at(mass, (row, column), np.float32(1))
    weight = gaussian_filter(mass, 2.5 / step, truncate=5.0)
    total = gaussian_filter(mass * smoothed, 2.5 / step, truncate=5.0)
    return np.where(weight > 1e-7, total / np.maximum(weight, np.float32(1e-7)), smoothed)


def _bump(distance: Grid, at: float, width: float) -> Grid:
    return np.exp(np.float32(-0.5) * ((distance - np.float32(at)) / np.float32(width)) ** 2)
