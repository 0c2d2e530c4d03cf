"""What the steering's command and the measured angle of the wheels say of each other's scale.

No tyre slips between the two: their ratio is known far better than that of either to the turning of the vehicle.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.inspection.driven_path import STEP, DrivenPath
from offpiste.inspection.lags import LAGS, SURE, fit_lags, lagged, sampled
from offpiste.logs.drive import Drive

_AVERAGED: Final = 1.0
"""Time over which both are averaged: actuators follow quick steering in part only [s]."""
_CLEAR: Final = 0.9
"""Correlation above which the ratio is clear."""
_SHARES: Final = (0.8, 1.25)
"""Angle over the command times `max_steer`: linkages are not quite linear, and `max_steer` is read off a data sheet."""


@dataclass(frozen=True)
class Agreement:
    """The wheels' angle by the command, at the lag that explains most.

    Attributes:
        share: angle over the command times the rig's `max_steer`, whatever their signs.
        sigma: its standard deviation.
        strength: correlation of the two.
    """

    share: float
    sigma: float
    strength: float

    @property
    def is_off(self) -> bool:
        """Whether one of the two surely has another scale than the rig says."""
        margin = SURE * self.sigma
        inside = _SHARES[0] - margin < self.share < _SHARES[1] + margin
        return self.strength >= _CLEAR and np.isfinite(margin) and not inside


def agreement(drive: Drive, path: DrivenPath) -> Agreement | None:
    """Compare `steer` and `steer_angle`; None where the log lacks one of them, or one rests."""
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
    """Means over `_AVERAGED` around each value; NaN where one of them is unknown."""
    count = round(_AVERAGED / STEP) + 1
    result = np.full(len(values), np.nan)
    if len(values) >= count:
        inside = slice(count // 2, len(values) - count // 2)
        result[inside] = np.convolve(values, np.full(count, 1 / count), "valid")
    return result
