"""Response to throttle and brake: sign, delay and size; channels of the controls."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from offpiste.core.channels import KERNEL_CONTROLS, all_controls
from offpiste.core.conventions import GRAVITY
from offpiste.inspection.course import heading_fits
from offpiste.inspection.driven_path import MOVING, STEP, DrivenPath
from offpiste.inspection.findings import Finding, Severity
from offpiste.inspection.lags import LAGS, SURE, LagFit, check_delay, fit_lags, lagged, sampled
from offpiste.inspection.ranges import BRAKES, is_untouched
from offpiste.inspection.steering_fit import SteeringFit
from offpiste.inspection.usual_ranges import held_range, rests_high, scaled_to_unit, whole_range
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.rig.channels import unit_factor
from offpiste.rig.edits import Edit, absent, rounded
from offpiste.rig.rig import Rig

_EFFECT = 0.2
"""Correlation with speed or yaw rate above which a control of another vehicle has an effect."""


def check_controls(
    steering: Mapping[str, SteeringFit], pedals: Mapping[str, LagFit], drive: Drive, path: DrivenPath, *, given: bool
) -> list[Finding]:
    """Findings where there is no steering, or where no control has any effect.

    Args:
        steering, pedals: of `steering_fits` and `pedal_fits`.
        given: whether the rig was given, not guessed.
    """
    if not _present(drive):
        return check_control_channels(drive, path)
    findings: list[Finding] = []
    # Where the heading does not follow the course, turning tells nothing.
    steers = any(fit.has_effect for fit in steering.values()) if heading_fits(path) else True
    drives = any(_has_effect(fit) for fit in pedals.values())
    if "steer" not in drive.channels and drives:
        what, evidence = "there is no steering", "pedals alone do not tell where the vehicle goes"
        remedy = "add [channels.steer] with the topic that holds it: commanded, or else measured"
        evidence += "" if given else "; no field is named so: a rig can name it, and without it nothing can be trained"
        # Without a rig only names were guessed, and the topic may have another.
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
    """The finding that no control is read at all: it needs no motion, and a pose's cure must not seem to bring it."""
    return [] if _present(drive) else [_no_controls([], path)]


def _present(drive: Drive) -> list[str]:
    return [control.name for control in all_controls() if control.name in drive.channels]


def _no_controls(present: list[str], path: DrivenPath) -> Finding:
    what = "no control has any effect" if present else "there is no control channel"
    evidence = f"checked: {', '.join(present) or 'none'}; {path.distance:.0f} m driven"
    remedy = "add [channels.steer] and [channels.throttle] with the topics that hold them"
    return Finding("fatal", "controls", what, evidence, remedy, 1.0)


def _others_work(drive: Drive, path: DrivenPath) -> bool:
    """Whether a control beyond throttle, brake and steering (`offpiste.core.channels`) drives or turns the vehicle."""
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
"""Signs of the pedals' effects on the acceleration."""
OWN_DELAY = {"throttle": (-0.07, 0.8), "brake": (-0.07, 0.5)}
"""Delays of the acceleration that are the vehicle's own [s]: engines spool up, and brakes bite."""
_USUAL_DELAY = {"throttle": 0.1, "brake": 0.06}
"""Delays that healthy vehicles have in the middle [s]."""
_PEDAL_EFFECT = 0.2
"""Correlation of acceleration and pedal, with speed, slope and the other pedal taken out, above which it is one."""
RELEASED = 0.08
"""A pedal below this is released."""
_PRESSED = 0.3
"""A pedal above this is pressed."""
_ALWAYS = 0.8
"""Share of the time for which nobody presses a brake."""
_CLEAR = 0.3
"""Correlation above which a delay is clear."""
_STRONGEST = 60.0
"""Acceleration per pedal that no vehicle has [m/s^2]: six times what tyres hold, since pedals may act at once."""
_HARDLY = 0.15
"""A pedal that never leaves this is hardly pressed, or in another unit."""
_BRAKED, _BRAKED_FOR, _BRAKED_OFTEN = 2.5, 0.3, 3
"""Deceleration on level ground [m/s^2] that drag and engines hardly reach for so long [s] again and again."""


