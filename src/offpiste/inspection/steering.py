"""Response to the steering: sign, delay and scale (`steering_fit.py`), and what is wrong with them."""

from collections.abc import Mapping
from typing import Final

import numpy as np

from offpiste.inspection.course import leans_inward
from offpiste.inspection.driven_path import Path
from offpiste.inspection.findings import Finding
from offpiste.inspection.lags import LAGS, SURE
from offpiste.inspection.steering_delays import changing_delay, uneven_delay, window_delays
from offpiste.inspection.steering_fit import DYNAMIC_EFFECT, SteeringFit, curvature_per_unit
from offpiste.logs.drive import Drive
from offpiste.rig.channels import unit_factor
from offpiste.rig.edits import Edit, absent, number, rounded
from offpiste.rig.rig import Rig

_STEADY_OWN: Final = (-0.08, 0.5)
_DYNAMIC_OWN: Final = (-0.12, 0.4)
"""Delays of the turning that are the vehicle's own, as either fit shows them [s]."""
_USUAL: Final = {"steer": 0.1, "steer_angle": 0.04}
"""Delay in the dynamic fit that healthy vehicles have in the middle, and that a remedy leaves [s]."""
_CLEAR: Final = 0.7
"""Correlation of the steady fit above which scale and changes of the delay are clear."""
_SHARES: Final = (0.55, 1.1)
"""Turning over what the wheels' angle asks for. Of 200 healthy channels, none had less than 0.6 in the fit that shows
more, on ice and with much slip, too, and none more than 1.0 in the fit that shows less."""
_USUAL_SHARE: Final = 0.83
"""The share that a remedy assumes: tyres slip."""
_SHARES_WITHOUT_SLIP: Final = (0.7, 1.15)
"""The same, extrapolated to no speed: of 220 healthy channels all lay within, where that was clear."""
_CLEAR_WITHOUT_SLIP: Final = 0.85
"""Correlation of that fit above which it is clear."""
_USUAL_WITHOUT_SLIP: Final = 0.94
_MARGIN: Final = 2.0
"""Standard deviations by which it has to lie outside."""
_CENTRED: Final = {"steer": 0.05, "steer_angle": 0.02}
"""Steering at which a healthy vehicle may go straight: trims, and roads that slope to one side."""
_RANGES: Final = (0.25, 0.9)
"""Largest steering angles that vehicles have [rad]."""
_SHAPES: Final = (1.0, 2.8)
"""Wheelbases in tracks that vehicles have."""


def check_steering(fits: Mapping[str, SteeringFit], drive: Drive, path: Path, *, measured: bool) -> list[Finding]:
    """Findings on `steer` and `steer_angle`.

    Args:
        fits: of `steering_fits`.
        measured: whether the rig's wheelbase and `max_steer` are the vehicle's, not a draft's.
    """
    findings: list[Finding] = []
    for name, fit in fits.items():
        if not fit.has_effect:
            findings.append(_without_effect(name, fit, drive.rig))
            continue
        findings += _sign(name, fit, drive, path)
        delays = window_delays(drive.channels[name], path, drive.rig)
        findings += changing_delay(name, delays) or _delay(name, fit, drive.rig) or uneven_delay(name, delays)
        findings += _scale(name, fit, drive.rig) if measured else _radius(name, fit, drive.rig)
        findings += _centre(name, fit, drive.rig)
    return findings


def _without_effect(name: str, fit: SteeringFit, rig: Rig) -> Finding:
    steady, dynamic = fit.steady, fit.dynamic
    evidence = f"correlation of the yaw rate with speed times {name}: {steady.r[steady.best()]:.2f} at best, "
    evidence += f"{dynamic.r[dynamic.best()]:.2f} with the change of the yaw rate, within 1.5 s"
    other = "look for another field; no model can do without steering"
    cures: tuple[tuple[Edit, ...], ...] = ()
    if name != "steer":
        other = f'look for another field, or absent = ["{name}"]'
        cures = (absent(name, rig),)
    return Finding("warning", name, "does not turn the vehicle", evidence, other, 1.0, cures)


