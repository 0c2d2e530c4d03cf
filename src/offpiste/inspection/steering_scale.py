"""Scale of the steering: which single fault explains the gains between command, measured angle and turning.

Three gains are compared with the rig: the turning per command, the turning per measured angle, and the angle per
command. A wrong command, a wrong angle and a wrong geometry (wheelbase or positions) change them in different ways.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from offpiste.inspection.driven_path import DrivenPath
from offpiste.inspection.findings import Cure, Finding, found
from offpiste.inspection.lags import LAGS, fit_lags, lagged, sampled
from offpiste.inspection.response import Gain, SteeringFit, averaged, curvature_per_unit, reverse_gain
from offpiste.logs.drive import Drive
from offpiste.rig.channels import ANGLES, GEOGRAPHIC, unit_factor
from offpiste.rig.edits import Edit, number, rescaled, rounded
from offpiste.rig.rig import Rig

_SETTLED: Final = (0.92, 0.09)
"""Usual turning relative to the rig's geometry, which tyres reduce, and the standard deviation of its logarithm."""
_WITHOUT_SLIP: Final = (1.0, 0.08)
"""The same extrapolated to zero speed."""
_AGREEMENT: Final = (0.98, 0.07)
"""The same for the measured angle relative to the command; linkages are nonlinear, `max_steer` is of a data sheet."""
_GROUND: Final = 0.05
"""Standard deviation of the logarithm of the turning that all channels share, as the ground varies."""
_CLEAR, _CLEAR_WITHOUT_SLIP, _CLEAR_AGREEMENT = 0.7, 0.88, 0.9
"""Minimum correlations."""
_SURE: Final = 9.0
"""Minimum gain in squared standard deviations of a reported fault."""
MAX_STEERS: Final = (0.25, 0.9)
"""Range of maximum steering angles of vehicles [rad]."""
_SHAPES: Final = (1.0, 2.8)
"""Range of wheelbase / track of vehicles."""
_UNITS: Final = {"steer": (("rad", "deg"), 0.2), "steer_angle": (("rad", "deg"), 0.34), "position": (("ft", "cm"), 0.3)}
"""Units in which channels may be recorded, and the maximum deviation of a factor's logarithm from that of a unit."""


@dataclass(frozen=True)
class Ratio:
    """A measured gain relative to the rig.

    Attributes:
        evidence: the gain in words.
        log: logarithm of the gain over the usual one.
        sigma: standard deviation of `log` in fault-free logs.
        faults: change of `log` per logarithm of the factor that corrects each fault.
    """

    evidence: str
    log: float
    sigma: float
    faults: Mapping[str, int]


