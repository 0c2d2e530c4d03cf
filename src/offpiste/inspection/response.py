"""What the vehicle does with its controls: sign, delay and size of steering, throttle and brake.

A vehicle follows its controls: motion up to 0.4 s after steering is a response, motion before it is a wrong stamp.

Fields that repeat the steering later: they look like its command, and are not.
"""

import numpy as np
from jaxtyping import Bool, Float

from offpiste.channels import CONTROLS, all_controls
from offpiste.inspection.driven_path import TURNING, Path
from offpiste.inspection.findings import Finding, number
from offpiste.inspection.lags import LagFit, fit_lags
from offpiste.inspection.recorded_log import Recorded
from offpiste.inspection.signals import place
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.rig.rig import Rig

_LAGS = np.arange(-1.5, 1.51, 0.05)
_STEER_LAGS = (-0.08, 0.4)
_PEDAL_LAGS = (-0.15, 0.8)
"""Delays of the motion that are the vehicle's own [s]."""
_STEER_EFFECT = 0.5
"""Correlation of yaw rate with speed times steering above which the steering is one."""
_PEDAL_EFFECT = 0.2
"""The same for the acceleration and a pedal, with speed, slope and the other pedal taken out."""
_CLEARER = 0.03
"""A lag outside of the vehicle's own must explain this much more of the variance than the best one inside."""
_CLEAR_STEER, _CLEAR_PEDAL = 0.7, 0.3
"""Correlations above which a delay can be told."""
_WINDOW = 8.0
_SLIDING = 0.35
"""Sliding tyres leave at least this share of the turning that the wheels' angle asks for."""
_MAX_LATERAL = 3.0
"""Above this lateral acceleration tyres slip too much to tell the steering's scale [m/s^2]."""


def steering_fit(channel: Channel, path: Path, rig: Rig) -> LagFit | None:
    """Yaw rate by forward speed times the (tangent of the) wheels' angle, with a free centre."""
    angle = np.stack([_sampled(channel, path.time - lag, rig) for lag in _LAGS])
    wheel = np.tan(np.clip(angle, -1.4, 1.4)) if channel.name == "steer_angle" else angle
    rows = (path.speed > max(0.3, 0.2 * path.cruise)) & (np.abs(path.speed * path.yaw_rate) < _MAX_LATERAL)
    if rows.sum() < 40:
        rows = path.speed > max(0.3, 0.2 * path.cruise)
    return fit_lags(path.yaw_rate, path.forward[:, None], path.forward * wheel, _LAGS, rows)


def check_steering(drive: Drive, path: Path, *, measured: bool) -> tuple[list[Finding], bool]:
    """Findings on `steer` and `steer_angle`, and whether one of them turns the vehicle.

    Args:
        measured: whether the rig's wheelbase and `max_steer` are the vehicle's, not a draft's.
    """
    findings, works = [], False
    for name in ("steer", "steer_angle"):
        channel = drive.channels.get(name)
        if channel is None or np.nanstd(path.yaw_rate) < TURNING:
            continue
        fit = steering_fit(channel, path, drive.rig)
        if fit is None:
            continue
        # A wrong sign explains as much as the right one: signs are compared, and a flip must be clearly better.
        best = fit.best()
        if abs(fit.r[best]) < _STEER_EFFECT:
            said = f"correlation of yaw rate with speed times {name}: {fit.r[best]:.2f} at best, within 1.5 s"
            findings.append(Finding("warning", name, "does not turn the vehicle", said, _other_source(name), 1.0))
            continue
        works = True
        findings += _steer_sign(name, fit, drive.rig)
        drift = _drift(name, channel, path, drive.rig)
        findings += drift or _delay(name, fit, _STEER_LAGS, drive.rig)
        findings += _steer_scale(name, fit, drive.rig) if measured else _steer_radius(name, fit)
    return findings, works