def _sign(name: str, fit: SteeringFit, drive: Drive, path: Path) -> list[Finding]:
    if fit.sign >= 0:
        return []
    steady, dynamic = fit.steady, fit.dynamic
    evidence = f"correlation of the yaw rate (+ left) with speed times {name}: {steady.r[steady.best()]:+.2f}, "
    evidence += f"of its change {dynamic.r[dynamic.best()]:+.2f}"
    cures = [(Edit(f"channels.{name}.sign", -drive.rig.channels[name].sign),)]
    # Poses whose z points down are seen in a mirror; the body's lean tells them from a steering to the right.
    if leans_inward(drive, path):
        cures.insert(0, (Edit("motion.axes", "ned" if drive.rig.motion.axes == "z up" else "z up"),))
    remedy = str(cures[0][0])
    return [Finding("warning", name, "is positive to the right", evidence, remedy, 1.0, tuple(cures))]


def _delay(name: str, fit: SteeringFit, rig: Rig) -> list[Finding]:
    """A finding if both fits show a delay that is not the vehicle's own."""
    lags = []
    for part, own, clear in ((fit.steady, _STEADY_OWN, _CLEAR), (fit.dynamic, _DYNAMIC_OWN, DYNAMIC_EFFECT)):
        best = part.best(sign=fit.sign)
        if best in (0, len(LAGS) - 1) or abs(part.r[best]) < clear:
            return []
        lag, sigma = part.delay(best)
        if max(own[0] - lag, lag - own[1]) < SURE * sigma:
            return []
        lags.append((lag, sigma))
    (steady, _), (dynamic, sigma) = lags
    if steady * dynamic < 0:
        return []
    when = "before" if dynamic < 0 else "after"
    evidence = f"the turning comes {abs(dynamic):.2f} ± {sigma:.2f} s {when} it"
    what = "is stamped after the motion that it causes" if dynamic < 0 else "comes long before the motion"
    delay = round(rig.channels[name].delay - dynamic + _USUAL[name], 2)
    edit = Edit(f"channels.{name}.delay", delay)
    remedy = str(edit) + ("; if it is called a command, it is a copy of a measurement" if dynamic < 0 else "")
    severe = dynamic < 0 or dynamic > 1
    return [Finding("warning" if severe else "note", name, what, evidence, remedy, min(abs(dynamic), 1.0), ((edit,),))]


def _scale(name: str, fit: SteeringFit, rig: Rig) -> list[Finding]:
    """Yaw rate over speed is tan(angle) / wheelbase, where tyres grip."""
    ratio = _extrapolated_ratio(name, fit, rig) or _gripping_ratio(name, fit, rig)
    if ratio is None:
        return []
    evidence = f"yaw rate and a wheelbase of {rig.vehicle.wheelbase:.2f} m imply "
    implied = ratio * (np.tan(rig.vehicle.max_steer) if name == "steer" else 1.0)
    if name == "steer":
        angle = float(np.arctan(implied))
        evidence += f"{angle:.3f} rad at steer = 1; the rig says {rig.vehicle.max_steer:.3f} rad"
        edit = Edit("vehicle.max_steer", rounded(angle))
    else:
        angle = 0.0
        source = rig.channels[name]
        evidence += f"{implied:.3g} times the angle"
        edit = Edit(f"channels.{name}.scale", rounded(source.scale * implied))
        if abs(implied * 180 / np.pi - 1) < 0.4:
            edit = Edit(f"channels.{name}.unit", "deg")
        elif source.unit == "deg" and abs(implied * np.pi / 180 - 1) < 0.4:
            edit = Edit(f"channels.{name}.unit", "rad")
    wheelbase = _other_wheelbase(rig, 1 / ratio)
    cures: tuple[tuple[Edit, ...], ...] = ((edit,),)
    remedy = str(edit)
    if wheelbase is not None:
        cures = (*cures, (wheelbase,))
        remedy += f"; or the wheelbase is {rig.vehicle.wheelbase / ratio:.2f} m: {wheelbase}"
    places = _other_places(rig, ratio)
    if places is not None:
        # A range of steering that no vehicle has speaks for the places.
        first = name == "steer" and not _RANGES[0] < angle < _RANGES[1]
        cures = ((places,), *cures) if first else (*cures, (places,))
        remedy = f"{places}; or {remedy}" if first else f"{remedy}; or {places}"
    what = "turns the vehicle more than the rig says" if ratio > 1 else "turns the vehicle less than the rig says"
    return [Finding("warning", name, what, evidence, remedy, 0.6, cures)]


