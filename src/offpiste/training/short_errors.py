"""Errors of short predictions along recorded drives: what slow context (`dynamics.slow_context`) learns from."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import torch
from jaxtyping import Float, Int

from offpiste.core.conventions import DT, SIGMA_PER_MEDIAN
from offpiste.dataset.windows import Windows
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.slow_context import SHIFTED, ContextSettings, SlowContext, shifted
from offpiste.training.prediction import batch_for, predict

RATES: Final = slice(3, 6)
"""vx, vy and the yaw rate in a state: what a wheel's force changes first."""

SMOOTHED: Final = 1.0
"""Recorded states are smoothed by what came after them: so much later they count as known [s]."""

KNOWN: Final = "0"
"""Feature set of what had been seen when the vehicle got there; later views are none that it had."""

STEP: Final = 0.2
"""Shift by which derivatives are taken."""

AT_ONCE: Final = 2048
"""Short predictions side by side."""

ENOUGH: Final = 20_000
"""Short predictions from which the noise of a run is known."""


@dataclass(frozen=True)
class ShortErrors:
    """Errors of short predictions and what shifts of the constants would have changed.

    Attributes:
        drive, row: number of the drive, and row in it, that each began at.
        error: recorded less predicted vx, vy [m/s], yaw rate [rad/s].
        jacobian: of the prediction by the F shifts (`SHIFTED`), which have no unit.
    """

    drive: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    error: Float[np.ndarray, "n 3"]
    jacobian: Float[np.ndarray, "n 3 F"]

    @property
    def noise(self) -> Float[np.ndarray, " 3"]:
        """Standard deviation of the errors, whatever their mean, in spite of outliers."""
        return np.asarray(SIGMA_PER_MEDIAN * np.median(np.abs(self.error), axis=0))


@torch.no_grad()
def short_errors(
    dynamics: Dynamics, windows: Windows, settings: ContextSettings | None = None, *, most: int | None = None
) -> ShortErrors:
    """Errors of short predictions along the drives of some windows, which read the ground where it was driven.

    Args:
        most: so many of them, evenly spread; None: all.

    Raises:
        RunError: the model has no constants to shift.
    """
    settings = settings or ContextSettings()
    if windows.sets > 1:
        windows = windows.with_feature_set(KNOWN)
    index, steps = windows.every(round(settings.interval / DT)), round(settings.horizon / DT)
    if most is not None and len(index) > most:
        index = index[np.unique(np.linspace(0, len(index) - 1, most).astype(int))]
    moved = [shifted(dynamics, STEP * row) for row in np.eye(len(SHIFTED))]
    errors, jacobians = [], []
    for first in range(0, len(index), AT_ONCE):
        batch = batch_for(dynamics, windows, windows.gather(index[first : first + AT_ONCE]))
        batch = replace(
            batch,
            control=batch.control[:, :steps],
            terrain=batch.terrain.rows(slice(steps)),
            target=batch.target[:, :steps],
            target_actuators=batch.target_actuators[:, :steps],
            ground=None if batch.ground is None else replace(batch.ground, ahead=batch.ground.ahead[:, :steps]),
        )
        here, *others = (predict(model, batch).state[:, -1, RATES] for model in (dynamics, *moved))
        errors.append(batch.target[:, -1, RATES] - here)
        jacobians.append(torch.stack([(other - here) / STEP for other in others], dim=-1))
    error, jacobian = (torch.cat(each).cpu().double().numpy() for each in (errors, jacobians))
    return ShortErrors(windows.drive[index], windows.row_in_drive(index), error, jacobian)


def shifts_of(
    short: ShortErrors,
    windows: Windows,
    index: Int[np.ndarray, " n"],
    noise: Float[np.ndarray, " 3"],
    settings: ContextSettings,
) -> Float[np.ndarray, "n F"]:
    """Shifts at the start of windows, by the short predictions of their drive that had come true by then.

    Args:
        index: of the windows.
        noise: of `SlowContext`; of the drives that trained (`ShortErrors.noise`).
    """
    result = np.zeros((len(index), len(SHIFTED)))
    rows, known = windows.row_in_drive(index), known_from(short, settings)
    for drive in np.unique(windows.drive[index]):
        mine = np.flatnonzero(windows.drive[index] == drive)
        past = np.flatnonzero(short.drive == drive)
        past = past[np.argsort(short.row[past])]
        context, following = SlowContext(noise, 0.0, settings), 0
        for number in mine[np.argsort(rows[mine])]:
            now = rows[number] * DT
            while following < len(past) and known[past[following]] <= now + 1e-9:
                one = past[following]
                context.add(float(short.row[one] * DT), short.error[one], short.jacobian[one])
                following += 1
            result[number] = context.shift(float(now))
    return result


def known_from(short: ShortErrors, settings: ContextSettings) -> Float[np.ndarray, " n"]:
    """When the error of each short prediction is known [s]."""
    return short.row * DT + settings.horizon + SMOOTHED


def noise_of(dynamics: Dynamics, windows: Windows) -> list[float] | None:
    """`ShortErrors.noise` of training windows; None of a model without physical constants, or where it is nothing."""
    if dynamics.kernel_parts() is None or not len(windows.every(round(ContextSettings().interval / DT))):
        return None
    noise = short_errors(dynamics, windows, most=ENOUGH).noise
    return noise.tolist() if (noise > 0).all() and np.isfinite(noise).all() else None
