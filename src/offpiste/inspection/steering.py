"""Response to the steering: sign, delay and size; fields that repeat the steering later."""

import numpy as np
from jaxtyping import Bool, Float

from offpiste.inspection.driven_path import TURNING, Path
from offpiste.inspection.findings import Finding, number
from offpiste.inspection.lags import LAGS, LagFit, check_delay, fit_lags, lagged
from offpiste.inspection.recorded_log import Recorded
from offpiste.inspection.signals import place
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.rig.rig import Rig

_OWN_DELAY = (-0.08, 0.4)
"""Delays of the turning that are the vehicle's own [s]."""
_EFFECT = 0.5
"""Correlation of yaw rate with speed times steering above which the steering is one."""
_CLEAR = 0.7
"""Correlation above which a delay is clear."""
_WINDOW = 8.0
"""Length of a stretch whose delay is estimated by itself [s]."""
_SLIDING = 0.35
"""Sliding tyres leave at least this share of the turning that the wheels' angle asks for."""
_MAX_LATERAL = 3.0
"""Above this lateral acceleration tyres slip too much to estimate the steering's scale [m/s^2]."""


def steering_fit(channel: Channel, path: Path, rig: Rig) -> LagFit | None:
    """Fit of the yaw rate by forward speed times steering (its tangent, if it is an angle), with a free centre."""
    angle = lagged(channel, path.time, rig)
    wheel = np.tan(np.clip(angle, -1.4, 1.4)) if channel.name == "steer_angle" else angle
    rows = (path.speed > max(0.3, 0.2 * path.cruise)) & (np.abs(path.speed * path.yaw_rate) < _MAX_LATERAL)
    if rows.sum() < 40:
        rows = path.speed > max(0.3, 0.2 * path.cruise)
    return fit_lags(path.yaw_rate, path.forward[:, None], path.forward * wheel, LAGS, rows)


def check_steering(drive: Drive, path: Path, *, measured: bool) -> list[Finding]:
    """Findings on `steer` and `steer_angle`.

    Args:
        measured: whether the rig's wheelbase and `max_steer` are the vehicle's, not a draft's.
    """
    findings: list[Finding] = []
    for name, fit in _fits(drive, path).items():
        if not _has_effect(fit):
            evidence = f"correlation of yaw rate with speed times {name}: {fit.r[fit.best()]:.2f} at best, within 1.5 s"
            other = f'look for another field, or absent = ["{name}"]'
            findings.append(Finding("warning", name, "does not turn the vehicle", evidence, other, 1.0))
            continue
        findings += _steer_sign(name, fit, drive.rig)
        drift = _drift(name, drive.channels[name], path, drive.rig)
        findings += drift or check_delay(name, fit, _OWN_DELAY, drive.rig, clear=_CLEAR)
        findings += _steer_scale(name, fit, drive.rig) if measured else _steer_radius(name, fit)
    return findings


def turns_vehicle(drive: Drive, path: Path) -> bool:
    """Whether `steer` or `steer_angle` has a clear effect on the yaw rate."""
    return any(_has_effect(fit) for fit in _fits(drive, path).values())


def _fits(drive: Drive, path: Path) -> dict[str, LagFit]:
    """Fits of the steering channels in a drive that turns, by name."""
    if np.nanstd(path.yaw_rate) < TURNING:
        return {}
    present = {name: drive.channels[name] for name in ("steer", "steer_angle") if name in drive.channels}
    fits = {name: steering_fit(channel, path, drive.rig) for name, channel in present.items()}
    return {name: fit for name, fit in fits.items() if fit is not None}


def _has_effect(fit: LagFit) -> bool:
    # A wrong sign explains as much as the right one: signs are compared, and a flip must be clearly better.
    return bool(abs(fit.r[fit.best()]) >= _EFFECT)


def _steer_sign(name: str, fit: LagFit, rig: Rig) -> list[Finding]:
    wrong, right = fit.best(sign=-1), fit.best(sign=1)
    if -fit.r[wrong] < 1.3 * max(fit.r[right], 0.0):
        return []
    evidence = f"correlation of yaw rate (+ left) with speed times {name}: {fit.r[wrong]:+.2f}"
    remedy = f"channels.{name}.sign = {-rig.channels[name].sign}"
    return [Finding("warning", name, "is positive to the right", evidence, remedy, 1.0)]


def _steer_scale(name: str, fit: LagFit, rig: Rig) -> list[Finding]:
    """Yaw rate over speed is tan(angle) / wheelbase."""
    best = fit.best()
    implied = abs(float(fit.gain[best])) * rig.vehicle.wheelbase
    if abs(fit.r[best]) < 0.7:
        return []
    if name == "steer":
        angle, stated = float(np.arctan(implied)), rig.vehicle.max_steer
        evidence = f"yaw rate and a wheelbase of {rig.vehicle.wheelbase:.2f} m imply {angle:.3f} rad at steer = 1"
        evidence += f"; the rig says {stated:.3f} rad"
        factor, remedy = angle / stated, f"vehicle.max_steer = {number(angle)}"
    else:
        source = rig.channels[name]
        evidence = f"yaw rate and a wheelbase of {rig.vehicle.wheelbase:.2f} m imply {implied:.3g} times the angle"
        factor, remedy = implied, f"channels.{name}.scale = {number(source.scale * implied)}"
        if abs(implied * 180 / np.pi - 1) < 0.4:
            remedy = f'channels.{name}.unit = "deg"'
        elif source.unit == "deg" and abs(implied * np.pi / 180 - 1) < 0.4:
            remedy = f'channels.{name}.unit = "rad"'
    if 0.6 < factor < 1.6:
        return []
    if factor > 1:
        return [Finding("warning", name, "turns the vehicle more than the rig says", evidence, remedy, 0.6)]
    # Sliding tyres turn a vehicle less than its wheels: on slippery ground down to a half is no fault of the rig.
    slides = factor > _SLIDING
    what = "turns the vehicle less than the rig says"
    remedy += "; or the tyres slip" if slides else ""
    return [Finding("note" if slides else "warning", name, what, evidence, remedy, 0.6)]