def _gripping_ratio(name: str, fit: SteeringFit, rig: Rig) -> float | None:
    """True curvature over the rig's, from rows where tyres grip; None where it may be right."""
    # Tyres that slide spoil one fit, little steering the other: only what both show is a wrong scale.
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
    """True curvature over the rig's, extrapolated to where no tyre slips; None where it may be right."""
    part = fit.extrapolated
    if part is None or part.strength < _CLEAR_WITHOUT_SLIP:
        return None
    factor = 1 / (abs(float(part.gain[0])) * curvature_per_unit(name, rig))
    margin = _MARGIN * part.gain_sigma(0) / abs(float(part.gain[0]))
    low, high = _SHARES_WITHOUT_SLIP
    # Noise of the yaw rate makes the factor too large, by the correlation squared at the most.
    if not margin < 0.5 or (low < factor * (1 + margin) and factor * min(1 - margin, part.strength**2) < high):
        return None
    return factor / _USUAL_WITHOUT_SLIP


def _centre(name: str, fit: SteeringFit, rig: Rig) -> list[Finding]:
    """A finding if the vehicle surely goes straight at another steering than zero."""
    off_centre = abs(fit.centre) > _CENTRED[name] + SURE * fit.centre_sigma
    if fit.gripping.strength < _CLEAR or not off_centre:
        return []
    source = rig.channels[name]
    per_unit = source.sign * unit_factor(name, source.unit)
    edit = Edit(f"channels.{name}.offset", rounded(source.offset - fit.centre / per_unit))
    evidence = f"the vehicle goes straight at {fit.centre:.3f} ± {fit.centre_sigma:.3f}"
    return [Finding("warning", name, "is not zero straight ahead", evidence, str(edit), 0.5, ((edit,),))]


def _other_wheelbase(rig: Rig, factor: float) -> Edit | None:
    """Wheel positions whose wheelbase is `factor` times as long; None where no vehicle has that shape."""
    vehicle = rig.vehicle
    if not _SHAPES[0] < factor * vehicle.wheelbase / max(vehicle.track, 1e-6) < _SHAPES[1]:
        return None
    places = [[rounded(x * factor), y] for x, y in vehicle.wheel_positions]
    return Edit("vehicle.wheel_positions", places)


def _other_places(rig: Rig, ratio: float) -> Edit | None:
    """The unit of positions that explains a turning `ratio` times the rig's; None where none does."""
    for unit in ("ft", "cm"):
        if not rig.channels["position"].unit and abs(np.log(ratio / unit_factor("position", unit))) < 0.3:
            return Edit("channels.position.unit", unit)
    return None


def _radius(name: str, fit: SteeringFit, rig: Rig) -> list[Finding]:
    """The scale of the steering where the wheelbase is a guess."""
    curvature = abs(float(fit.gripping.gain[fit.gripping.best()]))
    evidence = f"yaw rate / speed = {curvature:.3g} 1/m times {name}: a radius of {1 / curvature:.1f} m at {name} = 1"
    wheelbase = rig.vehicle.wheelbase
    line = f"vehicle.max_steer = atan({number(curvature)} * wheelbase): {np.arctan(curvature * wheelbase):.3f} at a "
    line += f"wheelbase of {wheelbase:.3g} m; somewhat more where tyres slid all along"
    remedy = line if name == "steer" else "compare with tan(angle) / wheelbase"
    return [Finding("note", name, "has this scale", evidence, remedy, 0.4)]
