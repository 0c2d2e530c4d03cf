"""Smooth random fields: what hills, patches of ground and thickets are made of."""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter


def smooth_noise(
    rng: np.random.Generator,
    x: Float[np.ndarray, " nx"],
    y: Float[np.ndarray, " ny"],
    grain: float | tuple[float, float],
) -> Float[np.ndarray, "ny nx"]:
    """A random field with mean 0 and variance about 1: a cubic B-spline with normal coefficients.

    The coefficients are smoothed, so that nothing shows of the lattice of knots. The field depends on place,
    not on how finely it is read: the same generator gives the same hills at every resolution.

    Args:
        x, y: of the columns and rows [m].
        grain: size of what is in it, along x and y: a bump is about three grains wide [m].
    """
    knots_x, knots_y = np.broadcast_to(grain, 2) / 2
    basis_x, basis_y = _basis(x, float(knots_x)), _basis(y, float(knots_y))
    coefficients = rng.standard_normal((basis_y.shape[1], basis_x.shape[1])).astype(np.float32)
    coefficients = gaussian_filter(coefficients, 1.0, mode="wrap", truncate=4.0)
    return basis_y @ coefficients @ basis_x.T / np.float32(_VARIANCE)


_VARIANCE = 0.2440
"""Of a cubic B-spline whose coefficients were smoothed over one knot: along one axis, mean over an interval."""


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
