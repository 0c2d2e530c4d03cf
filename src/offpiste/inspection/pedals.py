"""Checks of the response to throttle and brake (sign, delay, gain) and of missing controls."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from offpiste.core.channels import KERNEL_CONTROLS, all_controls
from offpiste.core.conventions import GRAVITY
from offpiste.inspection.course import heading_fits
from offpiste.inspection.driven_path import MOVING, STEP, DrivenPath
from offpiste.inspection.findings import Finding, Severity
from offpiste.inspection.lags import LAGS, SURE, LagFit, check_delay, fit_lags, lagged, sampled
from offpiste.inspection.samples import BRAKES, is_untouched
from offpiste.inspection.steering_fit import SteeringFit
from offpiste.inspection.usual_ranges import held_range, rests_high, scaled_to_unit, whole_range
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.rig.channels import unit_factor
from offpiste.rig.edits import Edit, absent, rounded
from offpiste.rig.rig import Rig

_EFFECT = 0.2
"""Minimum correlation with speed or yaw rate at which any other control has an effect."""


def check_controls(
    steering: Mapping[str, SteeringFit], pedals: Mapping[str, LagFit], drive: Drive, path: DrivenPath, *, given: bool
) -> list[Finding]:
    """Return findings if steering or throttle is missing, or if no control has any effect.

    Args:
        steering, pedals: results of `steering_fits` and `pedal_fits`.
        given: whether the user gave the rig; otherwise it was guessed.
    """
    if not _present(drive):
        return check_control_channels(drive, path)
    findings: list[Finding] = []
    # The steering cannot be judged if the heading does not follow the course.
    steers = any(fit.has_effect for fit in steering.values()) if heading_fits(path) else True
    drives = any(_has_effect(fit) for fit in pedals.values())
    if "steer" not in drive.channels and drives:
        what, evidence = "there is no steering", "pedals alone do not tell where the vehicle goes"
        remedy = "add [channels.steer] with the topic that holds it: commanded, or else measured"
        evidence += "" if given else "; no field is named so: a rig can name it, and without it nothing can be trained"
        # Without a rig the channels are guessed from names, so the steering may have another name.
        findings.append(Finding("fatal" if given else "warning", "controls", what, evidence, remedy, 1.0))
    if given and steers and "throttle" not in drive.channels and not _others_work(drive, path):
        what, evidence = "there is no throttle", "no channel says how the vehicle is driven on"
        remedy = (
            "add [channels.throttle], and [channels.brake], where the log has them; else no model can foresee the speed"
        )
        findings.append(Finding("warning", "controls", what, evidence, remedy, 0.8))
    if not steers and not drives and not _others_work(drive, path):
        findings.append(_no_controls(_present(drive), path))
    return findings


def check_control_channels(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding if there is no control channel; it needs no motion, so no fix of the pose seems to cause it."""
    return [] if _present(drive) else [_no_controls([], path)]


def _present(drive: Drive) -> list[str]:
    return [control.name for control in all_controls() if control.name in drive.channels]


def _no_controls(present: list[str], path: DrivenPath) -> Finding:
    what = "no control has any effect" if present else "there is no control channel"
    evidence = f"checked: {', '.join(present) or 'none'}; {path.distance:.0f} m driven"
    remedy = "add [channels.steer] and [channels.throttle] with the topics that hold them"
    return Finding("fatal", "controls", what, evidence, remedy, 1.0)


def _others_work(drive: Drive, path: DrivenPath) -> bool:
    """Return whether a control other than throttle, brake and steering drives or turns the vehicle."""
    one, moving = np.ones((len(path.time), 1)), np.isfinite(path.speed)
    for control in (control for control in all_controls() if control not in KERNEL_CONTROLS):
        channel = drive.channels.get(control.name)
        if channel is None or np.ptp(channel.values) == 0:
            continue
        commands = lagged(channel, path.time, drive.rig)
        for motion in (path.forward, path.yaw_rate):
            fit = fit_lags(motion, one, commands, LAGS, moving)
            if fit is not None and abs(fit.r[fit.best()]) > _EFFECT:
                return True
    return False


EFFECTS = {"throttle": 1, "brake": -1}
"""Sign of each pedal's effect on the acceleration."""
OWN_DELAY = {"throttle": (-0.07, 0.8), "brake": (-0.07, 0.5)}
"""Range of delays between pedal and acceleration that the powertrain and the brakes cause [s]."""
_USUAL_DELAY = {"throttle": 0.1, "brake": 0.06}
"""Typical delays of fault-free vehicles [s]."""
_PEDAL_EFFECT = 0.2
"""Minimum partial correlation of pedal and acceleration, given speed, slope and the other pedal."""
RELEASED = 0.08
"""Value below which a pedal is released."""
_PRESSED = 0.3
"""Value above which a pedal is pressed."""
_ALWAYS = 0.8
"""Share of the time above which a pressed brake is implausible."""
_CLEAR = 0.3
"""Minimum correlation for estimating a delay."""
_STRONGEST = 60.0
"""Maximum plausible acceleration at full pedal [m/s^2]; six times the grip, as pedals may act abruptly."""
_HARDLY = 0.15
"""Maximum value of a pedal that is hardly pressed or in another unit."""
_BRAKED, _BRAKED_FOR, _BRAKED_OFTEN = 2.5, 0.3, 3
"""Minimum deceleration on level ground [m/s^2], duration [s] and count of braking events that drag cannot explain."""