def check_scale(fits: Mapping[str, SteeringFit], drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding if one fault of the scales explains the measured gains.

    Args:
        fits: fits of the channels with an effect.
    """
    ratios = [ratio for name, fit in fits.items() if (ratio := _turning(name, fit, drive.rig)) is not None]
    if len(ratios) == 2 and (agreement := _agreement(drive, path)) is not None:
        ratios.append(agreement)
    faults = {fault: _explained(ratios, fault) for fault in ("steer", "steer_angle", "geometry")}
    fault, (log, gained) = max(faults.items(), key=lambda item: item[1][1])
    if not gained > _SURE:
        return []
    factor, alone = float(np.exp(log)), len(ratios) == 1  # then it may be the geometry as well
    fixes = _fixes(fault, factor, drive, alone=alone)
    code = "angle_scale" if fault == "steer_angle" else "command_scale"
    if alone or fault == "geometry":
        code = "turns_more" if factor > 1 else "turns_less"
    about = {
        "gains": "; ".join(ratio.evidence for ratio in ratios),
        "fixes": "; or ".join(f"{words}{', '.join(map(str, cure))}" for words, cure in fixes),
    }
    return [found(code, "steer" if fault == "geometry" else fault, about, *(cure for _, cure in fixes))]


def _turning(name: str, fit: SteeringFit, rig: Rig) -> Ratio | None:
    """Return the turning per unit of a channel; None if unclear."""
    gain, (usual, spread), clear = fit.curvature, _SETTLED, _CLEAR
    if fit.without_slip is not None and fit.without_slip.strength > _CLEAR_WITHOUT_SLIP:
        gain, (usual, spread), clear = fit.without_slip, _WITHOUT_SLIP, _CLEAR_WITHOUT_SLIP
    # Most steering is far from full lock, where the tangent is the angle.
    expected = usual * (rig.vehicle.max_steer if name == "steer" else 1.0) / rig.vehicle.wheelbase
    words = f"yaw rate / speed is {gain.value:.3g} 1/m times {name}, usual is {expected:.3g} by the rig's geometry"
    return _ratio(gain, expected, spread, clear, words, {name: 1, "geometry": 1})


def _agreement(drive: Drive, path: DrivenPath) -> Ratio | None:
    """Return the measured angle per command; None if unclear."""
    angle = averaged(sampled(drive.channels["steer_angle"], path.time, drive.rig))
    command = averaged(lagged(drive.channels["steer"], path.time, drive.rig))
    every = np.ones(len(path.time), bool)
    fit = fit_lags(angle, every[:, None].astype(float), command, LAGS, every)
    if fit is None or drive.rig.vehicle.max_steer <= 0:
        return None
    (usual, spread), full, gain = _AGREEMENT, drive.rig.vehicle.max_steer, reverse_gain(fit)
    words = f"the wheels' angle is {gain.value / full:.2f} times steer * max_steer"
    return _ratio(gain, usual * full, spread, _CLEAR_AGREEMENT, words, {"steer": 1, "steer_angle": -1})


def _ratio(
    gain: Gain, expected: float, spread: float, clear: float, words: str, faults: Mapping[str, int]
) -> Ratio | None:
    if gain.strength < clear or not np.isfinite(gain.sigma) or not gain.value > 0:
        return None
    return Ratio(words, float(np.log(gain.value / expected)), float(np.hypot(spread, gain.sigma)), faults)


def _explained(ratios: Sequence[Ratio], fault: str) -> tuple[float, float]:
    """Return the logarithm of the factor that corrects a fault, and the squared sigmas that it explains."""
    effect = np.array([ratio.faults.get(fault, 0) for ratio in ratios], float)
    if not effect.any():
        return 0.0, 0.0
    on_ground = np.array([ratio.faults.get("geometry", 0) for ratio in ratios], float)
    covariance = np.diag([ratio.sigma**2 for ratio in ratios]) + _GROUND**2 * np.outer(on_ground, on_ground)
    weight = np.linalg.inv(covariance)
    product = float(effect @ weight @ [ratio.log for ratio in ratios])
    power = float(effect @ weight @ effect)
    return product / power, product**2 / power


def _fixes(fault: str, factor: float, drive: Drive, *, alone: bool) -> list[tuple[str, Cure]]:
    """Return words and edits that multiply the turning that the rig predicts by a factor, the likeliest first.

    Args:
        alone: whether the geometry may be at fault instead of the channel.
    """
    rig, geometry = drive.rig, _geometry_fixes(factor, drive.rig)
    if fault == "geometry":
        return geometry
    unit, likely = _other_unit(fault, factor, rig), _is_shaped(rig.vehicle.wheelbase, rig)
    own = [unit or rescaled(fault, rig.channels[fault], factor)]
    if fault == "steer":
        angle = factor * rig.vehicle.max_steer
        full: Cure = (Edit("vehicle.max_steer", rounded(angle)),)
        # A command in rad or deg never exceeds the wheels' range.
        reached = factor * float(np.abs(drive.channels["steer"].values).max())
        plausible = MAX_STEERS[0] < angle < MAX_STEERS[1]
        own = [full, *own] if plausible and not (unit and reached < 1 + _UNITS["steer"][1]) else [*own, full]
        own, likely = own[: 1 if angle > MAX_STEERS[1] else None], likely and plausible
    fixes, others = [("", cure) for cure in own], geometry if alone else []
    return fixes + others if likely else others + fixes


def _other_unit(name: str, factor: float, rig: Rig) -> Cure | None:
    """Return the edits that read a channel in another unit, without a scale, if that is about a factor; else None."""
    source, (units, tolerance) = rig.channels[name], _UNITS[name]
    now = unit_factor(name, source.unit, rig.vehicle.max_steer) * source.scale
    for unit in units:
        exact = unit_factor(name, unit, rig.vehicle.max_steer) / now
        if unit != source.unit and exact != 1 and abs(np.log(factor / exact)) < tolerance:
            # The zero is unchanged without a scale.
            plain = rescaled(name, source, 1 / source.scale) if source.scale != 1.0 else ()
            return (Edit(f"channels.{name}.unit", unit), *plain)
    return None


def _geometry_fixes(factor: float, rig: Rig) -> list[tuple[str, Cure]]:
    """Return edits of the positions' unit, the wheelbase and the positions' scale that multiply the turning."""
    source, wheelbase = rig.channels["position"], rig.vehicle.wheelbase / factor
    if source.unit != GEOGRAPHIC and (unit := _other_unit("position", factor, rig)):
        return [("", unit)]
    if _is_shaped(wheelbase, rig):
        places = [[rounded(x / factor), y] for x, y in rig.vehicle.wheel_positions]
        return [(f"the wheelbase is {wheelbase:.2f} m: ", (Edit("vehicle.wheel_positions", places),))]
    return [] if source.unit == GEOGRAPHIC else [("", rescaled("position", source, factor))]


def _is_shaped(wheelbase: float, rig: Rig) -> bool:
    """Return whether the wheelbase is plausible for the rig's track."""
    return bool(_SHAPES[0] < wheelbase / max(rig.vehicle.track, 1e-6) < _SHAPES[1])


def scale_note(name: str, fit: SteeringFit, rig: Rig) -> Finding:
    """Return a note on the steering scale if the wheelbase is a guess."""
    curvature, wheelbase = fit.curvature.value, rig.vehicle.wheelbase
    about = {
        "curvature": curvature,
        "radius": 1 / curvature,
        "share": curvature / curvature_per_unit(name, rig),
        "number": number(curvature),
        "angle": np.arctan(curvature * wheelbase),
        "wheelbase": wheelbase,
    }
    if rig.channels[name].turns:
        return found("turn_scale_estimate", name, about)
    if name == "steer_angle":
        return found("angle_scale_estimate", name, about)
    in_radians = rig.channels[name].unit in ANGLES
    return found("scale_estimate", name, about, remedy="in_radians" if in_radians else "remedy")
