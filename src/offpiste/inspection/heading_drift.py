"""Checks of the heading for drift (a growing angle to the course, as of an integrated gyroscope) and noise."""

from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.core.conventions import SIGMA_PER_MEDIAN
from offpiste.inspection.course import course_minus_heading, straight_rows
from offpiste.inspection.driven_path import DrivenPath, heading_name
from offpiste.inspection.findings import Finding, found
from offpiste.inspection.lags import SURE, fit_lags
from offpiste.logs.drive import Drive
from offpiste.logs.motion import heading

_DRIFT: Final = np.radians(6.0)
"""Minimum reported change over the whole drive [rad]."""
_BLOCKS: Final = 6
"""Minimum number of 5 s blocks with straight driving for a drift."""
_MANY_BLOCKS: Final = 8
"""Minimum number of blocks if the drift rate is searched, as few angles fit some rate by chance."""
_FASTEST: Final = np.radians(10.0)
"""Maximum drift rate searched if the heading does not follow the course [rad/s]."""
_EVENLY: Final = 0.9
"""Minimum resultant of angles after removal of a constant drift rate."""
_NOISY: Final = 0.02
"""Minimum reported scatter of headings [rad]: ten times that of compasses, GNSS/INS and SLAM."""


def check_heading_drift(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding if the angle between course and heading significantly grows in straight driving."""
    rows = straight_rows(path)
    if not rows.any():
        return []
    elapsed = path.time - path.time[0]
    away = course_minus_heading(path)
    # Tyre slip has opposite signs in left and right curves, which may be unevenly distributed over the drive.
    slip = np.column_stack((np.ones(len(away)), path.yaw_rate, path.forward * path.yaw_rate))
    fit = fit_lags(away, slip, elapsed[None], np.zeros(1), rows)
    if fit is None or len(fit.gain_left_out) < _BLOCKS:
        return []
    lasts = float(np.ptp(path.time[rows]))
    change, sigma = float(fit.gain[0]) * lasts, fit.gain_sigma(0) * lasts
    if abs(change) < _DRIFT + SURE * sigma:
        return []
    degrees = f"{np.degrees(-change):.0f} ± {np.degrees(sigma):.0f}"
    return [found("heading_drifts", heading_name(drive), {"degrees": degrees, "seconds": lasts})]


def check_fast_drift(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding if a heading follows the course only after removal of a constant drift rate."""
    rows = np.flatnonzero(straight_rows(path))
    if len(np.unique(path.time[rows] // 5)) < _MANY_BLOCKS:
        return []
    away, time = course_minus_heading(path)[rows], path.time[rows]
    rate, together = _even_turning(away, time)
    # On a circle, the course turns at a constant rate, and so does its angle to a constant heading.
    turning, circles = _even_turning(away + path.yaw[rows], time)
    lasts = float(np.ptp(time))
    if together < _EVENLY or abs(rate) * lasts < _DRIFT:
        return []
    if circles >= _EVENLY and abs(turning - rate) < 0.2 * abs(rate):
        return []
    degrees = f"{np.degrees(-rate) * lasts:.0f}"
    return [found("heading_drifts", heading_name(drive), {"degrees": degrees, "seconds": lasts})]


def _even_turning(angle: Float[np.ndarray, " n"], time: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Return the drift rate that best explains angles modulo pi [rad/s], and the remaining resultant (0 to 1)."""
    lasts = float(np.ptp(time))
    rates = np.arange(-_FASTEST, _FASTEST, np.pi / (8 * lasts))
    some = np.unique(np.linspace(0, len(time) - 1, 2000).astype(int))
    turned = [np.abs(np.mean(np.exp(2j * (angle[some] - rate * time[some])))) for rate in rates]
    best = int(np.argmax(turned))
    return float(rates[best]), float(turned[best])


def check_heading_noise(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding if headings scatter between samples while the vehicle moves."""
    yaw = heading(drive)
    moving = np.interp(yaw.time, path.time, np.nan_to_num(path.speed)) > path.slowest
    third = np.abs(np.diff(yaw.values[:, 0], 3))[moving[3:]]
    if len(third) < 100:
        return []
    # Third differences of white noise have 20 times its variance and suppress turning.
    sigma = SIGMA_PER_MEDIAN * float(np.median(third)) / np.sqrt(20)
    if sigma < _NOISY:
        return []
    return [found("heading_noisy", heading_name(drive), {"degrees": np.degrees(sigma)})]