def check_pedals(fits: Mapping[str, LagFit], drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return findings on `throttle` and `brake`.

    Args:
        fits: result of `pedal_fits`.
    """
    findings: list[Finding] = []
    both = _both_flipped(drive) if {*fits} == {*EFFECTS} else None
    for name, fit in fits.items():
        sign = EFFECTS[name]
        own = OWN_DELAY[name]
        right, wrong = fit.best(*own, sign=sign), fit.best(*own, sign=-sign)
        late = fit.best(sign=sign)
        if not _has_effect(fit):
            alone = [] if _acts_alone(name, drive, path) else [_without_effect(name, fit, drive, path)]
            findings += _never_released(name, drive, path) or alone
        elif abs(fit.r[wrong]) > max(
            _PEDAL_EFFECT, SURE * fit.r_sigma(wrong), 2 * max(sign * fit.r[right], 0.0), sign * fit.r[late]
        ):
            evidence = (
                f"correlation with the acceleration: {fit.r[wrong]:+.2f}, at most {fit.r[right]:+.2f} the right way"
            )
            cure = _flip(name, drive.channels[name], drive.rig)
            how = ", ".join(map(str, both or cure)) + "; or it is the other pedal"
            cures = (cure,) if both is None else (both, cure)
            findings.append(Finding("warning", name, "acts the wrong way", evidence, how, 1.0, cures))
        else:
            findings += check_delay(name, fit, own, drive.rig, usual=_USUAL_DELAY[name], clear=_CLEAR, sign=sign)
            findings += _idle(name, drive, path) + _too_small(name, fit, right, drive)
    return findings + _braked_without(drive, path)


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
    evidence = f"{often} times it slows down by more than {_BRAKED} m/s2 for {_BRAKED_FOR} s or longer, slopes aside"
    how = "look for another field, or declare it absent"
    found = []
    for name in brakes:
        pressed = drive.channels[name].values[0, 0] > 0.5
        what = f"{'stays where it is fully pressed' if pressed else 'is never pressed'}, and the vehicle brakes"
        found.append(Finding("warning", name, what, evidence, how, 1.0, (absent(name, drive.rig),)))
    return found


def _too_small(name: str, fit: LagFit, right: int, drive: Drive) -> list[Finding]:
    """Return a finding if a hardly pressed pedal has an implausibly large effect.

    Args:
        right: index of the lag with the strongest effect.
    """
    largest = float(np.percentile(np.abs(drive.channels[name].values), 99.9))
    gain, sigma = abs(float(fit.gain[right])), fit.gain_sigma(right)
    if not 0 < largest < _HARDLY or fit.strength < _CLEAR:
        return []
    source, sure = drive.rig.channels[name], SURE
    factor = next(f for f in (10.0, 100.0, 1000.0, 1 / largest) if _HARDLY < f * largest <= 1.1)
    edit = Edit(f"channels.{name}.scale", rounded(factor * source.scale))
    for unit in ("1", "percent"):
        if source.unit and np.isclose(unit_factor(name, unit), factor * unit_factor(name, source.unit)):
            edit, sure = Edit(f"channels.{name}.unit", unit), 1.0  # explains the factor exactly
    if gain - sure * sigma < _STRONGEST:
        return []
    evidence = f"it never exceeds {largest:.3g}, and full {name} would mean {gain:.0f} ± {sigma:.0f} m/s2"
    return [Finding("warning", name, "is too small for what it does", evidence, str(edit), 1.0, ((edit,),))]


def _never_released(name: str, drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding if the brake rests at its upper end and is pressed while driving, hence inverted."""
    channel = drive.channels[name]
    pressed = float(np.nanmean(sampled(channel, path.time, drive.rig) > _PRESSED))
    if name != "brake" or pressed < _ALWAYS or not rests_high(channel.values[:, 0]):
        return []
    evidence = f"it is above {_PRESSED} for {pressed:.0%} of the time, and the vehicle drives"
    cure = _flip(name, channel, drive.rig)
    return [Finding("warning", name, "is pressed all the time", evidence, ", ".join(map(str, cure)), 1.0, (cure,))]


def _without_effect(name: str, fit: LagFit, drive: Drive, path: DrivenPath) -> Finding:
    pressed = float(np.nanmean(sampled(drive.channels[name], path.time, drive.rig) > _PRESSED))
    evidence = f"correlation with the acceleration: {fit.r[fit.best()]:.2f} at best, within 1.5 s; above {_PRESSED} "
    evidence += f"for {pressed:.1%} of the time"
    how = "nothing if it was hardly pressed; else look for another field, or declare it absent"
    return Finding("note", name, "shows no effect on the speed", evidence, how, 0.5)


def _acts_alone(name: str, drive: Drive, path: DrivenPath) -> bool:
    """Return whether a pedal changes the gravity-corrected acceleration while the other pedal is released.

    Over a whole drive, throttle and slope would mask brakes, which are pressed rarely and downhill.
    """
    other = drive.channels.get("brake" if name == "throttle" else "throttle")
    if other is None:
        return False
    with np.errstate(invalid="ignore"):
        alone = sampled(other, path.time - 0.2, drive.rig) < RELEASED
    way = np.sign(path.forward)
    pushed = path.acceleration * way + GRAVITY * path.slope
    base = np.stack((np.ones(len(path.time)), np.abs(path.forward)), axis=1)
    rows = alone & (path.speed > MOVING)
    fit = fit_lags(pushed, base, lagged(drive.channels[name], path.time, drive.rig), LAGS, rows)
    if fit is None:
        return False
    best = fit.best(*OWN_DELAY[name], sign=EFFECTS[name])
    r = EFFECTS[name] * float(fit.r[best])
    return r > max(_PEDAL_EFFECT, SURE * fit.r_sigma(best))


def _idle(name: str, drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding if a pedal rests above zero at a standstill or while the other pedal is pressed."""
    channel, source = drive.channels[name], drive.rig.channels[name]
    lowest = float(np.percentile(channel.values, 0.5))
    if lowest < RELEASED:
        return []
    at = sampled(channel, path.time, drive.rig)
    other = drive.channels.get("brake" if name == "throttle" else "throttle")
    pressed = np.zeros(len(at), bool) if other is None else sampled(other, path.time, drive.rig) > _PRESSED
    standing = np.nan_to_num(path.speed, nan=np.inf) < MOVING
    if (pressed | standing).sum() < 20:
        return []
    rest = float(np.nanpercentile(at[pressed | standing], 5))
    # A higher value than while driving means that the driver presses the pedal, so its rest is unknown.
    if not RELEASED <= rest < lowest + RELEASED / 2:
        return []
    # Motors ignore a small throttle: only braking proves that it is released.
    severity: Severity = "warning" if pressed.sum() >= 20 else "note"
    per_unit = source.sign * unit_factor(name, source.unit)
    edit = Edit(f"channels.{name}.offset", rounded(source.offset - lowest / per_unit))
    when = "with the other pedal pressed" if pressed.any() else "at standstills"
    evidence = f"its lowest value is {lowest:.3g}, {when}, too"
    return [Finding(severity, name, "never comes back to zero", evidence, str(edit), lowest, ((edit,),))]


def pedal_fits(drive: Drive, path: DrivenPath) -> dict[str, LagFit]:
    """Return the fits of all pedals that move, by name."""
    moved = [name for name in EFFECTS if name in drive.channels and np.ptp(drive.channels[name].values) > 0]
    others = {"throttle": drive.channels.get("brake"), "brake": drive.channels.get("throttle")}
    fits = {name: pedal_fit(drive.channels[name], others[name], path, drive.rig) for name in moved}
    return {name: fit for name, fit in fits.items() if fit is not None}


def _has_effect(fit: LagFit) -> bool:
    return fit.strength >= _PEDAL_EFFECT


def pedal_fit(channel: Channel, other: Channel | None, path: DrivenPath, rig: Rig) -> LagFit | None:
    """Fit the acceleration along the direction of travel to a pedal, given drag, slope and the other pedal."""
    pedal, way = lagged(channel, path.time, rig), np.sign(path.forward)
    return fit_lags(path.acceleration * way, pedal_base(path, other, rig), pedal, LAGS, path.speed > 0.3)


def pedal_base(path: DrivenPath, other: Channel | None, rig: Rig) -> Float[np.ndarray, "n b"]:
    """Return the regressors of the acceleration besides a pedal: drag, slope and the other pedal."""
    base = [np.ones(len(path.time)), np.abs(path.forward), path.forward**2, path.slope]
    if other is not None and np.ptp(other.values) > 0:
        base.append(sampled(other, path.time - 0.2, rig))
    return np.stack(base, axis=1)


def _flip(name: str, channel: Channel, rig: Rig) -> tuple[Edit, ...]:
    """Return the edits that invert a pedal: 0..1 to 1..0, -1..0 to 0..1, and 1..-1 (triggers) to 0..1."""
    source, values = rig.channels[name], channel.values[:, 0]
    if held_range(values)[1] < RELEASED and np.median(values) < 0:
        return (Edit(f"channels.{name}.sign", -source.sign),)
    span = whole_range(values)
    return scaled_to_unit(name, source, span if span and span[0] < 0 else (0.0, 1.0), turned=True)


def _both_flipped(drive: Drive) -> tuple[Edit, ...] | None:
    """Return the edits that invert both pedals if both rest at their upper end; None otherwise.

    Swapped pedals would both be pressed most of the time, which is implausible.
    """
    pedals = {name: drive.channels[name] for name in EFFECTS}
    resting = [rests_high(pedal.values[:, 0]) for pedal in pedals.values()]
    if not all(resting):
        return None
    return tuple(edit for name, pedal in pedals.items() for edit in _flip(name, pedal, drive.rig))
