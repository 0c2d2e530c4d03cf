"""Grids of a world: smooth random fields to fill them, and interpolation to read them.

The physics reads single places in C++ (`native/cpp/simulation/grids.h`); `read_grid` reads many places at once. Both
clamp places beyond the border, and read the first column or row where a coordinate is NaN.
"""

import cv2
import numpy as np
from jaxtyping import Float, Int, Shaped
from scipy.ndimage import gaussian_filter
from scipy.sparse import csr_array

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
    (columns, of_x), (rows, of_y) = _weights(x, float(knots_x)), _weights(y, float(knots_y))
    coefficients = rng.standard_normal((rows, columns)).astype(np.float32)
    coefficients = gaussian_filter(coefficients, 1.0, mode="wrap", truncate=4.0)
    field = cv2.transpose(of_x @ (of_y @ coefficients).T)  # faster than NumPy's copy
    return np.asarray(field / np.float32(_VARIANCE))


_VARIANCE = 0.2440
"""Mean variance along one axis of a cubic B-spline with coefficients smoothed over one knot."""


def _weights(at: Axis, knots: float) -> tuple[int, csr_array]:
    """Return the number of knots and their uniform cubic B-spline weights at each place (de Boor, 1978)."""
    position = (at - at[0]) / knots
    first = position.astype(int)
    t = position - first
    weights = np.stack(((1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3), axis=1) / 6
    count, knot = int(first[-1]) + 4, first[:, None] + np.arange(4)
    start = 4 * np.arange(len(at) + 1)
    return count, csr_array((weights.astype(np.float32).ravel(), knot.ravel(), start), shape=(len(at), count))


def main_kinds(
    kinds: Float[np.ndarray, "K ny nx"],
    origin: tuple[float, float],
    resolution: float,
    places: Float[np.ndarray, "n 2"],
) -> Int[np.ndarray, " n"]:
    """Return the kind with the largest share at the node nearest to each place x, y [m]; the first if tied."""
    last = np.array(kinds.shape[:0:-1]) - 1
    position = np.nan_to_num(np.clip((places - np.array(origin)) / resolution, 0, last))
    column, row = np.floor(position + 0.5).astype(int).T
    return np.asarray(kinds[:, row, column].argmax(axis=0))


def read_grid(
    grid: Shaped[np.ndarray, "ny nx ..."],
    origin: tuple[float, float],
    resolution: float,
    places: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, "n ..."]:
    """Return the values of a grid of a world at many places x, y [m], bilinear, clamped at the border.

    A NaN coordinate reads the first column or row.
    """
    rows, columns, *values = grid.shape
    last = np.array([[columns - 1], [rows - 1]])
    position = np.clip((places.T - np.array(origin)[:, None]) / resolution, 0, last)
    position[np.isnan(position)] = 0
    i, j = index = np.minimum(position.astype(int), last - 1)
    u, v = (position - index).reshape(2, -1, *(1 for _ in values))
    nodes, first = grid.reshape(-1, *values), j * columns + i  # `take` is several times faster than two indices
    near = nodes.take(first, axis=0) * (1 - u) + nodes.take(first + 1, axis=0) * u
    far = nodes.take(first + columns, axis=0) * (1 - u) + nodes.take(first + columns + 1, axis=0) * u
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
