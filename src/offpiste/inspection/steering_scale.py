"""Checks of the steering scale against the rig's geometry."""

from collections.abc import Mapping
from typing import Final

import numpy as np

from offpiste.inspection.findings import Cure, Finding
from offpiste.inspection.steering_agreement import Agreement
from offpiste.inspection.steering_fit import SteeringFit, curvature_per_unit
from offpiste.logs.drive import Drive
from offpiste.rig.channels import ANGLES, GEOGRAPHIC, unit_factor
from offpiste.rig.edits import Edit, number, rescaled, rounded
from offpiste.rig.rig import Rig

_CLEAR: Final = 0.7
"""Minimum correlation of the steady fit for estimating the scale."""
_SHARES: Final = (0.55, 1.1)
"""Range of turning relative to the wheels' angle. Of 200 fault-free channels, even on ice, none was below 0.6 in the
larger fit or above 1.0 in the smaller one."""
_USUAL_SHARE: Final = 0.83
"""Typical ratio assumed by remedies, including tyre slip."""
_SHARES_WITHOUT_SLIP: Final = (0.75, 1.15)
"""The same extrapolated to zero speed; 260 fault-free channels with a clear fit lie within."""
_CLEAR_WITHOUT_SLIP: Final = 0.85
"""Minimum correlation of the extrapolated fit."""
_USUAL_WITHOUT_SLIP: Final = 0.94
_MARGIN: Final = 2.0
"""Minimum distance outside `_SHARES_WITHOUT_SLIP`, in standard deviations."""
_RIGHT: Final = 0.5
"""Maximum error of a correct steering channel, as a share of the other's, both as logarithms."""
MAX_STEERS: Final = (0.25, 0.9)
"""Range of maximum steering angles of vehicles [rad]."""
_AN_ANGLE: Final = 0.2
"""Maximum log deviation of a scale factor from that of an angle, due to tyre slip."""
_SHAPES: Final = (1.0, 2.8)
"""Range of wheelbase / track of vehicles."""


def check_scale(fits: Mapping[str, SteeringFit], agreement: Agreement | None, drive: Drive) -> list[Finding]:
    """Return findings on the steering scale; without slip, yaw rate / speed = tan(angle) / wheelbase.

    If the two contradict each other, the one with the poorer fit to the turning is reported. Errors of the positions or
    the wheelbase may affect the other as well.

    Args:
        fits: fits of the channels with an effect.
    """
    rig = drive.rig
    suspect = _suspect(fits, rig) if agreement is not None and agreement.is_off else None
    findings = [_contradiction(suspect, agreement, rig)] if agreement is not None and suspect is not None else []
    both = agreement is not None and len(fits) == 2
    for name, fit in fits.items():
        ratio = _extrapolated_ratio(name, fit, rig) or _gripping_ratio(name, fit, rig)
        if ratio is None or name == suspect:
            continue
        others = [_share(other, fits[other], rig) for other in fits if both and suspect is None and other != name]
        # A channel is not off if it agrees with another that clearly fits the turning.
        if not any(share is not None and abs(np.log(share)) < _RIGHT * abs(np.log(ratio)) for share in others):
            findings.append(_off(name, ratio, drive, both=both))
    return findings


def _suspect(fits: Mapping[str, SteeringFit], rig: Rig) -> str | None:
    """Return the steering channel with the poorer fit to the turning, or None if unclear."""
    shares = {name: _share(name, fit, rig) for name, fit in fits.items()}
    steer, angle = shares.get("steer"), shares.get("steer_angle")
    if steer is None or angle is None:
        return None
    return "steer" if abs(np.log(steer)) >= abs(np.log(angle)) else "steer_angle"


def _share(name: str, fit: SteeringFit, rig: Rig) -> float | None:
    """Return the ratio of turning to the typical turning at this steering, or None if unclear."""
    part = fit.extrapolated
    if part is not None and part.strength >= _CLEAR_WITHOUT_SLIP:
        return 1 / (abs(float(part.gain[0])) * curvature_per_unit(name, rig) * _USUAL_WITHOUT_SLIP)
    for part in (fit.gripping, fit.settled):
        if part.strength >= _CLEAR:
            return abs(float(part.gain[part.best()])) / (_USUAL_SHARE * curvature_per_unit(name, rig))
    return None


