"""Mass and wheel positions of a first rig: defaults until measured, and estimates from the motion."""

from typing import Final

import numpy as np

from offpiste.inspection.commanded_motion import commanded_curvature
from offpiste.inspection.driven_path import DrivenPath
from offpiste.inspection.findings import Finding, found
from offpiste.inspection.response import SteeringFit
from offpiste.inspection.steering_scale import MAX_STEERS
from offpiste.inspection.usual_ranges import RANGES
from offpiste.logs.drive import Drive
from offpiste.logs.log import Log
from offpiste.rig.channels import ANGLES, unit_factor
from offpiste.rig.edits import Edit, rounded
from offpiste.rig.rig import Rig, Vehicle

SMALL_CAR: Final = RANGES["wheels"][0][0] - RANGES["wheels"][2][0]
"""Wheelbase of a small car [m]; masses are scaled with its cube."""
USUAL_STEER: Final = 0.5
"""Default of `max_steer` without a measured angle [rad]."""
"""Finding reported while `vehicle.source` still names the draft or is empty."""
_UNITS: Final = ("cm", "mm", "ft")
"""Units commonly mistaken for metres."""
_CLEAR: Final = 0.8
"""Minimum correlation of the yaw rate with the kinematic prediction."""
_CENTRE: Final = 0.01
"""Minimum offset of the steering centre from the usual one, and its maximum standard deviation."""


def shown_wheelbase(drive: Drive, path: DrivenPath, fit: SteeringFit | None) -> float:
    """Return the wheelbase in yaw rate = speed * tan(angle) / wheelbase, from the steering angle and the poses [m].

    It is implausibly long if the angle is that of the steering wheel, which turns the vehicle less.

    Args:
        fit: of the channel `steer_angle`.

    Returns:
        0 without a steering angle, or if the vehicle does not clearly follow it.
    """
    if "steer_angle" not in drive.channels:
        return 0.0
    angle = drive.channels["steer_angle"].linear(path.time, max_gap=drive.rig.clock.max_gap)[:, 0]
    turning = path.forward * np.tan(angle)
    rows = np.isfinite(turning) & np.isfinite(path.yaw_rate) & (path.speed > 0.2 * path.cruise)
    rows &= np.abs(angle) < RANGES["widest"]  # the tangent is unbounded
    if rows.sum() < 40 or np.ptp(turning[rows]) == 0 or np.ptp(path.yaw_rate[rows]) == 0:
        return 0.0
    if abs(np.corrcoef(turning[rows], path.yaw_rate[rows])[0, 1]) < _CLEAR:
        return 0.0
    wheelbase = abs(float(turning[rows] @ turning[rows] / (turning[rows] @ path.yaw_rate[rows])))
    if fit is not None and fit.without_slip is not None and fit.without_slip.strength > _CLEAR:
        wheelbase = min(wheelbase, 1 / fit.without_slip.value)  # slip increases the apparent wheelbase
    return wheelbase


def full_curvature(log: Log, rig: Rig, fit: SteeringFit | None) -> float:
    """Estimate the curvature at steer = 1 [1/m] from poses: yaw rate = speed * steer * curvature.

    For a commanded turn rate, it is that of the sharpest commanded curves.

    Args:
        fit: of the channel `steer`.

    Returns:
        0 without a steering, or if the vehicle does not clearly follow it.
    """
    source = rig.channels.get("steer")
    if source is not None and source.turns:
        return commanded_curvature(log.read(source.topic, source.fields).values, rig)
    return fit.curvature.value if fit is not None and fit.settled.strength >= _CLEAR else 0.0


def vehicle_size(wheelbase: float, curvature: float, rig: Rig) -> tuple[float, float, bool]:
    """Return wheelbase and max_steer of a draft, and whether they are assumed: the curvature gives only their ratio.

    Args:
        wheelbase: by a measured angle, or 0 [m].
        curvature: at steer = 1, or 0 [1/m].
    """
    shortest, longest = RANGES["wheelbases"]
    wheelbase = wheelbase if shortest < wheelbase < longest else 0.0
    assumed = wheelbase or rig.vehicle.wheelbase
    max_steer = float(f"{np.arctan(curvature * assumed):.3g}")

    def with_angle(angle: float) -> float:
        return assumed * float(np.tan(angle) / np.tan(max_steer))

    if max_steer and not wheelbase and rig.channels["steer"].unit in ANGLES:  # a commanded angle
        shown = with_angle(rig.vehicle.max_steer)
        wheelbase = shown if shortest < shown < longest else 0.0
    if wheelbase or max_steer <= MAX_STEERS[1]:
        return wheelbase, max_steer, False
    return with_angle(USUAL_STEER), USUAL_STEER, True  # a vehicle smaller than the default


def steering_straight(rig: Rig, fit: SteeringFit | None) -> float | None:
    """Return the recorded steering in straight driving if its centre is guessed; None if unclear.

    Args:
        fit: of the channel `steer`.
    """
    source = rig.channels.get("steer")
    if source is None or not source.offset or fit is None or fit.settled.strength < _CLEAR:
        return None
    if not fit.centre_sigma < _CENTRE < abs(fit.centre):  # the usual centre may be correct
        return None
    return (source.sign * fit.centre - source.offset) / source.scale


def wheels_of(wheelbase: float) -> tuple[tuple[float, float], ...]:
    """Return the wheel positions of a small car, scaled to a wheelbase [m]."""
    scale = wheelbase / SMALL_CAR
    return tuple((float(f"{x * scale:.3g}"), float(f"{y * scale:.3g}")) for x, y in RANGES["wheels"])


def check_draft_values(rig: Rig) -> list[Finding]:
    """Return a note while mass or wheel positions are defaults: no log contains them, but models need them."""
    vehicle = rig.vehicle
    left = _left(vehicle)
    if not left:
        return []
    about = {"left": " and ".join(left), "source": vehicle.source or "none"}
    return [found("drafted_vehicle", "vehicle", about)]


def check_size(rig: Rig) -> list[Finding]:
    """Return a warning if wheel positions and mass are implausible, i.e. one of them is in another unit."""
    vehicle = rig.vehicle
    least, most = RANGES["densities"]
    if _left(vehicle) or least < vehicle.mass / vehicle.wheelbase**3 < most:
        return []
    about = {"wheelbase": vehicle.wheelbase, "mass": vehicle.mass}
    for unit in _UNITS:
        factor = unit_factor("position", unit)
        if least < vehicle.mass / (factor * vehicle.wheelbase) ** 3 < most:
            places = [[rounded(factor * x), rounded(factor * y)] for x, y in vehicle.wheel_positions]
            cure = (Edit("vehicle.wheel_positions", places),)
            return [found("vehicle_size", "vehicle", {**about, "unit": unit}, cure)]
    return [found("vehicle_size", "vehicle", about)]


def _left(vehicle: Vehicle) -> list[str]:
    """Return the parameters that may still be defaults."""
    made_up = (vehicle.mass, vehicle.wheel_positions) == (RANGES["mass"], wheels_of(SMALL_CAR))
    if not vehicle.is_guessed and (vehicle.source or not made_up):
        return []
    return [f"mass = {vehicle.mass:g} kg", f"a wheelbase of {vehicle.wheelbase:.3g} m"]
