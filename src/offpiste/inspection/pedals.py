"""Checks of the response to throttle and brake (sign, delay, gain) and of missing controls."""

from collections.abc import Mapping
from typing import Final

import numpy as np

from offpiste.core.channels import KERNEL_CONTROLS, all_controls
from offpiste.core.conventions import GRAVITY
from offpiste.inspection.course import heading_fits
from offpiste.inspection.delays import check_delay
from offpiste.inspection.driven_path import MOVING, STEP, DrivenPath
from offpiste.inspection.findings import Cure, Finding, Severity, found
from offpiste.inspection.lags import LAGS, SURE, LagFit, fit_lags, lagged, sampled
from offpiste.inspection.response import PRIORS, SteeringFit
from offpiste.inspection.samples import BRAKES, is_untouched
from offpiste.inspection.usual_ranges import held_range, rests_high, scaled_to_unit, whole_range
from offpiste.logs.drive import Drive
from offpiste.rig.channels import unit_factor
from offpiste.rig.edits import Edit, absent, rounded

_RELEASED: Final = 0.08
"""Value below which a pedal is released."""
_PRESSED: Final = 0.3
"""Value above which a pedal is pressed."""
_ALWAYS: Final = 0.8
"""Share of the time above which a pressed brake is implausible."""
_STRONGEST: Final = 60.0
"""Maximum plausible acceleration at full pedal [m/s^2]; six times the grip, as pedals may act abruptly."""
_HARDLY: Final = 0.15
"""Maximum value of a pedal that is hardly pressed or in another unit."""
_BRAKED, _BRAKED_FOR, _BRAKED_OFTEN = 2.5, 0.3, 3
"""Minimum deceleration on level ground [m/s^2], duration [s] and count of braking events that drag cannot explain."""


def check_controls(
    steering: Mapping[str, SteeringFit], pedals: Mapping[str, LagFit], drive: Drive, path: DrivenPath, *, given: bool
) -> list[Finding]:
    """Return findings if steering or throttle is missing, or if no control has any effect.

    Args:
        steering, pedals: results of `steering_fits` and `pedal_fits`.
        given: whether the user gave the rig; otherwise it was guessed.
    """
    present = _present(drive)
    if not present:
        return check_control_channels(drive, path)
    findings: list[Finding] = []
    # The steering cannot be judged if the heading does not follow the course.
    steers = any(fit.has_effect for fit in steering.values()) if heading_fits(path) else True
    drives = any(fit.strength >= PRIORS[name].effect for name, fit in pedals.items())
    others = _others_work(drive, path)
    if "steer" not in drive.channels and drives:
        # Without a rig the channels are guessed from names, so the steering may have another name.
        findings.append(found("no_steering" if given else "no_steering_found", "controls", {}))
    if given and steers and "throttle" not in drive.channels and not others:
        findings.append(found("no_throttle", "controls", {}))
    if not steers and not drives and not others:
        findings.append(_no_controls(present, path))
    return findings


