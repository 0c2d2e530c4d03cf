"""Response to throttle and brake: sign, delay and size; channels of the controls."""

import numpy as np

from offpiste.channels import CONTROLS, all_controls
from offpiste.inspection.driven_path import Path
from offpiste.inspection.findings import Finding, number
from offpiste.inspection.lags import LAGS, LagFit, check_delay, fit_lags, lagged, sampled
from offpiste.inspection.pose import heading_fits
from offpiste.inspection.steering import turns_vehicle
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.rig.rig import Rig

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


_EFFECTS = {"throttle": 1, "brake": -1}
"""Signs of the pedals' effects on the acceleration."""
_OWN_DELAY = (-0.15, 0.8)
"""Delays of the acceleration that are the vehicle's own [s]."""
_PEDAL_EFFECT = 0.2
"""Correlation of acceleration and pedal, with speed, slope and the other pedal taken out, above which it is one."""
_CLEAR = 0.3
"""Correlation above which a delay is clear."""


def check_pedals(drive: Drive, path: Path) -> list[Finding]:
    """Findings on `throttle` and `brake`."""
    findings: list[Finding] = []
    for name, fit in _fits(drive, path).items():
        sign = _EFFECTS[name]
        right, wrong = fit.best(*_OWN_DELAY, sign=sign), fit.best(*_OWN_DELAY, sign=-sign)
        if not _has_effect(fit):
            evidence = f"correlation with the acceleration: {fit.r[fit.best()]:.2f} at best, within 1.5 s"
            what, how = "does not change the speed", "look for another field, or declare it absent"
            findings.append(Finding("note", name, what, evidence, how, 0.5))
        elif abs(fit.r[wrong]) > max(_PEDAL_EFFECT, 2 * max(sign * fit.r[right], 0.0)):
            evidence = (
                f"correlation with the acceleration: {fit.r[wrong]:+.2f}, at most {fit.r[right]:+.2f} the right way"
            )
            how = _flip(name, drive.channels[name], drive.rig)
            findings.append(Finding("warning", name, "acts the wrong way", evidence, how, 1.0))
        else:
            findings += check_delay(name, fit, _OWN_DELAY, drive.rig, clear=_CLEAR, sign=sign)
    return findings


def changes_speed(drive: Drive, path: Path) -> bool:
    """Whether `throttle` or `brake` has a clear effect on the acceleration."""
    return any(_has_effect(fit) for fit in _fits(drive, path).values())


def _fits(drive: Drive, path: Path) -> dict[str, LagFit]:
    """Fits of the pedals that move, by name."""
    moved = [name for name in _EFFECTS if name in drive.channels and np.ptp(drive.channels[name].values) > 0]
    fits = {name: _pedal_fit(name, drive, path) for name in moved}
    return {name: fit for name, fit in fits.items() if fit is not None}


def _has_effect(fit: LagFit) -> bool:
    return bool(abs(fit.r[fit.best()]) >= _PEDAL_EFFECT)


def _pedal_fit(name: str, drive: Drive, path: Path) -> LagFit | None:
    """Fit of the acceleration by a pedal, with drag, slope and the other pedal taken out."""
    channel = drive.channels[name]
    one = np.ones(len(path.time))
    base = [one, path.forward, path.forward * np.abs(path.forward), path.slope]
    other = drive.channels.get("brake" if name == "throttle" else "throttle")
    if other is not None and np.ptp(other.values) > 0:
        base.append(sampled(other, path.time - 0.2, drive.rig))
    pedal = lagged(channel, path.time, drive.rig)
    return fit_lags(path.acceleration, np.stack(base, axis=1), pedal, LAGS, path.speed > 0.3)


def _flip(name: str, channel: Channel, rig: Rig) -> str:
    """The rig line that reverses a pedal: 0..1 becomes 1..0, and so does -1..0."""
    source = rig.channels[name]
    if np.median(channel.values) < 0:
        return f"channels.{name}.sign = {-source.sign}"
    return (
        f"channels.{name}.scale = {number(-source.scale)}, channels.{name}.offset = "
        f"{number(source.sign - source.offset)}; or it is the other pedal"
    )