def _contradiction(name: str, agreement: Agreement, rig: Rig) -> Finding:
    """Return the finding on the faulty channel if command and angle contradict each other."""
    share = agreement.share
    evidence = (
        f"the wheels' angle is {share:.2f} ± {agreement.sigma:.2f} times steer * max_steer, and the vehicle turns "
    )
    if name == "steer_angle":
        evidence += "as the command says"
        cure = _other_angle(1 / share, rig)
        remedy = ", ".join(map(str, cure))
        return Finding("warning", name, "does not fit the command", evidence, remedy, 0.6, (cure,))
    evidence += "as the angle says"
    angle = share * rig.vehicle.max_steer
    cures = [(Edit("vehicle.max_steer", rounded(angle)),), rescaled("steer", rig.channels["steer"], share)]
    if not MAX_STEERS[0] < angle < MAX_STEERS[1]:  # implausible for a vehicle: the command is in another unit
        cures.reverse()
    remedy = "; or ".join(", ".join(map(str, cure)) for cure in cures)
    return Finding("warning", name, "does not fit the wheels' angle", evidence, remedy, 0.6, tuple(cures))


def _other_angle(factor: float, rig: Rig) -> Cure:
    """Return the edits that scale the wheels' angle by `factor`, as another unit if possible."""
    source = rig.channels["steer_angle"]
    if abs(factor * 180 / np.pi - 1) < 0.4:
        return (Edit("channels.steer_angle.unit", "deg"),)
    if source.unit == "deg" and abs(factor * np.pi / 180 - 1) < 0.4:
        return (Edit("channels.steer_angle.unit", "rad"),)
    return rescaled("steer_angle", source, factor)


def _off(name: str, ratio: float, drive: Drive, *, both: bool) -> Finding:
    """Return the finding if the vehicle turns `ratio` times as much as the rig implies.

    Args:
        both: whether command and measured angle agree with each other, so that a common error is unlikely.
    """
    rig = drive.rig
    evidence = f"yaw rate and a wheelbase of {rig.vehicle.wheelbase:.2f} m imply "
    angle = 0.0
    if name == "steer":
        angle = float(np.arctan(ratio * np.tan(rig.vehicle.max_steer)))
        evidence += f"{angle:.3f} rad at steer = 1; the rig says {rig.vehicle.max_steer:.3f} rad"
        cure: Cure = (Edit("vehicle.max_steer", rounded(angle)),)
    else:
        evidence += f"{ratio:.3g} times the angle"
        cure = _other_angle(ratio, rig)
    own, unit = ("", cure), ("", _other_unit(rig, ratio))
    long = (f"the wheelbase is {rig.vehicle.wheelbase / ratio:.2f} m: ", _other_wheelbase(rig, 1 / ratio))
    places = ("", _other_scale(rig, ratio) if both and unit[1] is None else None)
    ways = [unit, long, places, own] if both else [own, long, unit, places]
    if not _is_shaped(rig.vehicle.wheelbase, rig):
        ways.sort(key=lambda way: way is not long)
    if name == "steer":
        angle_of = _as_an_angle(rig, ratio)
        command = ("", angle_of[0] if angle_of else rescaled("steer", rig.channels["steer"], ratio))
        # An implausible steering range indicates wrong positions, wheel positions or command units.
        if MAX_STEERS[0] < angle < MAX_STEERS[1]:
            ways.append(command)
            reached = float(np.abs(drive.channels["steer"].values).max())
            if angle_of and reached < (1 + _AN_ANGLE) / angle_of[1]:  # the command never exceeds the wheels' range
                ways.insert(0, command)
        else:
            ways = [unit, long, places, command, *([own] if angle < MAX_STEERS[1] else [])]
    likely = [(words, way) for words, way in ways if way is not None]
    remedy = "; or ".join(f"{words}{', '.join(map(str, way))}" for words, way in likely)
    cures = tuple(way for _, way in likely)
    what = "turns the vehicle more than the rig says" if ratio > 1 else "turns the vehicle less than the rig says"
    return Finding("warning", name, what, evidence, remedy, 0.6, cures)


def _gripping_ratio(name: str, fit: SteeringFit, rig: Rig) -> float | None:
    """Return the ratio of true to nominal curvature from rows with little slip; None if it may be correct."""
    # Sliding tyres bias one fit, and little steering the other: only a scale error affects both.
    usual = _USUAL_SHARE * curvature_per_unit(name, rig)
    gains = [(abs(float(part.gain[part.best()])), part) for part in (fit.gripping, fit.settled)]
    gain, part = min(gains, key=lambda pair: abs(np.log(max(pair[0], 1e-9) / usual)))
    if min(gains[0][0], gains[1][0]) < usual < max(gains[0][0], gains[1][0]):
        return None
    sigma = part.gain_sigma(part.best())
    if fit.gripping.strength < _CLEAR or fit.settled.strength < _CLEAR or not sigma < 0.2 * gain:
        return None
    factor = gain / curvature_per_unit(name, rig)
    margin = 1.5 * factor * sigma / gain
    return None if _SHARES[0] - margin < factor < _SHARES[1] + margin else gain / usual