def check_pedals(drive: Drive, path: Path) -> tuple[list[Finding], bool]:
    """Findings on `throttle` and `brake`, and whether one of them changes the speed."""
    findings, works = [], False
    for name, sign in (("throttle", 1), ("brake", -1)):
        channel = drive.channels.get(name)
        if channel is None or np.ptp(channel.values) == 0:
            continue
        fit = _pedal_fit(name, drive, path)
        if fit is None:
            continue
        right, wrong = fit.best(*_PEDAL_LAGS, sign=sign), fit.best(*_PEDAL_LAGS, sign=-sign)
        strongest = fit.best()
        if abs(fit.r[strongest]) < _PEDAL_EFFECT:
            said = f"correlation with the acceleration: {fit.r[strongest]:.2f} at best, within 1.5 s"
            what, how = "does not change the speed", "look for another field, or declare it absent"
            findings.append(Finding("note", name, what, said, how, 0.5))
            continue
        works = True
        if abs(fit.r[wrong]) > max(_PEDAL_EFFECT, 2 * max(sign * fit.r[right], 0.0)):
            said = f"correlation with the acceleration: {fit.r[wrong]:+.2f}, at most {fit.r[right]:+.2f} the right way"
            findings.append(Finding("warning", name, "acts the wrong way", said, _flip(name, channel, drive.rig), 1.0))
        else:
            findings += _delay(name, fit, _PEDAL_LAGS, drive.rig, sign)
    return findings, works


def check_other_controls(drive: Drive, path: Path) -> bool:
    """Whether a control beyond throttle, brake and steering (`offpiste.channels`) drives or turns the vehicle."""
    one, moving = np.ones((len(path.time), 1)), np.isfinite(path.speed)
    for control in (control for control in all_controls() if control not in CONTROLS):
        channel = drive.channels.get(control.name)
        if channel is None or np.ptp(channel.values) == 0:
            continue
        lagged = np.stack([_sampled(channel, path.time - lag, drive.rig) for lag in _LAGS])
        for motion in (path.forward, path.yaw_rate):
            fit = fit_lags(motion, one, lagged, _LAGS, moving)
            if fit is not None and abs(fit.r[fit.best()]) > _PEDAL_EFFECT:
                return True
    return False


def _pedal_fit(name: str, drive: Drive, path: Path) -> LagFit | None:
    channel = drive.channels[name]
    lagged = np.stack([_sampled(channel, path.time - lag, drive.rig) for lag in _LAGS])
    one = np.ones(len(path.time))
    base = [one, path.forward, path.forward * np.abs(path.forward), path.slope]
    other = drive.channels.get("brake" if name == "throttle" else "throttle")
    if other is not None and np.ptp(other.values) > 0:
        base.append(_sampled(other, path.time - 0.2, drive.rig))
    return fit_lags(path.acceleration, np.stack(base, axis=1), lagged, _LAGS, path.speed > 0.3)


def _sampled(channel: Channel, at: Float[np.ndarray, " n"], rig: Rig) -> Float[np.ndarray, " n"]:
    hold = rig.channels[channel.name].interpolation == "hold"
    read = channel.hold if hold else channel.linear
    return read(at, max_gap=max(rig.clock.max_gap, 1.0))[:, 0]


def _steer_sign(name: str, fit: LagFit, rig: Rig) -> list[Finding]:
    wrong, right = fit.best(sign=-1), fit.best(sign=1)
    if -fit.r[wrong] < 1.3 * max(fit.r[right], 0.0):
        return []
    said = f"correlation of yaw rate (+ left) with speed times {name}: {fit.r[wrong]:+.2f}"
    mend = f"channels.{name}.sign = {-rig.channels[name].sign}"
    return [Finding("warning", name, "is positive to the right", said, mend, 1.0)]


