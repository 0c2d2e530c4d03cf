"""Mass and wheel positions of a first rig: defaults until measured, and estimates from the motion."""

from collections.abc import Iterator
from itertools import product
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import OffpisteError
from offpiste.core.geometry import local_from_geographic
from offpiste.inspection.naming import Guess
from offpiste.inspection.commanded_motion import commanded_curvature
from offpiste.inspection.driven_path import DrivenPath, driven_path
from offpiste.inspection.findings import Finding
from offpiste.inspection.response import SteeringFit, steering_fits
from offpiste.inspection.usual_ranges import RANGES
from offpiste.logs.drive import Drive, drive_from_log
from offpiste.logs.log import Log, Samples
from offpiste.rig.channels import GEOGRAPHIC, unit_factor
from offpiste.rig.edits import Edit, rounded
from offpiste.rig.labels import is_named
from offpiste.rig.rig import Rig, Vehicle

SMALL_CAR: Final = RANGES["wheels"][0][0] - RANGES["wheels"][2][0]
"""Wheelbase of a small car [m]; masses are scaled with its cube."""
DRAFTED: Final = "mass and wheel positions are still those of the draft"
"""Finding reported while `vehicle.source` still names the draft or is empty."""
_UNITS: Final = ("cm", "mm", "ft")
"""Units commonly mistaken for metres."""
_CLEAR: Final = 0.8
"""Minimum correlation of the yaw rate with the kinematic prediction."""
_BY_COURSE: Final = "by its numbers: the course of the position follows it"
_APART: Final = 0.5
"""Time between two positions that define the course [s]."""
_LEAST: Final = 20
"""Minimum number of such position pairs."""
_FOLLOWS: Final = 0.95
"""Minimum resultant of course minus heading for an unnamed heading, ..."""
_ONE_WAY: Final = 0.8
"""... and the maximum of the course itself; on a straight any near-constant field fits."""
_CENTRE: Final = 0.01
"""Minimum offset of the steering centre from the usual one, and its maximum standard deviation."""


def heading_by_numbers(log: Log, place: Guess) -> Guess | None:
    """Return the field that follows a position's course; None if none does, or on a straight.

    It may be clockwise or counter-clockwise with any zero direction, in radians or degrees.

    Args:
        place: guess of the position.
    """
    time, xy = _in_order(log.read(place.topic, place.fields[:2]))
    if place.unit == GEOGRAPHIC:
        xy = local_from_geographic(xy)
    at = np.arange(time[0], time[-1] - _APART, _APART) if len(time) else time
    way = _before(time, xy, at + _APART) - _before(time, xy, at)
    length = np.nan_to_num(np.linalg.norm(way, axis=1))
    moves = length > 0.5 * np.percentile(length, 90) if len(at) else np.zeros(0, bool)
    course = np.arctan2(way[moves, 1], way[moves, 0])
    if moves.sum() < _LEAST or abs(np.exp(1j * course).mean()) > _ONE_WAY:
        return None
    found: list[tuple[float, Guess]] = []
    for topic, field, time, values in _unnamed(log, place):
        angle = _before(time, values, at + _APART / 2)[moves, 0]
        for sign, unit in product((1, -1), ("rad", "deg")):
            away = course - sign * unit_factor("yaw", unit) * angle
            found.append((float(abs(np.exp(1j * away).mean())), Guess("yaw", topic, (field,), unit, why=_BY_COURSE)))
    best = max(found, key=lambda pair: pair[0], default=(0.0, None))
    return best[1] if best[0] > _FOLLOWS else None


def _unnamed(log: Log, place: Guess) -> Iterator[tuple[str, str, Float[np.ndarray, " n"], Float[np.ndarray, "n 1"]]]:
    """Yield topic, name, stamps and values of varying fields that are neither positions nor commands."""
    for topic in log.topics.values():
        for field in topic.fields:
            known = field in (log.clock.column, *place.fields)
            if topic.part_of or known or is_named("commanded", f"{topic.name} {field}"):
                continue
            try:
                time, values = _in_order(log.read(topic.name, (field,)))
            except OffpisteError:
                continue
            if len(values) and np.ptp(values) > 0:
                yield topic.name, field, time, values


def _in_order(samples: Samples) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n k"]]:
    """Return stamps and values of the finite rows, sorted by stamp."""
    known = np.isfinite(samples.time) & np.isfinite(samples.values).all(axis=1)
    order = np.argsort(samples.time[known], kind="stable")
    return samples.time[known][order], samples.values[known][order]


def _before(
    time: Float[np.ndarray, " n"], values: Float[np.ndarray, "n k"], at: Float[np.ndarray, " m"]
) -> Float[np.ndarray, "m k"]:
    """Return the last sample before each time; angles may wrap between samples."""
    return np.asarray(values[np.maximum(np.searchsorted(time, at) - 1, 0)])