def _extrapolated_ratio(name: str, fit: SteeringFit, rig: Rig) -> float | None:
    """Return the ratio of true to nominal curvature extrapolated to zero slip; None if it may be correct."""
    part = fit.extrapolated
    if part is None or part.strength < _CLEAR_WITHOUT_SLIP:
        return None
    factor = 1 / (abs(float(part.gain[0])) * curvature_per_unit(name, rig))
    margin = _MARGIN * part.gain_sigma(0) / abs(float(part.gain[0]))
    low, high = _SHARES_WITHOUT_SLIP
    # Yaw rate noise increases the factor by at most the inverse of the squared correlation.
    if not margin < 0.5 or (low < factor * (1 + margin) and factor * min(1 - margin, part.strength**2) < high):
        return None
    return factor / _USUAL_WITHOUT_SLIP


def _other_wheelbase(rig: Rig, factor: float) -> Cure | None:
    """Return the wheel positions for a wheelbase scaled by `factor`; None if implausible."""
    if not _is_shaped(factor * rig.vehicle.wheelbase, rig):
        return None
    places = [[rounded(x * factor), y] for x, y in rig.vehicle.wheel_positions]
    return (Edit("vehicle.wheel_positions", places),)


def _is_shaped(wheelbase: float, rig: Rig) -> bool:
    """Return whether the wheelbase is plausible for the rig's track."""
    return bool(_SHAPES[0] < wheelbase / max(rig.vehicle.track, 1e-6) < _SHAPES[1])


def _other_unit(rig: Rig, ratio: float) -> Cure | None:
    """Return the unit of positions that explains turning at `ratio` times the rig's, or None."""
    for unit in ("ft", "cm"):
        if not rig.channels["position"].unit and abs(np.log(ratio / unit_factor("position", unit))) < 0.3:
            return (Edit("channels.position.unit", unit),)
    return None


def _other_scale(rig: Rig, ratio: float) -> Cure | None:
    """Return the edit that scales positions by `ratio`; None for latitude and longitude."""
    source = rig.channels["position"]
    return None if source.unit == GEOGRAPHIC else (Edit("channels.position.scale", rounded(source.scale * ratio)),)


def _as_an_angle(rig: Rig, factor: float) -> tuple[Cure, float] | None:
    """Return the edits for a command that is a road wheel angle, and their factor; None if `factor` does not match."""
    source = rig.channels["steer"]
    for unit in ("rad", "deg") if not source.unit else ():
        exact = unit_factor("steer", unit, rig.vehicle.max_steer) / source.scale
        if abs(np.log(factor / exact)) < _AN_ANGLE:
            # The zero is unchanged without a scale.
            plain = rescaled("steer", source, 1 / source.scale) if source.scale != 1.0 else ()
            return (Edit("channels.steer.unit", unit), *plain), exact
    return None


def _is_of_an_angle(rig: Rig) -> bool:
    """Return whether the command is recorded as a road wheel angle, by its unit or a scale of 1 / `max_steer`."""
    source = rig.channels["steer"]
    scaled = source.scale * rig.vehicle.max_steer
    return source.unit in ANGLES or any(abs(scaled / ANGLES[unit] - 1) < 0.02 for unit in ("rad", "deg"))


def scale_note(name: str, fit: SteeringFit, rig: Rig) -> Finding:
    """Return a note on the steering scale if the wheelbase is a guess."""
    curvature = abs(float(fit.gripping.gain[fit.gripping.best()]))
    if rig.channels[name].turns:
        share = curvature / curvature_per_unit(name, rig)
        evidence = f"the vehicle turns {share:.2f} times as fast as it is asked to"
        remedy = "none: a model learns it; a rig in other units is off by far more"
        return Finding("note", name, "has this scale", evidence, remedy, 0.4)
    evidence = f"yaw rate / speed = {curvature:.3g} 1/m times {name}"
    evidence += f": a radius of {1 / curvature:.1f} m at steer = 1" if name == "steer" else ", in rad"
    wheelbase = rig.vehicle.wheelbase
    remedy = "none, if it is an angle of the road wheels in the unit that the rig says: then compare with "
    if name == "steer_angle":
        remedy += "1 / wheelbase, less a fifth or so for slip"
    elif _is_of_an_angle(rig):
        remedy += "tan(max_steer) / wheelbase, less a fifth or so for slip"
    else:
        source = rig.channels["steer"]
        full = (source.sign / unit_factor("steer", source.unit) - source.offset) / source.scale
        recorded = "" if full == 1 else f" ({full:.4g} as recorded)"
        remedy = (
            f"vehicle.max_steer is the angle of the road wheels at steer = 1{recorded}, where you know it; by this log "
        )
        remedy += (
            f"atan({number(curvature)} * wheelbase), {np.arctan(curvature * wheelbase):.3f} rad at {wheelbase:.3g} m, "
        )
        remedy += "or more, as tyres slip"
    return Finding("note", name, "has this scale", evidence, remedy, 0.4)
