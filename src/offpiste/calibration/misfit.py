"""Estimate of mounting and stamp errors from residuals of many pairs of measurements.

Robust Gauss-Newton with Tukey's biweight (Beaton and Tukey, 1974) on residuals scaled by their median. The uncertainty
is that of independent pairs (a sandwich estimate, Huber 1967) plus that of the rows: errors shared by all points of a
pair (poses, weather, moving vegetation) count once per pair, not per point.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from offpiste.core.conventions import SIGMA_PER_MEDIAN

PRIOR: Final = np.array([*np.deg2rad([5.0, 5.0, 5.0]), 0.3])
"""Standard deviation of the prior [rad, rad, rad, s]; undetermined parameters keep it."""
STEPS: Final = np.array([*np.deg2rad([0.05, 0.05, 0.05]), 0.04, 0.01, 0.01, 0.01])
"""Step sizes of the central differences [rad, rad, rad, s, m, m, m]. The time step is long, as pose noise would
dominate a short one."""
LEAST_PAIRS: Final = 8
"""Minimum number of pairs; fewer do not show their own scatter."""
_NEIGHBOURS: Final = 12
"""Number of points of a plane."""
_BIWEIGHT: Final = 4.685
"""Tuning constant for 95 % efficiency with normal errors."""

Parameters = Float[np.ndarray, " k"]
"""Rotation about the body axes [rad] and delay [s]; translation along them [m] if the position is estimated, too."""


@dataclass(frozen=True)
class Pair:
    """Residuals of two measurements, linearised at some parameters.

    Attributes:
        residual: zero without errors [m or px].
        slope: Jacobian with respect to rotation [rad], delay [s] and translation [m].
    """

    residual: Float[np.ndarray, " n"]
    slope: Float[np.ndarray, "n k"]


@dataclass(frozen=True)
class Misfit:
    """Errors of a sensor's mounting and stamps.

    Attributes:
        parameters: rotation about the body axes, so that the correct mounting is `exp(turn) @ body_from_sensor` [rad];
            delay: rig time of the stamp minus time of measurement [s]; translation, if estimated [m].
        sigma: standard deviation of each.
        pairs: number of pairs used.
        scale: of the remaining residuals [m or px].
        residuals: number of residuals.
    """

    parameters: Parameters
    sigma: Float[np.ndarray, " k"]
    pairs: int
    scale: float
    residuals: int


def turned(mounting: Float[np.ndarray, "4 4"], parameters: Parameters) -> Float[np.ndarray, "4 4"]:
    """Return the mounting `body_from_sensor` rotated about the body axes at a fixed sensor position.

    Parameters beyond the fourth translate it along the body axes.
    """
    matrix = mounting.copy()
    matrix[: len(parameters[4:7]), 3] += parameters[4:7]
    matrix[:3, :3] = Rotation.from_rotvec(parameters[:3]).as_matrix() @ mounting[:3, :3]
    return matrix


def fit_misfit(
    compare: Callable[[Parameters], Sequence[Pair]],
    *,
    rounds: int = 6,
    prior: Parameters = PRIOR,
    start: Parameters | None = None,
) -> Misfit | None:
    """Estimate the parameters that best align measurements.

    Args:
        compare: returns pairs near some parameters; called once per iteration.
        prior: prior standard deviations about zero, one per parameter.
        start: initial parameters; zeros by default.

    Returns:
        None with fewer than `LEAST_PAIRS` pairs.
    """
    result, first = None, np.zeros(len(prior)) if start is None else start
    for _ in range(rounds):
        before = first if result is None else result.parameters
        pairs = [pair for pair in compare(before) if len(pair.residual)]
        if len(pairs) < LEAST_PAIRS:
            return None
        result = _step(pairs, before, prior)
        if (np.abs(result.parameters - before) < 0.2 * result.sigma).all():
            break
    return result


def _step(pairs: Sequence[Pair], start: Parameters, prior: Parameters) -> Misfit:
    """Return one robust linear fit, scaled by the prior for conditioning."""
    slope = np.concatenate([pair.slope for pair in pairs]) * prior
    residual = np.concatenate([pair.residual for pair in pairs])
    step, scale = np.zeros(len(prior)), 0.0
    normal, weight = np.eye(len(prior)), np.ones(len(residual))
    for _ in range(15):
        left = residual + slope @ step
        scale = max(SIGMA_PER_MEDIAN * float(np.median(np.abs(left))), 1e-9)
        weight = np.clip(1 - (left / (_BIWEIGHT * scale)) ** 2, 0, None) ** 2 / scale**2
        normal = slope.T @ (weight[:, None] * slope) + np.eye(len(prior))
        step = -np.linalg.solve(normal, slope.T @ (weight * residual) + start / prior)
    pull = weight * (residual + slope @ step)
    ends = np.cumsum([len(pair.residual) for pair in pairs])[:-1]
    shared = np.stack([s.T @ p for s, p in zip(np.split(slope, ends), np.split(pull, ends), strict=True)])
    inverse = np.linalg.inv(normal)
    few = len(pairs) / (len(pairs) - len(prior))
    covariance = inverse @ (few * shared.T @ shared) @ inverse + inverse
    return Misfit(start + step * prior, np.sqrt(np.diag(covariance)) * prior, len(pairs), scale, len(residual))


def differentiated(residual: Callable[[Parameters], Float[np.ndarray, " n"]], parameters: Parameters) -> Pair:
    """Return a residual [n] and its Jacobian by central differences; rows with unknown values are dropped."""
    steps = np.diag(STEPS[: len(parameters)])
    slopes = [(residual(parameters + s) - residual(parameters - s)) / (2 * s.sum()) for s in steps]
    value, slope = residual(parameters), np.stack(slopes, axis=1)
    known = np.isfinite(value) & np.isfinite(slope).all(axis=1)
    return Pair(value[known], slope[known])


def planes(
    points: Float[np.ndarray, "n 3"], tree: cKDTree, at: Float[np.ndarray, "m 3"]
) -> tuple[Float[np.ndarray, "m 3"], Bool[np.ndarray, " m"]]:
    """Return unit normals of point neighbourhoods, and a mask of the planar ones that are not a single ring."""
    if len(points) < _NEIGHBOURS or not len(at):
        return np.zeros((len(at), 3)), np.zeros(len(at), dtype=bool)
    distance, index = tree.query(at, k=_NEIGHBOURS)
    near = points[index] - points[index].mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("mki,mkj->mij", near, near) / _NEIGHBOURS)
    flat = (spread[:, 0] < 0.1 * spread[:, 1]) & (spread[:, 1] > 0.04 * spread[:, 2]) & (spread[:, 0] < 0.05**2)
    return axes[:, :, 0], flat & (distance[:, -1] < 2.0)
