"""Checks of the delay between a control and the motion: implausible, drifting or changing."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from offpiste.inspection.driven_path import DrivenPath
from offpiste.inspection.findings import Cure, Finding, found
from offpiste.inspection.lags import LAGS, SURE, LagFit, fit_lags, lagged
from offpiste.inspection.response import Prior, moving_rows, prior
from offpiste.logs.channel import Channel
from offpiste.rig.edits import Edit
from offpiste.rig.labels import is_measured_steering
from offpiste.rig.rig import Rig

_OUTSIDE: Final = 0.05
"""Minimum distance of a reported delay from the plausible ones [s]: one step of the lags, and usual pose delays."""
_CLEARER: Final = 0.03
"""Minimum gain in explained variance of motion before a pedal over plausible delays."""
_LATE_CLEARER: Final = (0.2, 0.1)
"""Minimum gains in correlation and in explained variance of late motion: drifts and spinning wheels may cause it."""
_WINDOW: Final = 8.0
"""Length of a segment [s]; segments overlap by half."""
_TURNS: Final = 0.5
"""Minimum standard deviation of the yaw rate in a segment, as a share of that of the drive."""
_FITS: Final = 0.85
"""Minimum correlation of yaw rate and steering in a segment."""
_SHARP: Final = (0.2, 0.005)
"""Distance from the best delay [s] and minimum loss of explained variance there; slow steering fits at any delay."""
_FEW, _SEVERAL = 5, 8
"""Minimum numbers of segments for a drift and for a changing delay."""
_DRIFT: Final = 0.15
"""Minimum significant change of the delay over the drive [s]; 60 fault-free channels stay below 0.08."""
_SLOWER: Final = 0.8
"""Maximum change of the delay due to the vehicle's actuator [s]; the largest in fault-free logs is 0.54."""
_SPREAD: Final = 0.2
"""Minimum 10-90 % range of a changing delay [s]."""
_BEFORE, _OFTEN, _EARLY = -0.1, 0.1, 3
"""Maximum delay of motion that comes before its steering [s], and its minimum share and number of segments; one event
affects two overlapping segments."""
_MIDDLE: Final = 0.15
"""Maximum median of a changing delay [s]."""


def check_delay(name: str, fit: LagFit, rig: Rig, *, sign: int, steady: LagFit | None = None) -> list[Finding]:
    """Return a finding if the motion is earlier or later than the vehicle's own response.

    Args:
        sign: of the effect; 0 if unknown.
        steady: fit that has to agree: kinks of clipped or coarse steering shift the dynamic fit alone.
    """
    own = prior(name, rig)
    outside, best, inside = _outside(fit, own.delays, sign), fit.best(sign=sign), fit.best(*own.delays, sign=sign)
    if not outside or abs(fit.r[best]) < own.clear:
        return []
    if steady is not None and _outside(steady, own.delays, sign) != outside:
        return []
    if steady is None:
        more, least = _LATE_CLEARER if outside > 0 else (0.0, _CLEARER)
        gained, gained_sigma = fit.gained(best, inside)
        if abs(fit.r[best]) < own.clear + more or gained < max(SURE * gained_sigma, least):
            return []
    lag, sigma = fit.delay(best)
    about = {"delay": abs(lag), "sigma": sigma, "best": fit.r[best] ** 2, "usual": fit.r[inside] ** 2}
    about["at"], cures, score = fit.lags[inside], _delay_cures(name, lag, own, rig), min(abs(lag), 1.0)
    if lag > 0:
        return [found("control_early", name, about, *cures, score=score)]
    fixed = "fixed" if is_measured_steering(name, rig) else "copied"
    return [found("control_late", name, about, *cures, score=score, fixed=fixed)]


def _outside(fit: LagFit, plausible: tuple[float, float], sign: int) -> int:
    """Return 1 if the best lag is clearly later than the plausible ones, -1 if it is earlier, 0 otherwise."""
    best = fit.best(sign=sign)
    if best in (0, len(fit.lags) - 1):  # no maximum: slow signals fit anywhere
        return 0
    lag, sigma = fit.delay(best)
    least = max(SURE * sigma, _OUTSIDE)
    return int(lag > plausible[1] + least) - int(lag < plausible[0] - least)


def _delay_cures(name: str, lag: float, own: Prior, rig: Rig) -> tuple[Cure, ...]:
    """Return candidate delays that restore the usual response, first no delay if the rig's own delay is the fault.

    Args:
        lag: present lag of the motion behind the channel [s].
    """
    stated = rig.channels[name].delay
    delays = [round(stated - lag + own.usual, 2)]
    if stated and own.delays[0] <= lag - stated <= own.delays[1]:
        delays.insert(0, 0.0)
    alike = ["steer"] if name == "steer_angle" and rig.reads_alike("steer", "steer_angle") else []
    return tuple(tuple(Edit(f"channels.{channel}.delay", delay) for channel in (name, *alike)) for delay in delays)


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


def drifting_delay(name: str, delays: WindowDelays) -> list[Finding]:
    """Return a warning if the delay drifts; a note if a slow actuator may cause it."""
    if len(delays.delay) < _FEW:
        return []
    from scipy.stats import theilslopes  # imported here since it takes a third of a second

    slope, _, least, most = theilslopes(delays.delay, delays.time, 0.99)
    lasts = float(np.ptp(delays.time))
    if max(least, -most) * lasts <= _DRIFT:
        return []
    about = {"delays": delays.words, "change": slope * lasts, "least": least * lasts, "most": most * lasts}
    # A slow actuator may delay the motion, but no vehicle turns before it is steered.
    own = np.percentile(delays.delay, 10) >= 0 and abs(slope) * lasts < _SLOWER
    return [found("steering_clock", name, about, severity="note" if own else "warning")]


def changing_delay(name: str, delays: WindowDelays) -> list[Finding]:
    """Return a warning if the delay varies and the motion repeatedly comes before the steering."""
    if len(delays.delay) < _SEVERAL or np.median(delays.delay) > _MIDDLE:
        return []
    low, high = np.percentile(delays.delay, (10, 90))
    before = int((delays.delay <= _BEFORE).sum())
    if high - low < _SPREAD or before < max(_EARLY, _OFTEN * len(delays.delay)):
        return []
    return [found("changing_delay", name, {"delays": delays.words})]
