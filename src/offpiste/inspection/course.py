"""Checks of the heading against the course: mirrored, rotated or in another unit; or swapped position axes."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from offpiste.inspection.driven_path import STEP, DrivenPath, heading_name
from offpiste.inspection.findings import Finding, Severity, found
from offpiste.inspection.lags import SURE, jackknife
from offpiste.logs.channel import turning_sign
from offpiste.logs.drive import Drive
from offpiste.logs.motion import heading
from offpiste.rig.channels import GEOGRAPHIC, unit_factor
from offpiste.rig.edits import Edit, rounded
from offpiste.rig.labels import named_axis, named_coordinate, named_direction
from offpiste.rig.rig import Rig

_TOGETHER: Final = 0.8
"""Minimum resultant of consistent angles: a circular spread of about 40 degrees."""
_APART: Final = 0.6
"""Maximum resultant of clearly inconsistent angles; position drift and faults alone come near it."""
_TURNED: Final = np.deg2rad(10.0)
"""Minimum reported offset of the heading from the course [rad]."""
_SPOILS: Final = np.deg2rad(45.0)
"""Maximum usable heading offset; beyond it forward and sideways are confused [rad]."""
_NEARLY: Final = np.deg2rad(2.0)
"""Tolerance for snapping an offset to a multiple of 90 degrees [rad]."""
_HELD: Final = 1e-9
"""Maximum turn rate of a held heading; noise alone is larger [rad/s]."""
_STRAIGHT: Final = 0.3
"""Share of the moving rows, those with the least turning, that counts as straight driving."""
_ONE_WAY: Final = 0.7
"""Minimum resultant of headings of a drive back and forth along one direction."""
_OF_GEOGRAPHIC: Final = {"z up": ("ned", -np.pi / 2), "ned": ("z up", np.pi / 2)}
"""Alternative axes of an orientation with latitude and longitude, and the course rotation [rad]."""


@dataclass(frozen=True)
class Reading:
    """A candidate reading of the pose: edits of the rig and the resulting agreement of course and heading.

    Attributes:
        together: resultant of course minus heading while moving, 0 to 1; backward counts as forward.
        offset, offset_sigma: mean of course minus heading in straight driving [rad].
    """

    edits: tuple[Edit, ...]
    together: float
    offset: float
    offset_sigma: float


def heading_fits(path: DrivenPath) -> bool:
    """Return True if the heading follows the course, so that turning and steering can be checked."""
    moving = under_way(path)
    course = _course(path)
    return not moving.any() or _agreement(course - path.yaw, path.yaw, moving, _straight(path, moving)) > _TOGETHER


def check_course(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Check the heading against the direction of travel."""
    if under_way(path).sum() < 40:
        return []
    name = heading_name(drive)
    plain, *others = readings(drive, path)
    return _check_heading(name, plain, others, drive.rig)


def _check_heading(name: str, plain: Reading, others: Sequence[Reading], rig: Rig) -> list[Finding]:
    """Return a finding if the heading does not follow the course or has an offset."""
    if plain.together > _TOGETHER:
        if abs(plain.offset) > _TURNED + SURE * plain.offset_sigma:
            return [_turned(name, plain, rig)]
        return []
    better = [other for other in others if other.together > max(_TOGETHER, plain.together + 0.1)]
    ways = [(_with_offset(name, other, rig), other.together) for other in better]
    # Axes that match their names are the least likely to be wrong.
    ways.sort(key=lambda way: (against_names(way[0], rig), len(way[0]), -way[1]))
    cures = tuple(cure for cure, _ in ways)
    if not cures:
        clear = plain.together < _APART
        severity: Severity = "fatal" if clear else "warning"
        return [found("heading_apart", name, {"together": plain.together}, severity=severity, sure=clear)]
    clockwise = name == "yaw" and {"channels.yaw.sign", "motion.axes"} & {edit.key for edit in cures[0]}
    about = {"together": plain.together, "better": ways[0][1]}
    return [found("heading_clockwise" if clockwise else "heading_axes", name, about, *cures)]