def _steer_scale(name: str, fit: LagFit, rig: Rig) -> list[Finding]:
    """Yaw rate over speed is tan(angle) / wheelbase."""
    best = fit.best()
    implied = abs(float(fit.gain[best])) * rig.vehicle.wheelbase
    if abs(fit.r[best]) < 0.7:
        return []
    if name == "steer":
        angle, stated = float(np.arctan(implied)), rig.vehicle.max_steer
        said = f"yaw rate and a wheelbase of {rig.vehicle.wheelbase:.2f} m imply {angle:.3f} rad at steer = 1"
        said += f"; the rig says {stated:.3f} rad"
        factor, mend = angle / stated, f"vehicle.max_steer = {number(angle)}"
    else:
        source = rig.channels[name]
        said = f"yaw rate and a wheelbase of {rig.vehicle.wheelbase:.2f} m imply {implied:.3g} times the angle"
        factor, mend = implied, f"channels.{name}.scale = {number(source.scale * implied)}"
        if abs(implied * 180 / np.pi - 1) < 0.4:
            mend = f'channels.{name}.unit = "deg"'
        elif source.unit == "deg" and abs(implied * np.pi / 180 - 1) < 0.4:
            mend = f'channels.{name}.unit = "rad"'
    if 0.6 < factor < 1.6:
        return []
    if factor > 1:
        return [Finding("warning", name, "turns the vehicle more than the rig says", said, mend, 0.6)]
    # Sliding tyres turn a vehicle less than its wheels: on slippery ground down to a half is no fault of the rig.
    slides = factor > _SLIDING
    what = "turns the vehicle less than the rig says"
    mend += "; or the tyres slip" if slides else ""
    return [Finding("note" if slides else "warning", name, what, said, mend, 0.6)]


def _steer_radius(name: str, fit: LagFit) -> list[Finding]:
    """The scale of the steering where no wheelbase is known."""
    curvature = abs(float(fit.gain[fit.best()]))
    said = f"yaw rate / speed = {curvature:.3g} 1/m times {name}: a radius of {1 / curvature:.1f} m at {name} = 1"
    line = f"atan({curvature:.3g} * wheelbase)"
    mend = f"vehicle.max_steer = {line}" if name == "steer" else "compare with tan(angle) / wheelbase"
    return [Finding("note", name, "has this scale", said, mend, 0.4)]


def _delay(name: str, fit: LagFit, own: tuple[float, float], rig: Rig, sign: int = 0) -> list[Finding]:
    best, inside = fit.best(sign=sign), fit.best(*own, sign=sign)
    lag = float(fit.lags[best])
    gained = fit.r[best] ** 2 - max(fit.r[inside] * (sign or np.sign(fit.r[best])), 0.0) ** 2
    # A best lag at the end of those tried is no maximum: slow signals fit anywhere.
    weak = abs(fit.r[best]) < (_CLEAR_PEDAL if sign else _CLEAR_STEER)
    if weak or own[0] <= lag <= own[1] or gained < _CLEARER or best in (0, len(fit.lags) - 1):
        return []
    said = f"the motion is {abs(lag):.2f} s {'before' if lag < 0 else 'after'} it: R2 {fit.r[best] ** 2:.2f} there and "
    said += f"{fit.r[inside] ** 2:.2f} at {fit.lags[inside]:.2f} s"
    what = "is stamped after the motion that it causes" if lag < 0 else "comes long before the motion"
    mend = f"channels.{name}.delay = {number(rig.channels[name].delay - lag)}"
    if lag < 0:
        mend += "; if it is called a command, it is a copy of a measurement"
    return [Finding("warning" if lag < 0 or lag > 1 else "note", name, what, said, mend, gained)]


def _drift(name: str, channel: Channel, path: Path, rig: Rig) -> list[Finding]:
    """Whether the delay differs between stretches of the drive, each judged where it turns enough."""
    lags = _window_lags(channel, path, rig)
    if len(lags) < 5:
        return []
    low, middle, high = np.percentile(lags, (10, 50, 90))
    if high - low < 0.35 or low > -0.2:
        return []
    said = f"the motion comes {low:+.2f} to {high:+.2f} s after it (10 to 90 %, median {middle:+.2f}) in {len(lags)} "
    said += f"stretches of {_WINDOW:.0f} s"
    how = "use another source for it (a command that follows the motion is a late copy), or align its clock"
    return [Finding("warning", name, "has a delay that changes", said, how + " with [alignment]", 0.9)]


