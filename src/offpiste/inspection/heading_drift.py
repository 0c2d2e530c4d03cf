"""Checks of the heading for drift (an angle against the course that grows, as an integrated gyroscope's) and noise."""

from typing import Final

import numpy as np

from offpiste.inspection.course import course_minus_heading, straight_rows
from offpiste.inspection.driven_path import Path
from offpiste.inspection.findings import Finding
from offpiste.inspection.lags import SURE, fit_lags
from offpiste.logs.drive import Drive
from offpiste.logs.motion import heading

_DRIFT: Final = np.radians(6.0)
"""Change over the whole drive that is reported [rad]."""
_BLOCKS: Final = 6
"""Stretches of 5 s with straight driving that a drift is seen in, at least."""
_NOISY: Final = 0.02
"""Scatter of single headings that is reported [rad]: ten times that of compasses, GNSS/INS and SLAM."""


def check_heading_drift(drive: Drive, path: Path) -> list[Finding]:
    """A finding if the angle between course and heading surely grows where the vehicle drives straight."""
    rows = straight_rows(path)
    if not rows.any():
        return []
    elapsed = path.time - path.time[0]
    away = course_minus_heading(path)
    fit = fit_lags(away, np.ones((len(away), 1)), elapsed[None], np.zeros(1), rows)
    if fit is None or len(fit.gain_left_out) < _BLOCKS:
        return []
    lasts = float(np.ptp(path.time[rows]))
    change, sigma = float(fit.gain[0]) * lasts, fit.gain_sigma(0) * lasts
    if abs(change) < _DRIFT + SURE * sigma:
        return []
    name = "yaw" if "yaw" in drive.channels else "orientation"
    evidence = f"against the course it turns by {np.degrees(-change):.0f} ± {np.degrees(sigma):.0f} degrees in "
    evidence += f"{lasts:.0f} s, where the vehicle drives straight"
    how = "no rig line fixes it: take a heading that is corrected by a compass, GNSS or SLAM"
    return [Finding("warning", name, "the heading drifts", evidence, how, 0.6)]


def check_heading_noise(drive: Drive, path: Path) -> list[Finding]:
    """A finding if headings scatter from sample to sample while the vehicle moves."""
    yaw = heading(drive)
    moving = np.interp(yaw.time, path.time, np.nan_to_num(path.speed)) > path.slowest
    third = np.abs(np.diff(yaw.values[:, 0], 3))[moving[3:]]
    if len(third) < 100:
        return []
    # Third differences of white noise have 20 times its variance; turning hardly shows in them.
    sigma = 1.4826 * float(np.median(third)) / np.sqrt(20)
    if sigma < _NOISY:
        return []
    name = "yaw" if "yaw" in drive.channels else "orientation"
    evidence = f"single headings scatter by {np.degrees(sigma):.1f} degrees while the vehicle moves"
    how = "take a smoother heading: every prediction starts from one of these"
    return [Finding("warning", name, "the heading is noisy", evidence, how, 0.6)]