def readings(drive: Drive, path: DrivenPath) -> Iterator[Reading]:
    """Yield all readings of the pose that a rig can state, the present one first."""
    moving = under_way(path)
    straight = _straight(path, moving)
    measured = straight & (np.abs(path.yaw_rate) > _HELD)  # receivers hold a heading until they move
    measured = measured if measured.sum() > 3 / STEP else straight
    course = _course(path)
    yaw = drive.rig.channels.get("yaw")
    raw = heading(drive) if yaw is None else drive.channels["yaw"]
    units: dict[str, float] = {"": 1.0}
    if yaw is not None:
        now = yaw.unit or "rad"
        units |= {unit: unit_factor("yaw", unit) / unit_factor("yaw", now) for unit in ("rad", "deg") if unit != now}
    places = drive.rig.channels["position"].unit == GEOGRAPHIC
    for swap, sign, (unit, factor) in product((False, True), (1, -1) if yaw else (1,), units.items()):
        # Degrees read as radians were unwrapped incorrectly: use the samples, not the path.
        turned = np.interp(path.time, raw.time, np.unwrap(sign * factor * raw.values[:, 0]))
        edits = [Edit("channels.position.fields", _exchanged(drive.rig))] if swap else []
        edits += [Edit("channels.yaw.sign", -yaw.sign)] if yaw and sign < 0 else []
        edits += [Edit("channels.yaw.unit", unit)] if unit else []
        difference = _course(path, exchanged=swap) - turned
        agreement = _agreement(difference, turned, moving, straight)
        yield Reading(tuple(edits), agreement, *_offset(difference, measured, moving))
    # With an orientation, all axes may be north-east-down; a compass alone needs no other axes.
    if places and (yaw is None or _has_axes(drive.rig)) and drive.rig.motion.axes in _OF_GEOGRAPHIC:
        other, quarter = _OF_GEOGRAPHIC[drive.rig.motion.axes]
        turned = np.interp(path.time, raw.time, np.unwrap(raw.values[:, 0]))
        difference = course + quarter + turned
        agreement = _agreement(difference, turned, moving, straight)
        yield Reading((Edit("motion.axes", other),), agreement, *_offset(difference, measured, moving))


def _has_axes(rig: Rig) -> bool:
    """Return True if a rig reads a velocity or a turn rate that reveals its axes."""
    velocity = rig.channels.get("linear_velocity")
    turns = {"yaw_rate", "angular_velocity"} & set(rig.channels)
    return bool(turns) or (velocity is not None and velocity.frame != "unknown")


def against_names(edits: Iterable[Edit], rig: Rig) -> float:
    """Return the evidence of position names against edits that swap x and y, in units of warnings.

    Single letters may be wrong and only break ties between fixes; words such as "east" are reliable.
    """
    fields, yaw = rig.channels["position"].fields[:2], rig.channels.get("yaw")
    exchanged = any(edit.key == "channels.position.fields" for edit in edits)
    geographic = [named_coordinate(field) for field in fields] == ["lat", "lon"]
    if not exchanged or not (geographic or [named_axis(field) for field in fields] == ["x", "y"]):
        return 0.0
    # A heading read as a compass heading is equally reliable.
    compass = yaw is not None and yaw.sign * turning_sign("yaw", rig.motion.axes) < 0
    named = geographic or all(named_direction(field) for field in fields)
    if named and not compass:
        return 10.0
    # A heading that is not a compass's yet may count clockwise, which explains as much as an exchange.
    return 0.5 if yaw is None or compass else 2.5


def _exchanged(rig: Rig) -> list[str]:
    """Return the position fields with the first two swapped."""
    x, y, *z = rig.channels["position"].fields
    return [y, x, *z]


def _with_offset(name: str, reading: Reading, rig: Rig) -> tuple[Edit, ...]:
    """Return the edits of a reading, including the correction of its offset."""
    if abs(reading.offset) < _TURNED:
        return reading.edits
    source = rig.channels[name]
    stated = {edit.key: edit.value for edit in reading.edits}
    per_unit = float(turning_sign(name, str(stated.get("motion.axes", rig.motion.axes))))
    if name == "yaw":
        sign = stated.get("channels.yaw.sign", source.sign)
        per_unit *= sign * unit_factor("yaw", stated.get("channels.yaw.unit", source.unit))
    half, offset = np.pi / abs(per_unit), reading.offset
    quarters = np.round(offset / (np.pi / 2)) * np.pi / 2
    if abs(offset - quarters) < max(_NEARLY, min(SURE * reading.offset_sigma, _TURNED)):
        offset = quarters
    turn = np.remainder(source.offset + offset / per_unit + half, 2 * half) - half
    return (*reading.edits, Edit(f"channels.{name}.offset", rounded(float(turn))))


