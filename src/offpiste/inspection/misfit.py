"""Estimate of how far a mounting is turned and stamps are late, from residuals of many pairs of measurements.

Robust Gauss-Newton: Tukey's biweight (Beaton and Tukey, 1974) on residuals scaled by their median. The uncertainty is
that of the pairs, taken as independent of each other (a sandwich estimate, Huber 1967), plus that of the rows: what
all points of a pair share (poses, weather, a hedge in the wind) counts once a pair and not once a point.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from offpiste.core.conventions import SIGMA_PER_MEDIAN

PRIOR: Final = np.array([*np.deg2rad([5.0, 5.0, 5.0]), 0.3])
"""Standard deviation of the prior [rad, rad, rad, s]: what the data do not tell stays as uncertain as this."""
STEPS: Final = np.array([*np.deg2rad([0.05, 0.05, 0.05]), 0.04, 0.01, 0.01, 0.01])
"""Steps of the differences [rad, rad, rad, s, m, m, m]. Long in time: over less, noise of the poses would pass for
motion."""
LEAST_PAIRS: Final = 8
"""Least number of pairs: fewer do not show their own scatter."""
_BIWEIGHT: Final = 4.685
"""95 % efficient on normal errors."""

Parameters = Float[np.ndarray, " k"]
"""A turn about the body's axes [rad] and a delay [s]; where the place is sought as well, a shift along them [m]."""


@dataclass(frozen=True)
class Pair:
    """Residuals of two measurements, linear near some parameters.

    Attributes:
        residual: zero where all is right [m or px].
        slope: its derivatives by the parameters: turn [rad], lateness [s], shift [m].
    """

    residual: Float[np.ndarray, " n"]
    slope: Float[np.ndarray, "n k"]


@dataclass(frozen=True)
class Misfit:
    """Error of a sensor's mounting and stamps.

    Attributes:
        parameters: turn about the body's axes, so that the right mounting is `exp(turn) @ body_from_sensor` [rad];
            lateness: it happened so much before the time that the rig makes of the stamp [s]; shift, if sought [m].
        sigma: standard deviation of each.
        pairs: that were used.
        scale: of the residuals that remain [m or px].
        residuals: number of them.
    """

    parameters: Parameters
    sigma: Float[np.ndarray, " k"]
    pairs: int
    scale: float
    residuals: int


def turned(mounting: Float[np.ndarray, "4 4"], parameters: Parameters) -> Float[np.ndarray, "4 4"]:
    """The mounting `body_from_sensor` with its axes turned about the body's; the sensor stays where it is.

    It is shifted along the body's axes by what parameters beyond the fourth say.
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
    """The parameters that bring measurements together.

    Args:
        compare: pairs near some parameters; called once a round, each time nearer to the answer.
        prior: standard deviations about zero of what is known beforehand; as many as parameters.
        start: first parameters; zeros by default.

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
    """One linear fit, outliers weighed down; in units of the prior, so that all numbers are of one size."""
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
