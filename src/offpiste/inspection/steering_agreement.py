"""Comparison of the scales of the steering command and the measured wheel angle.

Tyre slip does not affect their ratio, which is therefore known more accurately than the response of the vehicle.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.inspection.driven_path import STEP, DrivenPath
from offpiste.inspection.lags import LAGS, SURE, fit_lags, lagged, sampled
from offpiste.logs.drive import Drive

_AVERAGED: Final = 1.0
"""Averaging time [s]; actuators follow fast steering only partly."""
_CLEAR: Final = 0.9
"""Minimum correlation for estimating the ratio."""
_SHARES: Final = (0.8, 1.25)
"""Range of angle / (command * `max_steer`): linkages are nonlinear, and `max_steer` comes from a data sheet."""


@dataclass(frozen=True)
class Agreement:
    """Fit of the wheel angle to the command at the lag with the highest correlation.

    Attributes:
        share: absolute ratio of the angle to command times `max_steer`.
        sigma: standard deviation of `share`.
        strength: correlation of angle and command.
    """

    share: float
    sigma: float
    strength: float

    @property
    def is_off(self) -> bool:
        """Return whether the scale of one of the two clearly differs from the rig."""
        margin = SURE * self.sigma
        inside = _SHARES[0] - margin < self.share < _SHARES[1] + margin
        return self.strength >= _CLEAR and np.isfinite(margin) and not inside


def agreement(drive: Drive, path: DrivenPath) -> Agreement | None:
    """Compare `steer` and `steer_angle`; None if one of them is missing or constant."""
    if "steer" not in drive.channels or "steer_angle" not in drive.channels:
        return None
    angle = _averaged(sampled(drive.channels["steer_angle"], path.time, drive.rig))
    command = np.stack([_averaged(row) for row in lagged(drive.channels["steer"], path.time, drive.rig)])
    level, every = np.ones((len(path.time), 1)), np.ones(len(path.time), bool)
    fit = fit_lags(angle, level, command, LAGS, every)
    if fit is None or drive.rig.vehicle.max_steer <= 0:
        return None
    best, full = fit.best(), drive.rig.vehicle.max_steer
    return Agreement(abs(float(fit.gain[best])) / full, fit.gain_sigma(best) / full, fit.strength)


def _averaged(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return moving averages over `_AVERAGED`; NaN if a value is unknown."""
    count = round(_AVERAGED / STEP) + 1
    result = np.full(len(values), np.nan)
    if len(values) >= count:
        inside = slice(count // 2, len(values) - count // 2)
        result[inside] = np.convolve(values, np.full(count, 1 / count), "valid")
    return result
