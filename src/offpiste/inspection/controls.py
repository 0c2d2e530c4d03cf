"""The controls together: whether there is steering, and whether any of them has an effect."""

import numpy as np

from offpiste.channels import CONTROLS, all_controls
from offpiste.inspection.driven_path import Path
from offpiste.inspection.findings import Finding
from offpiste.inspection.lags import LAGS, fit_lags, lagged
from offpiste.inspection.pedals import changes_speed
from offpiste.inspection.pose import heading_fits
from offpiste.inspection.steering import turns_vehicle
from offpiste.logs.drive import Drive

_EFFECT = 0.2
"""Correlation with speed or yaw rate above which a control of another vehicle has an effect."""


def check_controls(drive: Drive, path: Path, *, given: bool) -> list[Finding]:
    """Findings where there is no steering, or where no control has any effect.

    Args:
        given: whether the rig was given, not guessed.
    """
    findings: list[Finding] = []
    # Where the heading does not follow the course, turning tells nothing.
    steers = turns_vehicle(drive, path) if heading_fits(path) else True
    drives = changes_speed(drive, path)
    if "steer" not in drive.channels and drives:
        what, evidence = "there is no steering", "pedals alone do not tell where the vehicle goes"
        remedy = "add [channels.steer] with the topic that holds it: commanded, or else measured"
        evidence += "" if given else "; no field is named so: a rig can name it, and without it nothing can be trained"
        # Without a rig only names were guessed, and the topic may have another.
        findings.append(Finding("fatal" if given else "warning", "controls", what, evidence, remedy, 1.0))
    if not steers and not drives and not _others_work(drive, path):
        present = [control.name for control in all_controls() if control.name in drive.channels]
        what = "no control has any effect" if present else "there is no control channel"
        evidence = f"checked: {', '.join(present) or 'none'}; {path.distance:.0f} m driven"
        remedy = "add [channels.steer] and [channels.throttle] with the topics that hold them"
        findings.append(Finding("fatal", "controls", what, evidence, remedy, 1.0))
    return findings


def _others_work(drive: Drive, path: Path) -> bool:
    """Whether a control beyond throttle, brake and steering (`offpiste.channels`) drives or turns the vehicle."""
    one, moving = np.ones((len(path.time), 1)), np.isfinite(path.speed)
    for control in (control for control in all_controls() if control not in CONTROLS):
        channel = drive.channels.get(control.name)
        if channel is None or np.ptp(channel.values) == 0:
            continue
        commands = lagged(channel, path.time, drive.rig)
        for motion in (path.forward, path.yaw_rate):
            fit = fit_lags(motion, one, commands, LAGS, moving)
            if fit is not None and abs(fit.r[fit.best()]) > _EFFECT:
                return True
    return False