class Driven(NamedTuple):
    """A log as read through a rig, and the driven path."""

    drive: Drive
    path: DrivenPath

    def steering(self, name: str) -> SteeringFit | None:
        """Return the fit of the turning to a steering channel; None if the rig lacks it or the motion is too short."""
        return steering_fits(self.drive, self.path).get(name)


def driven(log: Log, rig: Rig) -> Driven | None:
    """Read a log through a rig; None if that fails."""
    try:
        return Driven(drive := drive_from_log(log, rig), driven_path(drive))
    except OffpisteError:
        return None


def shown_wheelbase(seen: Driven | None) -> float:
    """Return the wheelbase in yaw rate = speed * tan(angle) / wheelbase, from the steering angle and the poses [m].

    It is implausibly long if the angle is that of the steering wheel, which turns the vehicle less.

    Returns:
        0 without a steering angle, or if the vehicle does not clearly follow it.
    """
    if seen is None or "steer_angle" not in seen.drive.rig.channels:
        return 0.0
    drive, path = seen
    angle = drive.channels["steer_angle"].linear(path.time, max_gap=drive.rig.clock.max_gap)[:, 0]
    turning = path.forward * np.tan(angle)
    rows = np.isfinite(turning) & np.isfinite(path.yaw_rate) & (path.speed > 0.2 * path.cruise)
    rows &= np.abs(angle) < RANGES["widest"]  # the tangent is unbounded
    if rows.sum() < 40 or np.ptp(turning[rows]) == 0 or np.ptp(path.yaw_rate[rows]) == 0:
        return 0.0
    if abs(np.corrcoef(turning[rows], path.yaw_rate[rows])[0, 1]) < _CLEAR:
        return 0.0
    wheelbase = abs(float(turning[rows] @ turning[rows] / (turning[rows] @ path.yaw_rate[rows])))
    fit = seen.steering("steer_angle")
    if fit is not None and fit.without_slip is not None and fit.without_slip.strength > _CLEAR:
        wheelbase = min(wheelbase, 1 / fit.without_slip.value)  # slip increases the apparent wheelbase
    return wheelbase


def estimated_max_steer(log: Log, rig: Rig, fit: SteeringFit | None, wheelbase: float) -> float:
    """Estimate the road wheel angle at steer = 1 [rad] from poses: yaw rate = speed * steer * tan(angle) / wheelbase.

    For a commanded turn rate, it is the angle of the sharpest commanded curves.

    Args:
        fit: of the channel `steer`.
        wheelbase: assumed wheelbase [m].

    Returns:
        0 without a steering, or if the vehicle does not clearly follow it.
    """
    source = rig.channels.get("steer")
    if source is not None and source.turns:
        curvature = commanded_curvature(log.read(source.topic, source.fields).values, rig)
    elif fit is not None and fit.settled.strength >= _CLEAR:
        curvature = fit.curvature.value
    else:
        return 0.0
    return float(f"{np.arctan(curvature * wheelbase):.3g}")


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
    evidence = f"{' and '.join(left)}; vehicle.source: {vehicle.source or 'none'}"
    remedy = "measure them, correct [vehicle], and say in vehicle.source where the numbers come from"
    return [Finding("note", "vehicle", DRAFTED, evidence, remedy, 0.5)]


def check_size(rig: Rig) -> list[Finding]:
    """Return a warning if wheel positions and mass are implausible, i.e. one of them is in another unit."""
    vehicle = rig.vehicle
    least, most = RANGES["densities"]
    if _left(vehicle) or least < vehicle.mass / vehicle.wheelbase**3 < most:
        return []
    evidence = f"a wheelbase of {vehicle.wheelbase:.3g} m with {vehicle.mass:.3g} kg"
    remedy, cures = "vehicle.wheel_positions are in m, vehicle.mass is in kg", []
    for unit in _UNITS:
        factor = unit_factor("position", unit)
        if least < vehicle.mass / (factor * vehicle.wheelbase) ** 3 < most:
            places = [[rounded(factor * x), rounded(factor * y)] for x, y in vehicle.wheel_positions]
            cures.append((Edit("vehicle.wheel_positions", places),))
            remedy += f"; if these are in {unit}: {cures[-1][0]}"
            break
    what = "is too light or too heavy for its size"
    return [Finding("warning", "vehicle", what, evidence, remedy, 1.0, tuple(cures))]


def _left(vehicle: Vehicle) -> list[str]:
    """Return the parameters that may still be defaults."""
    made_up = (vehicle.mass, vehicle.wheel_positions) == (RANGES["mass"], wheels_of(SMALL_CAR))
    if not vehicle.is_guessed and (vehicle.source or not made_up):
        return []
    return [f"mass = {vehicle.mass:g} kg", f"a wheelbase of {vehicle.wheelbase:.3g} m"]
