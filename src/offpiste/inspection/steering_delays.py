"""Delay of the yaw rate behind the steering by segment, to detect drifting clocks and copies of varying lag."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from offpiste.inspection.driven_path import DrivenPath
from offpiste.inspection.findings import Finding
from offpiste.inspection.lags import LAGS, LagFit, fit_lags, lagged
from offpiste.inspection.steering_fit import moving_rows
from offpiste.logs.channel import Channel
from offpiste.rig.rig import Rig

_WINDOW: Final = 8.0
"""Length of a segment [s]; segments overlap by half."""
_TURNS: Final = 0.5
"""Minimum standard deviation of the yaw rate in a segment, as a share of that of the drive."""
_FITS: Final = 0.85
"""Minimum correlation of yaw rate and steering in a segment."""
_SHARP: Final = (0.2, 0.005)
"""Distance from the best delay [s] and minimum loss of explained variance there; slow steering fits at any delay."""
_FEW: Final = 5
"""Minimum number of segments for a clear change of the delay."""
_EARLY: Final = 3
"""Minimum number of segments with motion before steering; one event affects two overlapping segments."""
_SEVERAL: Final = 8
"""Minimum number of segments for a slight change of the delay."""
_DRIFT: Final = 0.15
"""Minimum significant change of the delay over the drive [s]; 60 fault-free channels stay below 0.08."""
_SLOWER: Final = 0.8
"""Maximum change of the delay due to the vehicle's actuator [s]; the largest in fault-free logs is 0.54."""
_WIDE: Final = (0.35, 25.0, -0.2)
"""Clear change of the delay: minimum 10-90 % range [s], and minimum share of segments [%] with a delay below the last
value [s], as a vehicle does not turn before it is steered."""
_SLIGHT: Final = (0.2, 10.0, -0.1)
"""The same for a slight change."""
_MIDDLE: Final = 0.15
"""Maximum median delay for a slight change [s]."""


@dataclass(frozen=True)
class WindowDelays:
    """Steering delay in each segment with sufficient yaw rate.

    Attributes:
        time: middle of the segment [s].
        delay: delay of the yaw rate behind speed times steering [s].
    """

    time: Float[np.ndarray, " w"]
    delay: Float[np.ndarray, " w"]

    @property
    def words(self) -> str:
        """Description of the delays for findings."""
        low, middle, high = np.percentile(self.delay, (10, 50, 90))
        spread = f"{low:+.2f} to {high:+.2f} s after it (10 to 90 %, median {middle:+.2f})"
        return f"the motion comes {spread} in {len(self.delay)} stretches of {_WINDOW:.0f} s"


def window_delays(channel: Channel, path: DrivenPath, rig: Rig) -> WindowDelays:
    """Estimate the delay in each segment where the vehicle turns sufficiently and follows the steering."""
    turning = path.forward * lagged(channel, path.time, rig)
    usual = np.nanstd(path.yaw_rate[moving_rows(path)])
    found = []
    for start in np.arange(path.time[0], path.time[-1] - _WINDOW, _WINDOW / 2):
        rows = slice(*np.searchsorted(path.time, (start, start + _WINDOW)))
        yaw_rate = path.yaw_rate[rows]
        if not np.isfinite(yaw_rate).any() or np.nanstd(yaw_rate) < _TURNS * usual:
            continue
        every: Bool[np.ndarray, " n"] = np.ones(len(yaw_rate), bool)
        fit = fit_lags(yaw_rate, path.forward[rows, None], turning[:, rows], LAGS, every)
        if fit is None:
            continue
        best = fit.best()
        if abs(fit.r[best]) > _FITS and 0 < best < len(LAGS) - 1 and _is_sharp(fit, best):
            found.append((start + _WINDOW / 2, fit.delay(best)[0]))
    time, delay = np.array(found).reshape(-1, 2).T
    return WindowDelays(time, delay)


def _is_sharp(fit: LagFit, best: int) -> bool:
    """Return whether other delays explain significantly less variance."""
    away, less = _SHARP
    beside = np.abs(np.abs(fit.lags - fit.lags[best]) - away) < 1e-6
    return bool((fit.r[best] ** 2 - fit.r[beside] ** 2 > less).all())


def changing_delay(name: str, delays: WindowDelays) -> list[Finding]:
    """Return a warning if the delay drifts, or if it varies widely and is negative in some segments."""
    if len(delays.delay) < _FEW:
        return []
    from scipy.stats import theilslopes  # imported here since it takes a third of a second

    slope, _, least, most = theilslopes(delays.delay, delays.time, 0.99)
    lasts = float(np.ptp(delays.time))
    if max(least, -most) * lasts > _DRIFT:
        evidence = f"{delays.words}, and {slope * lasts:+.2f} s more at the end than at the beginning "
        evidence += f"({least * lasts:+.2f} to {most * lasts:+.2f}, 99 %)"
        how = "no constant delay fixes it: record it with the clock of the pose, or align its clock with [alignment]"
        # A slow actuator may delay the motion, but no vehicle turns before it is steered.
        own = np.percentile(delays.delay, 10) >= 0 and abs(slope) * lasts < _SLOWER
        return [Finding("note" if own else "warning", name, "has a clock that drifts", evidence, how, 0.9)]
    return _uneven(name, delays, *_WIDE)


def uneven_delay(name: str, delays: WindowDelays) -> list[Finding]:
    """Return a warning if the delay varies slightly between segments and its median is small."""
    if len(delays.delay) < _SEVERAL or np.median(delays.delay) > _MIDDLE:
        return []
    return _uneven(name, delays, *_SLIGHT)


def _uneven(name: str, delays: WindowDelays, spread: float, share: float, before: float) -> list[Finding]:
    low, high = np.percentile(delays.delay, (10, 90))
    first = int((delays.delay <= before).sum())
    if high - low < spread or first < max(_EARLY, share / 100 * len(delays.delay)):
        return []
    how = "use another source for it (a command that follows the motion is a late copy), or align its clock"
    return [Finding("warning", name, "has a delay that changes", delays.words, how + " with [alignment]", 0.9)]
