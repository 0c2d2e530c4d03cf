"""Smooth random fields: what hills, patches of ground and thickets are made of."""

import numpy as np
from jaxtyping import Float


def smooth_noise(
    rng: np.random.Generator,
    x: Float[np.ndarray, " nx"],
    y: Float[np.ndarray, " ny"],
    grain: float | tuple[float, float],
) -> Float[np.ndarray, "ny nx"]:
    """A random field with mean 0 and variance about 1: a cubic B-spline with normal coefficients.

    It depends on place, not on how finely it is read: the same generator gives the same hills at every resolution.

    Args:
        x, y: of the columns and rows [m].
        grain: distance of the spline's knots, along x and y; bumps are about three times as wide [m].
    """
    grain_x, grain_y = np.broadcast_to(grain, 2)
    basis_x, basis_y = _basis(x, float(grain_x)), _basis(y, float(grain_y))
    coefficients = rng.standard_normal((basis_y.shape[1], basis_x.shape[1])).astype(np.float32)
    return basis_y @ coefficients @ basis_x.T / np.float32(_MEAN_SQUARE)


_MEAN_SQUARE = 151 / 315
"""Mean over a knot interval of the sum of squares of the cubic B-spline's four weights."""


def _basis(at: Float[np.ndarray, " n"], grain: float) -> Float[np.ndarray, "n m"]:
    """Weights of the knots at places; the four uniform cubic B-spline polynomials (de Boor, 1978)."""
    position = (at - at[0]) / grain
    index = position.astype(int)
    t = position - index
    weights = np.stack(((1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3), axis=1) / 6
    basis = np.zeros((len(at), int(index[-1]) + 4), np.float32)
    np.put_along_axis(basis, index[:, None] + np.arange(4), weights.astype(np.float32), axis=1)
    return basis


def smooth_step(value: Float[np.ndarray, "..."], start: float, end: float) -> Float[np.ndarray, "..."]:
    """0 at `start`, 1 at `end`, 3 t^2 - 2 t^3 between; `start` may be the larger."""
    t = np.clip((value - start) / (end - start), 0, 1)
    return t * t * (3 - 2 * t)
