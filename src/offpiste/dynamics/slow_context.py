"""Slow context: what the errors of the last seconds tell about vehicle, load and weather.

The bicycle's constants are those of the training drives. On another day the same throttle gives another force, a loaded
vehicle brakes worse, wet ground rolls harder. A few shifts of these constants explain the errors of short predictions
that have come true by now; they are found by recursive least squares with exponential forgetting (Ljung, System
Identification, 2nd ed., section 11.2) around the constants as they were learned, which they return to where the errors
say nothing.

Shifts are added to the constants' unconstrained parameters (`bicycle.BicycleConstants`), so that every constant stays
within its physical range.
"""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from jaxtyping import Float

from offpiste.core.errors import RunError
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.bicycle import parameter_rows

SHIFTED: Final[dict[str, tuple[str, ...]]] = {
    "drive": ("drive_1", "drive_bend"),
    "brake": ("brake_1", "brake_2"),
    "resistance": ("resistance",),
    "grip": ("rear_peak", "front_peak"),
    "steering": ("yaw_understeer",),
}
"""Constants that are shifted together, by name of the shift."""


@dataclass(frozen=True)
class ContextSettings:
    """Settings of the slow context.

    Attributes:
        horizon: of the predictions whose errors are looked at [s].
        interval: from the start of one to that of the next [s].
        memory: time constant of forgetting [s].
        spread: standard deviation of each shift before anything is known; 0.5 is a tenth to a half of a constant.
        doubt: how many times less an error counts than if all were independent and came from the constants alone.
        outlier: errors beyond so many standard deviations count in proportion less (Huber).
        limit: largest shift.
    """

    horizon: float = 0.5
    interval: float = 0.1
    memory: float = 30.0
    spread: float = 0.5
    doubt: float = 25.0
    outlier: float = 2.0
    limit: float = 2.0


class SlowContext:
    """Shifts of the constants, from errors as they become known.

    Args:
        noise: standard deviations of the errors where the constants are right: vx, vy [m/s], yaw rate [rad/s].
        time: from which on errors will come [s].
        settings: how errors are looked at and forgotten.
    """

    def __init__(self, noise: Float[np.ndarray, " 3"], time: float, settings: ContextSettings | None = None) -> None:
        self._settings = settings or ContextSettings()
        self._noise, self._time = np.asarray(noise, dtype=np.float64), time
        count = len(SHIFTED)
        self._information, self._vector = np.zeros((count, count)), np.zeros(count)

    def add(self, time: float, error: Float[np.ndarray, " 3"], jacobian: Float[np.ndarray, "3 F"]) -> None:
        """Take in the error of a prediction; one that is not finite is left out.

        Args:
            time: when the prediction began [s]; not before that of the error before.
            error: what was measured less what the unshifted model predicted: vx, vy [m/s], yaw rate [rad/s].
            jacobian: derivatives of the prediction by the F shifts of `SHIFTED`, which have no unit.
        """
        if not (np.isfinite(error).all() and np.isfinite(jacobian).all()):
            return
        settings = self._settings
        kept = np.exp((self._time - time) / settings.memory)
        scaled, slopes = error / self._noise, jacobian / self._noise[:, None]
        weight = np.minimum(1.0, settings.outlier / np.maximum(np.abs(scaled), 1e-9)) / settings.doubt
        self._information = kept * self._information + slopes.T @ (weight[:, None] * slopes)
        self._vector = kept * self._vector + slopes.T @ (weight * scaled)
        self._time = time

    def shift(self, time: float) -> Float[np.ndarray, " F"]:
        """The most probable shifts at a moment [s], in the order of `SHIFTED`."""
        settings = self._settings
        kept = np.exp((self._time - time) / settings.memory)
        prior = np.eye(len(self._vector)) / settings.spread**2
        shift = np.linalg.solve(kept * self._information + prior, kept * self._vector)
        return np.asarray(shift.clip(-settings.limit, settings.limit))


def shifted(dynamics: Dynamics, shift: Sequence[float] | Float[np.ndarray, " F"]) -> Dynamics:
    """A copy of a model with its bicycle's constants shifted, in the order of `SHIFTED`.

    Raises:
        RunError: the model has no bicycle.
    """
    result = deepcopy(dynamics)
    parts = result.kernel_parts()
    if parts is None:
        raise RunError("the model has no physical constants to shift", how="give one with a bicycle, as b or dc")
    with torch.no_grad():
        for names, by in zip(SHIFTED.values(), shift, strict=True):
            parts.bicycle.raw[parameter_rows(names)] += float(by)
    return result