def _turned(name: str, reading: Reading, rig: Rig) -> Finding:
    about = {"degrees": np.degrees(reading.offset), "sigma": np.degrees(reading.offset_sigma)}
    cure = _with_offset(name, reading, rig)
    if abs(reading.offset) > np.radians(150):  # confirmed by related findings only
        return found("heading_backwards", name, about, cure, sure=False)
    severity: Severity = "fatal" if abs(reading.offset) > _SPOILS else "warning"
    return found("heading_turned", name, about, cure, severity=severity)


def straight_rows(path: DrivenPath) -> Bool[np.ndarray, " n"]:
    """Return the moving rows with the least turning of the course."""
    moving = under_way(path)
    return _straight(path, moving) if moving.any() else moving


def course_minus_heading(path: DrivenPath) -> Float[np.ndarray, " n"]:
    """Return direction of travel minus heading, backward counted as forward, from -pi / 2 to pi / 2 [rad]."""
    return np.asarray(np.angle(np.exp(2j * (_course(path) - path.yaw))) / 2)


def under_way(path: DrivenPath) -> Bool[np.ndarray, " n"]:
    """Return the rows in motion, excluding slow ones for this drive."""
    moving: np.ndarray = np.isfinite(path.yaw) & (path.speed > max(0.3, 0.3 * path.cruise))
    return moving


def _course(path: DrivenPath, *, exchanged: bool = False) -> Float[np.ndarray, " n"]:
    """Return the direction of travel, reversed in reverse gear and optionally with x and y swapped [rad]."""
    x, y = path.velocity.T[:: -1 if exchanged else 1]
    course = np.arctan2(y, x)
    return np.asarray(course if path.reverse is None else course + np.pi * path.reverse)


def _straight(path: DrivenPath, moving: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Return the moving rows with the least turning of the course; slides and drifts there are brief."""
    course = _course(path)
    rows = 5
    ahead, behind = np.roll(course, -rows), np.roll(course, rows)
    rate = np.abs(np.angle(np.exp(1j * (ahead - behind)))) / (2 * rows * STEP)
    rate[:rows] = rate[len(rate) - rows :] = np.inf
    with np.errstate(invalid="ignore"):
        limit = np.nanquantile(np.where(moving, rate, np.nan), _STRAIGHT)
        return np.asarray(moving & (rate <= limit))


def _agreement(
    difference: Float[np.ndarray, " n"], yaw: Float[np.ndarray, " n"], moving: np.ndarray, straight: np.ndarray
) -> float:
    """Return the agreement of course and heading in straight driving if it covers many directions, otherwise anywhere.

    A drifting vehicle's course differs from its heading, but rarely on a straight course.
    """
    overall = _together(difference[moving])
    if straight.sum() > 3 / STEP and _together(yaw[straight]) < _ONE_WAY:
        return max(overall, _together(difference[straight]))
    return overall


def _together(difference: Float[np.ndarray, " n"]) -> float:
    """Return the length of the mean of exp(i difference); backward stretches count as forward."""
    return float(np.sqrt(np.abs(np.nanmean(np.exp(2j * difference)))))


def _offset(
    difference: Float[np.ndarray, " n"], rows: Bool[np.ndarray, " n"], moving: Bool[np.ndarray, " n"]
) -> tuple[float, float]:
    """Return the median angle of some rows and the standard error by a jackknife over blocks of 5 s [rad].

    Angles are compared modulo pi, as the vehicle may reverse at times; the majority of moving rows decides.
    """
    at = np.flatnonzero(rows & np.isfinite(difference))
    if not len(at):
        return 0.0, np.inf
    twice = np.exp(2j * difference[at])
    blocks = [twice[at // round(5 / STEP) == block].sum() for block in np.unique(at // round(5 / STEP))]
    total = np.sum(blocks)
    left_out = np.angle((total - np.array(blocks)) / total) / 2 if len(blocks) > 1 else np.zeros(1)
    middle = float(np.angle(total * np.exp(1j * np.median(np.angle(twice * np.conj(total)))))) / 2
    if np.nansum(np.cos(difference[moving] - middle)) < 0:
        middle += np.pi if middle <= 0 else -np.pi
    return middle, jackknife(left_out)