def _steer_radius(name: str, fit: LagFit) -> list[Finding]:
    """The scale of the steering where no wheelbase is known."""
    curvature = abs(float(fit.gain[fit.best()]))
    evidence = f"yaw rate / speed = {curvature:.3g} 1/m times {name}: a radius of {1 / curvature:.1f} m at {name} = 1"
    line = f"atan({curvature:.3g} * wheelbase)"
    remedy = f"vehicle.max_steer = {line}" if name == "steer" else "compare with tan(angle) / wheelbase"
    return [Finding("note", name, "has this scale", evidence, remedy, 0.4)]


def _drift(name: str, channel: Channel, path: Path, rig: Rig) -> list[Finding]:
    """A warning if the delay differs between stretches of the drive in which it turns enough."""
    lags = _window_lags(channel, path, rig)
    if len(lags) < 5:
        return []
    low, middle, high = np.percentile(lags, (10, 50, 90))
    if high - low < 0.35 or low > -0.2:
        return []
    evidence = (
        f"the motion comes {low:+.2f} to {high:+.2f} s after it (10 to 90 %, median {middle:+.2f}) in {len(lags)} "
    )
    evidence += f"stretches of {_WINDOW:.0f} s"
    how = "use another source for it (a command that follows the motion is a late copy), or align its clock"
    return [Finding("warning", name, "has a delay that changes", evidence, how + " with [alignment]", 0.9)]


def _window_lags(channel: Channel, path: Path, rig: Rig) -> Float[np.ndarray, " w"]:
    turning = path.forward * lagged(channel, path.time, rig)
    result = []
    usual = np.nanstd(path.yaw_rate[path.speed > max(0.3, 0.2 * path.cruise)])
    for start in np.arange(path.time[0], path.time[-1] - _WINDOW, _WINDOW):
        rows: Bool[np.ndarray, " n"] = (path.time >= start) & (path.time < start + _WINDOW)
        if not np.isfinite(path.yaw_rate[rows]).any() or np.nanstd(path.yaw_rate[rows]) < 0.7 * usual:
            continue
        fit = fit_lags(path.yaw_rate, path.forward[:, None], turning, LAGS, rows)
        if fit is None:
            continue
        best = fit.best()
        if abs(fit.r[best]) > 0.93 and 0 < best < len(LAGS) - 1:
            result.append(float(LAGS[best]))
    return np.array(result)


_LAGS = np.arange(-2.0, 2.01, 0.1)
"""Lags of a copy that are tried [s]."""
_COPY_WINDOW = 8.0
"""Length of a stretch [s]."""
_ALIKE = 0.95
"""Correlation within a stretch above which it holds a copy."""
_MOST = 0.6
"""Share of the stretches that must hold one."""
_LATE = 0.3
"""A copy that is later than this in a tenth of the stretches is reported [s]."""


def check_copies(drive: Drive, recorded: dict[str, Recorded]) -> list[Finding]:
    """Notes on fields that repeat the steering late."""
    source = drive.rig.channels.get("steer")
    if source is None or source.topic not in recorded:
        return []
    steer = drive.channels["steer"]
    findings = []
    for topic, r in recorded.items():
        if topic == source.topic or len(r.time) < 200:
            continue
        keep = np.append(True, r.time[1:] > r.time[:-1]) & np.isfinite(r.time)
        for field, values in zip(r.fields, r.values[keep].T, strict=True):
            lags, windows = _copy_window_lags(steer.time, steer.values[:, 0], r.time[keep], values)
            if len(lags) < max(5, _MOST * windows) or np.percentile(lags, 10) < -0.15:
                continue
            low, high = np.percentile(lags, (10, 90))
            if high < _LATE:
                continue
            evidence = f"in {len(lags)} of {windows} stretches of {_WINDOW:.0f} s it is the steering, {low:.1f} to "
            evidence += f"{high:.1f} s later (10 to 90 %)"
            name, what = place(topic, field), "is a late copy of the steering, not its command"
            findings.append(Finding("note", name, what, evidence, "do not feed channels.steer from it", 0.3))
    return findings


def _copy_window_lags(
    time: Float[np.ndarray, " n"],
    values: Float[np.ndarray, " n"],
    other_time: Float[np.ndarray, " m"],
    other: Float[np.ndarray, " m"],
) -> tuple[Float[np.ndarray, " w"], int]:
    """Lags of `other` in the stretches in which `values` moves and both agree [s], and how many stretches move."""
    if not np.isfinite(other).all() or np.ptp(other) == 0:
        return np.zeros(0), 1
    at = np.arange(time[0] + 2, time[-1] - 2, 0.1)
    x = np.interp(at, time, values)
    shifted = np.stack([np.interp(at + lag, other_time, other) for lag in _LAGS])
    result, moving = [], 0
    size = int(_COPY_WINDOW / 0.1)
    for begin in range(0, len(at) - size, size):
        part, moved = x[begin : begin + size], shifted[:, begin : begin + size]
        if part.std() < 0.5 * x.std():
            continue
        moving += 1
        part, moved = part - part.mean(), moved - moved.mean(axis=1, keepdims=True)
        power = np.sqrt((moved**2).sum(axis=1) * (part**2).sum())
        correlation = np.abs(moved @ part) / np.maximum(power, 1e-12)
        if correlation.max() > _ALIKE:
            result.append(_LAGS[correlation.argmax()])
    return np.array(result), max(moving, 1)
