"""Grids of a world: smooth random fields to fill them, and interpolation to read them.

The physics reads single places with compiled functions; `read_grid` reads many places at once. Both clamp places beyond
the border.
"""

import numpy as np
from jaxtyping import Float, Int, Shaped
from scipy.ndimage import gaussian_filter

from offpiste.native.compilation import PHYSICS

Axis = Float[np.ndarray, " _"]
"""Evenly spaced coordinates of the columns or rows of a grid [m]."""
Grid = Float[np.ndarray, "ny nx"]
"""Values at the nodes of a grid."""
Line = Float[np.ndarray, "_ 2"]
"""Points x, y along a line [m]."""


def smooth_step(value: Float[np.ndarray, "..."], start: float, end: float) -> Float[np.ndarray, "..."]:
    """Return 0 at `start`, 1 at `end`, 3 t^2 - 2 t^3 in between; `start` may exceed `end`."""
    t = np.clip((value - start) / (end - start), 0, 1)
    return t * t * (3 - 2 * t)


def smooth_noise(rng: np.random.Generator, x: Axis, y: Axis, grain: float | tuple[float, float]) -> Grid:
    """Return a random field with mean 0 and variance about 1: a cubic B-spline with normal coefficients.

    The coefficients are smoothed to hide the lattice of knots. The field does not depend on the sampling: the same
    generator gives the same hills at every resolution that divides the size.

    Args:
        x, y: coordinates of the columns and rows [m].
        grain: feature size along x and y; a bump is about three grains wide [m].
    """
    knots_x, knots_y = np.broadcast_to(grain, 2) / 2
    (first_x, weight_x), (first_y, weight_y) = _weights(x, float(knots_x)), _weights(y, float(knots_y))
    coefficients = rng.standard_normal((first_y[-1] + 4, first_x[-1] + 4)).astype(np.float32)
    coefficients = gaussian_filter(coefficients, 1.0, mode="wrap", truncate=4.0)
    field = np.empty((len(y), len(x)), np.float32)
    _spline(coefficients, first_x, weight_x, first_y, weight_y, np.empty(coefficients.shape[1], np.float32), field)
    return field


_VARIANCE = 0.2440
"""Mean variance along one axis of a cubic B-spline with coefficients smoothed over one knot."""


@PHYSICS.entry
def _spline(coefficients, first_x, weight_x, first_y, weight_y, row, field):  # type: ignore[no-untyped-def]
    """Write the weighted sum of the coefficients around each place; `row` is a buffer."""
    for j in range(len(first_y)):
        a, b, c, d = weight_y[j]
        at = first_y[j]
        for i in range(len(row)):
            near = a * coefficients[at, i] + b * coefficients[at + 1, i]
            row[i] = near + c * coefficients[at + 2, i] + d * coefficients[at + 3, i]
        for i in range(len(first_x)):
            at_x = first_x[i]
            near = weight_x[i, 0] * row[at_x] + weight_x[i, 1] * row[at_x + 1]
            sum_of_four = near + weight_x[i, 2] * row[at_x + 2] + weight_x[i, 3] * row[at_x + 3]
            field[j, i] = sum_of_four / np.float32(_VARIANCE)


def _weights(at: Float[np.ndarray, " n"], knots: float) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 4"]]:
    """Return the index of the first of four coefficients, and their uniform cubic B-spline weights (de Boor, 1978)."""
    position = (at - at[0]) / knots
    first = position.astype(int)
    t = position - first
    weights = np.stack(((1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3), axis=1) / 6
    return first, weights.astype(np.float32)


@PHYSICS.entry
def _cell(distance, resolution, nodes):  # type: ignore[no-untyped-def]
    # Index and fraction, both clamped; the comparison is written so that NaN reads the border instead of crashing.
    position = distance / resolution
    if not position > 0.0:
        position = 0.0
    if position > nodes - 1:
        position = nodes - 1.0
    index = min(int(position), nodes - 2)
    return index, position - index


@PHYSICS.entry
def height(elevation, x0, y0, resolution, x, y):  # type: ignore[no-untyped-def]
    """Return the elevation at (x, y), bilinear [m].

    Args:
        elevation: [ny, nx], at least 2 x 2 [m].
        x0, y0: position of node [0, 0] [m].
        resolution: distance between nodes [m].
    """
    i, u = _cell(x - x0, resolution, elevation.shape[1])
    j, v = _cell(y - y0, resolution, elevation.shape[0])
    near = elevation[j, i] * (1.0 - u) + elevation[j, i + 1] * u
    far = elevation[j + 1, i] * (1.0 - u) + elevation[j + 1, i + 1] * u
    return near * (1.0 - v) + far * v


@PHYSICS.entry
def properties_at(properties, x0, y0, resolution, x, y, out):  # type: ignore[no-untyped-def]
    """Write the properties [ny, nx, 4] of the ground at (x, y), bilinear, to `out` [4]."""
    i, u = _cell(x - x0, resolution, properties.shape[1])
    j, v = _cell(y - y0, resolution, properties.shape[0])
    for p in range(properties.shape[2]):
        near = properties[j, i, p] * (1.0 - u) + properties[j, i + 1, p] * u
        far = properties[j + 1, i, p] * (1.0 - u) + properties[j + 1, i + 1, p] * u
        out[p] = near * (1.0 - v) + far * v


@PHYSICS.entry
def main_kind(kinds, x0, y0, resolution, x, y):  # type: ignore[no-untyped-def]
    """Return the index of the kind [K, ny, nx] with the largest share at the nearest node; the first if tied."""
    i, u = _cell(x - x0, resolution, kinds.shape[2])
    j, v = _cell(y - y0, resolution, kinds.shape[1])
    if u >= 0.5:
        i += 1
    if v >= 0.5:
        j += 1
    best = 0
    for k in range(1, kinds.shape[0]):
        if kinds[k, j, i] > kinds[best, j, i]:
            best = k
    return best


def read_grid(
    grid: Shaped[np.ndarray, "ny nx ..."],
    origin: tuple[float, float],
    resolution: float,
    places: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, "n ..."]:
    """Return the values of a grid of a world at many places x, y [m], bilinear, clamped at the border."""
    nodes = np.array(grid.shape[1::-1])
    position = np.clip((places - np.array(origin)) / resolution, 0, nodes - 1)
    index = np.minimum(position.astype(int), nodes - 2)
    (i, j), (u, v) = index.T, (position - index).T
    u, v = (weight.reshape(-1, *[1] * (grid.ndim - 2)) for weight in (u, v))
    near = grid[j, i] * (1 - u) + grid[j, i + 1] * u
    far = grid[j + 1, i] * (1 - u) + grid[j + 1, i + 1] * u
    return near * (1 - v) + far * v


def turns_of(line: Line) -> Float[np.ndarray, " _"]:
    """Return the change of heading between consecutive segments of a line [rad]."""
    step = np.diff(line, axis=0)
    return np.diff(np.unwrap(np.arctan2(step[:, 1], step[:, 0])))


def normals_of(elevation: Grid, resolution: float) -> Float[np.ndarray, "ny nx 3"]:
    """Return the unit normals at the nodes, from central differences."""
    slope_y, slope_x = np.gradient(elevation, resolution)
    normals = np.stack((-slope_x, -slope_y, np.ones_like(slope_x)), axis=-1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)