def check_pedals(fits: Mapping[str, LagFit], drive: Drive, path: DrivenPath) -> list[Finding]:
    """Findings on `throttle` and `brake`.

    Args:
        fits: of `pedal_fits`.
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
    """A finding on brakes that are never pressed, though the vehicle brakes again and again."""
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
    """A finding if a pedal that is hardly pressed moves the vehicle as none could.

    Args:
        right: index of the lag at which it acts.
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
            edit, sure = Edit(f"channels.{name}.unit", unit), 1.0  # which explains it without any chance
    if gain - sure * sigma < _STRONGEST:
        return []
    evidence = f"it never exceeds {largest:.3g}, and full {name} would mean {gain:.0f} ± {sigma:.0f} m/s2"
    return [Finding("warning", name, "is too small for what it does", evidence, str(edit), 1.0, ((edit,),))]


def _never_released(name: str, drive: Drive, path: DrivenPath) -> list[Finding]:
    """A finding on a brake that is pressed while the vehicle drives, and rests there: it is the wrong way round."""
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
    """Whether a pedal changes the acceleration while the other is released, after gravity is removed.

    Brakes are pressed rarely, and downhill: over a whole drive, throttle and slope would account for their effect.
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
    """A finding if a pedal rests above zero: at a standstill, or while the other one is pressed."""
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
    # Where it is higher then than while driving, the driver presses it, and its rest is not seen.
    if not RELEASED <= rest < lowest + RELEASED / 2:
        return []
    # Motors do not answer to the least throttle: only who brakes has surely released it.
    severity: Severity = "warning" if pressed.sum() >= 20 else "note"
    per_unit = source.sign * unit_factor(name, source.unit)
    edit = Edit(f"channels.{name}.offset", rounded(source.offset - lowest / per_unit))
    when = "with the other pedal pressed" if pressed.any() else "at standstills"
    evidence = f"its lowest value is {lowest:.3g}, {when}, too"
    return [Finding(severity, name, "never comes back to zero", evidence, str(edit), lowest, ((edit,),))]


def pedal_fits(drive: Drive, path: DrivenPath) -> dict[str, LagFit]:
    """Fits of the pedals that move, by name."""
    moved = [name for name in EFFECTS if name in drive.channels and np.ptp(drive.channels[name].values) > 0]
    others = {"throttle": drive.channels.get("brake"), "brake": drive.channels.get("throttle")}
    fits = {name: pedal_fit(drive.channels[name], others[name], path, drive.rig) for name in moved}
    return {name: fit for name, fit in fits.items() if fit is not None}


def _has_effect(fit: LagFit) -> bool:
    return fit.strength >= _PEDAL_EFFECT


def pedal_fit(channel: Channel, other: Channel | None, path: DrivenPath, rig: Rig) -> LagFit | None:
    """Fit of the gain in speed, forwards or backwards, by a pedal, with drag, slope and the other pedal taken out."""
    pedal, way = lagged(channel, path.time, rig), np.sign(path.forward)
    return fit_lags(path.acceleration * way, pedal_base(path, other, rig), pedal, LAGS, path.speed > 0.3)


def pedal_base(path: DrivenPath, other: Channel | None, rig: Rig) -> Float[np.ndarray, "n b"]:
    """What changes the speed besides a pedal, along the motion, in reverse as well: drag, slope and the other pedal."""
    base = [np.ones(len(path.time)), np.abs(path.forward), path.forward**2, path.slope]
    if other is not None and np.ptp(other.values) > 0:
        base.append(sampled(other, path.time - 0.2, rig))
    return np.stack(base, axis=1)


def _flip(name: str, channel: Channel, rig: Rig) -> tuple[Edit, ...]:
    """The edits that reverse a pedal: 0..1 becomes 1..0, -1..0 its opposite, and 1..-1, as of triggers, 0..1."""
    source, values = rig.channels[name], channel.values[:, 0]
    if held_range(values)[1] < RELEASED and np.median(values) < 0:
        return (Edit(f"channels.{name}.sign", -source.sign),)
    span = whole_range(values)
    return scaled_to_unit(name, source, span if span and span[0] < 0 else (0.0, 1.0), turned=True)


def _both_flipped(drive: Drive) -> tuple[Edit, ...] | None:
    """The edits that reverse both pedals, where that is likelier than one in the place of the other; None else.

    Reversed pedals are released, and exchanged ones pressed, where both rest: nobody presses both most of the time.
    """
    pedals = {name: drive.channels[name] for name in EFFECTS}
    resting = [rests_high(pedal.values[:, 0]) for pedal in pedals.values()]
    if not all(resting):
        return None
    return tuple(edit for name, pedal in pedals.items() for edit in _flip(name, pedal, drive.rig))
