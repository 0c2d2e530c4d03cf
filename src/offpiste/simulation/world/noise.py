"""Smooth random fields: what hills, patches of ground and thickets are made of."""

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import gaussian_filter

from offpiste.compilation import PHYSICS


def smooth_noise(
    rng: np.random.Generator,
    x: Float[np.ndarray, " nx"],
    y: Float[np.ndarray, " ny"],
    grain: float | tuple[float, float],
) -> Float[np.ndarray, "ny nx"]:
    """A random field with mean 0 and variance about 1: a cubic B-spline with normal coefficients.

    The coefficients are smoothed, so that the lattice of knots does not show. The field depends on place,
    not on how finely it is read: the same generator gives the same hills at every resolution that divides the size.

    Args:
        x, y: coordinates of the columns and rows [m].
        grain: size of features along x and y: a bump is about three grains wide [m].
    """
    knots_x, knots_y = np.broadcast_to(grain, 2) / 2
    (first_x, weight_x), (first_y, weight_y) = _weights(x, float(knots_x)), _weights(y, float(knots_y))
    coefficients = rng.standard_normal((first_y[-1] + 4, first_x[-1] + 4)).astype(np.float32)
    coefficients = gaussian_filter(coefficients, 1.0, mode="wrap", truncate=4.0)
    field = np.empty((len(y), len(x)), np.float32)
    _spline(coefficients, first_x, weight_x, first_y, weight_y, np.empty(coefficients.shape[1], np.float32), field)
    return field


_VARIANCE = 0.2440
"""Variance along one axis of a cubic B-spline whose coefficients were smoothed over one knot, mean over an interval."""


@PHYSICS.entry
def _spline(coefficients, first_x, weight_x, first_y, weight_y, row, field):  # type: ignore[no-untyped-def]
    """Sum of the coefficients around each place, by their weights; `row` is a buffer."""
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
    """First of four coefficients, and their weights: the uniform cubic B-spline polynomials (de Boor, 1978)."""
    position = (at - at[0]) / knots
    first = position.astype(int)
    t = position - first
    weights = np.stack(((1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3), axis=1) / 6
    return first, weights.astype(np.float32)


def smooth_step(value: Float[np.ndarray, "..."], start: float, end: float) -> Float[np.ndarray, "..."]:
    """0 at `start`, 1 at `end`, 3 t^2 - 2 t^3 between; `start` may be the larger."""
    t = np.clip((value - start) / (end - start), 0, 1)
    return t * t * (3 - 2 * t)
