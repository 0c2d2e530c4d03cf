"""Delays of the turning behind the steering, by stretches: clocks that drift, copies that are late by turns."""

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
"""Length of a stretch [s]; each begins in the middle of the one before."""
_TURNS: Final = 0.5
"""Spread of a stretch's yaw rates over the drive's, at least."""
_FITS: Final = 0.85
"""Correlation of the turning with the steering in a stretch, at least."""
_SHARP: Final = (0.2, 0.005)
"""So much away from the best delay [s] this much less of the variance is explained, at least: a steering that is moved
slowly fits at any delay."""
_FEW: Final = 5
"""Stretches that show a change ..."""
_EARLY: Final = 3
"""Stretches in which the motion comes first, at least: one event lies in two that overlap."""
_SEVERAL: Final = 8
"""... and a slight one."""
_DRIFT: Final = 0.15
"""Change of the delay over the drive that is surely exceeded [s]; of 60 healthy channels none exceeds 0.08."""
_SLOWER: Final = 0.8
"""Change of the delay that a vehicle's own steering does not make [s]; the largest of healthy logs is 0.54."""
_WIDE: Final = (0.35, 25.0, -0.2)
"""Width of the delays (10 to 90 %) that is a change [s], and how early the motion comes [s] in this share [%] then: a
vehicle does not turn before it is steered."""
_SLIGHT: Final = (0.2, 10.0, -0.1)
"""The same of a slight change."""
_MIDDLE: Final = 0.15
"""Median of the delays up to which a slight change counts: where most are usual, few stretches deceive [s]."""


@dataclass(frozen=True)
class WindowDelays:
    """Steering delay in each segment with sufficient yaw rate.

    Attributes:
        time: middle of the stretch [s].
        delay: of the yaw rate behind speed times steering [s].
    """

    time: Float[np.ndarray, " w"]
    delay: Float[np.ndarray, " w"]

    @property
    def words(self) -> str:
        """The delays in words."""
        low, middle, high = np.percentile(self.delay, (10, 50, 90))
        spread = f"{low:+.2f} to {high:+.2f} s after it (10 to 90 %, median {middle:+.2f})"
        return f"the motion comes {spread} in {len(self.delay)} stretches of {_WINDOW:.0f} s"


def window_delays(channel: Channel, path: DrivenPath, rig: Rig) -> WindowDelays:
    """Delays by stretches, of those in which the vehicle turns enough and as it is steered."""
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
    """Whether other delays explain less."""
    away, less = _SHARP
    beside = np.abs(np.abs(fit.lags - fit.lags[best]) - away) < 1e-6
    return bool((fit.r[best] ** 2 - fit.r[beside] ** 2 > less).all())


def changing_delay(name: str, delays: WindowDelays) -> list[Finding]:
    """A warning if the delay grows or shrinks all along, or differs widely and the motion comes first in some."""
    if len(delays.delay) < _FEW:
        return []
    from scipy.stats import theilslopes  # here, because it takes a third of a second

    slope, _, least, most = theilslopes(delays.delay, delays.time, 0.99)
    lasts = float(np.ptp(delays.time))
    if max(least, -most) * lasts > _DRIFT:
        evidence = f"{delays.words}, and {slope * lasts:+.2f} s more at the end than at the beginning "
        evidence += f"({least * lasts:+.2f} to {most * lasts:+.2f}, 99 %)"
        how = "no constant delay fixes it: record it with the clock of the pose, or align its clock with [alignment]"
        # A steering may be slow at times; nothing turns before it is steered.
        own = np.percentile(delays.delay, 10) >= 0 and abs(slope) * lasts < _SLOWER
        return [Finding("note" if own else "warning", name, "has a clock that drifts", evidence, how, 0.9)]
    return _uneven(name, delays, *_WIDE)


def uneven_delay(name: str, delays: WindowDelays) -> list[Finding]:
    """A warning if the delay differs slightly between stretches, where no constant delay is wrong."""
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