def _window_lags(channel: Channel, path: Path, rig: Rig) -> Float[np.ndarray, " w"]:
    sampled = np.stack([_sampled(channel, path.time - lag, rig) for lag in _LAGS])
    turning = path.forward * sampled
    found = []
    usual = np.nanstd(path.yaw_rate[path.speed > max(0.3, 0.2 * path.cruise)])
    for start in np.arange(path.time[0], path.time[-1] - _WINDOW, _WINDOW):
        rows: Bool[np.ndarray, " n"] = (path.time >= start) & (path.time < start + _WINDOW)
        if not np.isfinite(path.yaw_rate[rows]).any() or np.nanstd(path.yaw_rate[rows]) < 0.7 * usual:
            continue
        fit = fit_lags(path.yaw_rate, path.forward[:, None], turning, _LAGS, rows)
        if fit is None:
            continue
        best = fit.best()
        if abs(fit.r[best]) > 0.93 and 0 < best < len(_LAGS) - 1:
            found.append(float(_LAGS[best]))
    return np.array(found)


def _flip(name: str, channel: Channel, rig: Rig) -> str:
    """The line that turns a pedal round: 0..1 becomes 1..0, -1..0 becomes 1..0 too."""
    source = rig.channels[name]
    if np.median(channel.values) < 0:
        return f"channels.{name}.sign = {-source.sign}"
    return (
        f"channels.{name}.scale = {number(-source.scale)}, channels.{name}.offset = "
        f"{number(source.sign - source.offset)}; or it is the other pedal"
    )


def _other_source(name: str) -> str:
    return f'look for another field, or absent = ["{name}"]'


_LAGS_COPIES = np.arange(-2.0, 2.01, 0.1)
_WINDOW_COPIES = 8.0
_ALIKE = 0.95
"""Correlation within a window above which it holds a copy."""
_MOST = 0.6
"""Share of the windows that must hold one."""
_LATE = 0.3
"""A copy that is later than this in a fifth of the windows is reported [s]."""


def check_copies(drive: Drive, recorded: dict[str, Recorded]) -> list[Finding]:
    """A note for each field that follows the steering's source, late."""
    source = drive.rig.channels.get("steer")
    if source is None or source.topic not in recorded:
        return []
    steer = drive.channels["steer"]
    findings = []
    for topic, r in recorded.items():
        if topic == source.topic or len(r.time) < 200:
            continue
        keep = np.append(True, np.diff(r.time) > 0) & np.isfinite(r.time)
        for field, values in zip(r.fields, r.values[keep].T, strict=True):
            lags, windows = _window_lags_of_copies(steer.time, steer.values[:, 0], r.time[keep], values)
            if len(lags) < max(5, _MOST * windows) or np.percentile(lags, 10) < -0.15:
                continue
            low, high = np.percentile(lags, (10, 90))
            if high < _LATE:
                continue
            said = f"in {len(lags)} of {windows} stretches of {_WINDOW:.0f} s it is the steering, {low:.1f} to "
            said += f"{high:.1f} s later (10 to 90 %)"
            name, what = place(topic, field), "is a late copy of the steering, not its command"
            findings.append(Finding("note", name, what, said, "do not feed channels.steer from it", 0.3))
    return findings


def _window_lags_of_copies(
    time: Float[np.ndarray, " n"],
    values: Float[np.ndarray, " n"],
    other_time: Float[np.ndarray, " m"],
    other: Float[np.ndarray, " m"],
) -> tuple[Float[np.ndarray, " w"], int]:
    """By how much `other` is later, in each stretch in which `values` moves and both agree; number that move."""
    if not np.isfinite(other).all() or np.ptp(other) == 0:
        return np.zeros(0), 1
    at = np.arange(time[0] + 2, time[-1] - 2, 0.1)
    x = np.interp(at, time, values)
    shifted = np.stack([np.interp(at + lag, other_time, other) for lag in _LAGS_COPIES])
    found, moving = [], 0
    size = int(_WINDOW_COPIES / 0.1)
    for begin in range(0, len(at) - size, size):
        part, moved = x[begin : begin + size], shifted[:, begin : begin + size]
        if part.std() < 0.5 * x.std():
            continue
        moving += 1
        part, moved = part - part.mean(), moved - moved.mean(axis=1, keepdims=True)
        power = np.sqrt((moved**2).sum(axis=1) * (part**2).sum())
        correlation = np.abs(moved @ part) / np.maximum(power, 1e-12)
        if correlation.max() > _ALIKE:
            found.append(_LAGS_COPIES[correlation.argmax()])
    return np.array(found), max(moving, 1)