def check_control_channels(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding if there is no control channel; it needs no motion, so no fix of the pose seems to cause it."""
    return [] if _present(drive) else [_no_controls([], path)]


def _present(drive: Drive) -> list[str]:
    return [control.name for control in all_controls() if control.name in drive.channels]


def _no_controls(present: list[str], path: DrivenPath) -> Finding:
    about = {"present": ", ".join(present), "distance": path.distance}
    return found("no_control_acts" if present else "no_controls", "controls", about)


def _others_work(drive: Drive, path: DrivenPath) -> bool:
    """Return whether a control other than throttle, brake and steering drives or turns the vehicle."""
    others = {control.name for control in all_controls() if control not in KERNEL_CONTROLS} & drive.channels.keys()
    one, moving = np.ones((len(path.time), 1)), np.isfinite(path.speed)
    fits = (
        fit_lags(motion, one, lagged(drive.channels[name], path.time, drive.rig), LAGS, moving)
        for name in others
        for motion in (path.forward, path.yaw_rate)
    )
    return any(fit is not None and fit.strength > PRIORS["throttle"].effect for fit in fits)


def check_pedals(fits: Mapping[str, LagFit], drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return findings on `throttle` and `brake`.

    Args:
        fits: result of `pedal_fits`.
    """
    findings: list[Finding] = []
    for name, fit in fits.items():
        if fit.strength < PRIORS[name].effect:
            findings.append(_never_released(name, drive, path) or _without_effect(name, fit, drive, path))
        elif (wrong := _wrong_way(name, fit, drive, both={*fits} == {"throttle", "brake"})) is not None:
            findings.append(wrong)
        else:
            findings += check_delay(name, fit, drive.rig, sign=PRIORS[name].sign)
            findings += _idle(name, drive, path) + _too_small(name, fit, drive)
    return findings + _braked_without(drive, path)


def _wrong_way(name: str, fit: LagFit, drive: Drive, *, both: bool) -> Finding | None:
    """Return a finding if a pedal acts against its sign much more than with it.

    Args:
        both: whether throttle and brake both move.
    """
    own = PRIORS[name]
    right, wrong = fit.best(*own.delays, sign=own.sign), fit.best(*own.delays, sign=-own.sign)
    r, against = own.sign * fit.r, float(-own.sign * fit.r[wrong])
    if against <= max(own.effect, SURE * fit.r_sigma(wrong), 2 * r[right], r.max()):
        return None
    cures = [_flip(name, drive)]
    # Swapped pedals would both be pressed most of the time, which is implausible.
    if both and all(rests_high(drive.channels[pedal].values[:, 0]) for pedal in ("throttle", "brake")):
        cures.insert(0, _flip("throttle", drive) + _flip("brake", drive))
    return found("pedal_reversed", name, {"wrong": fit.r[wrong], "right": fit.r[right]}, *cures)


def _flip(name: str, drive: Drive) -> Cure:
    """Return the edits that invert a pedal: 0..1 to 1..0, -1..0 to 0..1, and 1..-1 (triggers) to 0..1."""
    source, values = drive.rig.channels[name], drive.channels[name].values[:, 0]
    if held_range(values)[1] < _RELEASED and np.median(values) < 0:
        return (Edit(f"channels.{name}.sign", -source.sign),)
    span = whole_range(values)
    return scaled_to_unit(name, source, span if span and span[0] < 0 else (0.0, 1.0), turned=True)


def _pressed(name: str, drive: Drive, path: DrivenPath) -> float:
    """Return the share of the time in which a pedal is pressed."""
    return float(np.nanmean(sampled(drive.channels[name], path.time, drive.rig) > _PRESSED))


def _never_released(name: str, drive: Drive, path: DrivenPath) -> Finding | None:
    """Return a finding if the brake rests at its upper end and is pressed while driving, hence inverted."""
    pressed = _pressed(name, drive, path)
    if name != "brake" or pressed < _ALWAYS or not rests_high(drive.channels[name].values[:, 0]):
        return None
    return found("always_pressed", name, {"limit": _PRESSED, "pressed": pressed}, _flip(name, drive))


def _without_effect(name: str, fit: LagFit, drive: Drive, path: DrivenPath) -> Finding:
    about = {"r": fit.r[fit.best()], "limit": _PRESSED, "pressed": _pressed(name, drive, path)}
    return found("pedal_without_effect", name, about)


def _braked_without(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding for each brake channel that is never pressed although the vehicle brakes repeatedly."""
    brakes = [name for name in BRAKES if name in drive.channels]
    if not all(is_untouched(name, drive.channels[name].values[:, 0]) for name in brakes):
        return []
    pushed = path.acceleration * np.sign(path.forward) + GRAVITY * path.slope
    braked = np.diff((pushed < -_BRAKED) & (path.speed > MOVING), prepend=False, append=False)
    often = int((np.diff(np.flatnonzero(braked))[::2] * STEP >= _BRAKED_FOR - 1e-9).sum())
    if often < _BRAKED_OFTEN:
        return []
    about, findings = {"often": often, "least": _BRAKED, "seconds": _BRAKED_FOR}, []
    for name in brakes:
        pressed = drive.channels[name].values[0, 0] > 0.5
        code = "brake_never_released" if pressed else "brake_never_pressed"
        findings.append(found(code, name, about, absent(name, drive.rig)))
    return findings


def _too_small(name: str, fit: LagFit, drive: Drive) -> list[Finding]:
    """Return a finding if a hardly pressed pedal has an implausibly large effect."""
    largest = float(np.percentile(np.abs(drive.channels[name].values), 99.9))
    at = fit.best(*PRIORS[name].delays, sign=PRIORS[name].sign)
    gain, sigma = abs(float(fit.gain[at])), fit.gain_sigma(at)
    if not 0 < largest < _HARDLY or fit.strength < PRIORS[name].clear:
        return []
    source, sure = drive.rig.channels[name], SURE
    factor = next(f for f in (10.0, 100.0, 1000.0, 1 / largest) if _HARDLY < f * largest <= 1.1)
    edit = Edit(f"channels.{name}.scale", rounded(factor * source.scale))
    for unit in ("1", "percent"):
        if source.unit and np.isclose(unit_factor(name, unit), factor * unit_factor(name, source.unit)):
            edit, sure = Edit(f"channels.{name}.unit", unit), 1.0  # explains the factor exactly
    if gain - sure * sigma < _STRONGEST:
        return []
    return [found("too_small", name, {"largest": largest, "gain": gain, "sigma": sigma}, (edit,))]


def _idle(name: str, drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding if a pedal rests above zero at a standstill or while the other pedal is pressed."""
    channel, source = drive.channels[name], drive.rig.channels[name]
    lowest = float(np.percentile(channel.values, 0.5))
    if lowest < _RELEASED:
        return []
    at = sampled(channel, path.time, drive.rig)
    other = drive.channels.get("brake" if name == "throttle" else "throttle")
    pressed = np.zeros(len(at), bool) if other is None else sampled(other, path.time, drive.rig) > _PRESSED
    standing = np.nan_to_num(path.speed, nan=np.inf) < MOVING
    if (pressed | standing).sum() < 20:
        return []
    rest = float(np.nanpercentile(at[pressed | standing], 5))
    # A higher value than while driving means that the driver presses the pedal, so its rest is unknown.
    if not _RELEASED <= rest < lowest + _RELEASED / 2:
        return []
    # Motors ignore a small throttle: only braking proves that it is released.
    severity: Severity = "warning" if pressed.sum() >= 20 else "note"
    per_unit = source.sign * unit_factor(name, source.unit)
    edit = Edit(f"channels.{name}.offset", rounded(source.offset - lowest / per_unit))
    when = "with the other pedal pressed" if pressed.any() else "at standstills"
    return [found("pedal_rest", name, {"when": when}, (edit,), severity=severity, score=lowest)]
