"""Checks of the heading against the course: mirrored, in another unit, turned; or places with swapped axes."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from offpiste.inspection.driven_path import STEP, DrivenPath
from offpiste.inspection.findings import Finding, Severity
from offpiste.inspection.lags import SURE, jackknife
from offpiste.logs.axes import turning_sign
from offpiste.logs.drive import Drive
from offpiste.logs.motion import heading
from offpiste.rig.channels import GEOGRAPHIC, unit_factor
from offpiste.rig.edits import Edit, rounded
from offpiste.rig.labels import named_axis, named_coordinate, named_direction
from offpiste.rig.rig import Rig

_TOGETHER: Final = 0.8
"""Resultant of angles that agree: a circular spread of some 40 degrees."""
_APART: Final = 0.6
"""Resultant below which they surely do not agree; drifts and faults of the position alone come near it."""
_TURNED: Final = np.deg2rad(10.0)
"""Least turn of the heading against the course that is reported [rad]."""
_SPOILS: Final = np.deg2rad(45.0)
"""Turn of the heading beyond which forward and sideways are confused, and nothing can be learned [rad]."""
_NEARLY: Final = np.deg2rad(2.0)
"""Conventions differ by quarters of a turn: what is this near to one is one [rad]."""
_STRAIGHT: Final = 0.3
"""Share of the moving rows, those that turn least, at which a vehicle goes where it heads."""
_ONE_WAY: Final = 0.7
"""Resultant of headings above which a vehicle drives to and fro in one direction."""
_LOCATION: Final = re.compile(r"(?<![a-z])location[._ ]?[xy]$", re.IGNORECASE)
_ROTATION: Final = re.compile(r"(?<![a-z])rotat(ion|or)[._ ]?yaw$", re.IGNORECASE)
"""What Unreal and CARLA call a pose: their y is to the right, and their yaw counts clockwise."""
_OF_GEOGRAPHIC: Final = {"z up": ("ned", -np.pi / 2), "ned": ("z up", np.pi / 2)}
"""Other axes of an orientation beside latitude and longitude, and how the course turns with them [rad]."""


@dataclass(frozen=True)
class Reading:
    """One way to read the pose: edits of the rig, and how course and heading agree with them.

    Attributes:
        together: resultant of course minus heading while moving, from 0 to 1; backward counts as forward.
        offset, offset_sigma: mean of course minus heading where the vehicle drives straight [rad].
    """

    edits: tuple[Edit, ...]
    together: float
    offset: float
    offset_sigma: float


def heading_fits(path: DrivenPath) -> bool:
    """Whether the heading follows the course, so that turning and steering can be checked by it."""
    moving = under_way(path)
    if not moving.any():
        return True
    return _agreement(_course(path) - path.yaw, path.yaw, moving, _straight(path, moving)) > _TOGETHER


def check_course(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Heading against the direction of travel."""
    if under_way(path).sum() < 40:
        return []
    name = "yaw" if "yaw" in drive.channels else "orientation"
    plain, *others = readings(drive, path)
    if plain.together > _TOGETHER:
        if abs(plain.offset) > _TURNED + SURE * plain.offset_sigma:
            return [_turned(name, plain, drive.rig)]
        return _mirrored(name, drive)
    better = [other for other in others if other.together > max(_TOGETHER, plain.together + 0.1)]
    ways = [(_with_offset(name, other, drive.rig), other.together) for other in better]
    # Axes that are named as they are read are the last to be wrong.
    ways.sort(key=lambda way: (against_names(way[0], drive.rig), len(way[0]), -way[1]))
    cures = tuple(cure for cure, _ in ways)
    what = "the heading does not follow the course"
    if cures and name == "yaw" and {"channels.yaw.sign", "motion.axes"} & {edit.key for edit in cures[0]}:
        what += ": it counts clockwise"
    evidence = f"they agree to {plain.together:.2f} (1: always, 0: never)"
    if not cures:
        how = "take another pose, or fix its axes: heading must be anticlockwise with x forward"
        severity: Severity = "fatal" if plain.together < _APART else "warning"
        return [Finding(severity, name, what, evidence, how, 1.0, sure=plain.together < _APART)]
    evidence += f", and to {ways[0][1]:.2f} with the remedy"
    return [Finding("fatal", name, what, evidence, ", ".join(map(str, cures[0])), 1.0, cures)]


def readings(drive: Drive, path: DrivenPath) -> Iterator[Reading]:
    """All ways to read the pose that a rig can state, the present one first."""
    moving = under_way(path)
    straight = _straight(path, moving)
    course = _course(path)
    yaw = drive.rig.channels.get("yaw")
    raw = heading(drive) if yaw is None else drive.channels["yaw"]
    units: dict[str, float] = {"": 1.0}
    if yaw is not None:
        now = yaw.unit or "rad"
        units |= {unit: unit_factor("yaw", unit) / unit_factor("yaw", now) for unit in ("rad", "deg") if unit != now}
    places = drive.rig.channels["position"].unit == GEOGRAPHIC  # which have no axes to be exchanged
    swaps = (False,) if places else (False, True)
    for swap, sign, (unit, factor) in product(swaps, (1, -1) if yaw else (1,), units.items()):
        # Degrees read as radians were unwrapped at the wrong turn: from the samples, not from the path.
        turned = np.interp(path.time, raw.time, np.unwrap(sign * factor * raw.values[:, 0]))
        edits = [Edit("channels.position.fields", _swapped(drive.rig))] if swap else []
        edits += [Edit("channels.yaw.sign", -yaw.sign)] if yaw and sign < 0 else []
        edits += [Edit("channels.yaw.unit", unit)] if unit else []
        difference = (np.pi / 2 - course if swap else course) - turned
        agreement = _agreement(difference, turned, moving, straight)
        yield Reading(tuple(edits), agreement, *_offset(difference, straight, moving))
    # All beside them may be north, east, down; a compass alone needs no other axes.
    if places and (yaw is None or _has_axes(drive.rig)) and drive.rig.motion.axes in _OF_GEOGRAPHIC:
        other, quarter = _OF_GEOGRAPHIC[drive.rig.motion.axes]
        turned = np.interp(path.time, raw.time, np.unwrap(raw.values[:, 0]))
        difference = course + quarter + turned
        agreement = _agreement(difference, turned, moving, straight)
        yield Reading((Edit("motion.axes", other),), agreement, *_offset(difference, straight, moving))


def _has_axes(rig: Rig) -> bool:
    """Whether a rig reads a velocity or a turn rate whose axes show."""
    velocity = rig.channels.get("linear_velocity")
    turns = {"yaw_rate", "angular_velocity"} & set(rig.channels)
    return bool(turns) or (velocity is not None and velocity.frame != "unknown")


def against_names(edits: Iterable[Edit], rig: Rig) -> float:
    """How much the names of positions speak against edits that exchange x and y, in units of warnings.

    Letters may be wrong, and among cures that explain as much they decide; nobody writes "east" for north.
    """
    fields = rig.channels["position"].fields[:2]
    exchanged = any(edit.key == "channels.position.fields" for edit in edits)
    if exchanged and [named_coordinate(field) for field in fields] == ["lat", "lon"]:
        return 10.0
    if not exchanged or [named_axis(field) for field in fields] != ["x", "y"]:
        return 0.0
    return 10.0 if all(named_direction(field) for field in fields) else 0.5


def _mirrored(name: str, drive: Drive) -> list[Finding]:
    """A finding where left and right are exchanged by the names of the pose, and the heading follows all the same.

    Either y is read before x (a compass), or x before y of a game's world, whose y is to the right.
    """
    fields, yaw = drive.rig.channels["position"].fields, drive.rig.channels.get("yaw")
    named = [named_axis(field) for field in fields[:2]]
    game = yaw is not None and _LOCATION.search(fields[0]) is not None
    if yaw is None or drive.rig.motion.axes != "z up" or named != (["x", "y"] if game else ["y", "x"]):
        return []
    quarter = np.pi / 2 / (yaw.sign * unit_factor("yaw", yaw.unit))
    pose: tuple[Edit, ...] = (
        Edit("channels.position.fields", _swapped(drive.rig)),
        Edit("channels.yaw.sign", -yaw.sign),
        Edit("channels.yaw.offset", rounded(yaw.offset - quarter)),
    )
    steering = (name for name in ("steer", "steer_angle") if name in drive.rig.channels)
    signs = tuple(Edit(f"channels.{name}.sign", -drive.rig.channels[name].sign) for name in steering)
    if game:
        pose += tuple(_velocities_mirrored(drive.rig))
    cure = (*pose, *signs)  # a steering that is right in a mirror is wrong without it
    evidence = f"position reads {fields[0]} before {fields[1]}, and the heading, clockwise then, follows the course"
    how = ", ".join(map(str, cure)) + "; left and right are exchanged until then"
    if game:
        evidence = f"'{fields[0]}' and '{yaw.fields[0]}' are names of Unreal and CARLA, whose y is to the right"
        how += "; none, if the log was turned to y left before"
    what, cures = "the world is seen in a mirror", (cure, pose) if signs else (pose,)
    if game and _ROTATION.search(yaw.fields[0]) is None:
        evidence = f"'{fields[0]}' is a name of Unreal and CARLA, whose y is to the right; of others, too"
        return [Finding("note", name, "the world may be seen in a mirror", evidence, how, 1.0)]
    return [Finding("warning", name, what, evidence, how, 1.0, cures)]


def _velocities_mirrored(rig: Rig) -> Iterator[Edit]:
    """Edits of the velocities of a world that is seen in a mirror."""
    for name in ("linear_velocity", "angular_velocity", "yaw_rate"):
        source = rig.channels.get(name)
        if source is not None and name == "linear_velocity" and source.frame != "body":
            x, y, *z = source.fields
            yield Edit(f"channels.{name}.fields", [y, x, *z])
        elif source is not None and name != "linear_velocity":
            yield Edit(f"channels.{name}.sign", -source.sign)  # of its three rates the yaw's alone counts


def _swapped(rig: Rig) -> list[str]:
    x, y, *z = rig.channels["position"].fields
    return [y, x, *z]


def _with_offset(name: str, reading: Reading, rig: Rig) -> tuple[Edit, ...]:
    """The edits of a reading, and the one that takes its offset out."""
    if abs(reading.offset) < _TURNED:
        return reading.edits
    source = rig.channels[name]
    stated = {edit.key: edit.value for edit in reading.edits}
    per_unit = float(turning_sign(name, str(stated.get("motion.axes", rig.motion.axes))))
    if name == "yaw":
        sign = stated.get("channels.yaw.sign", source.sign)
        per_unit *= sign * unit_factor("yaw", stated.get("channels.yaw.unit", source.unit))
    half = np.pi / abs(per_unit)
    offset = reading.offset
    quarters = np.round(offset / (np.pi / 2)) * np.pi / 2
    if abs(offset - quarters) < _NEARLY:
        offset = quarters
    turn = np.remainder(source.offset + offset / per_unit + half, 2 * half) - half
    return (*reading.edits, Edit(f"channels.{name}.offset", rounded(float(turn))))


def _turned(name: str, reading: Reading, rig: Rig) -> Finding:
    evidence = f"{np.degrees(reading.offset):.0f} ± {np.degrees(reading.offset_sigma):.0f} degrees where it drives "
    evidence += "straight"
    cure = _with_offset(name, reading, rig)
    how = ", ".join(map(str, cure))
    backwards = abs(reading.offset) > np.radians(150)  # whether it reverses is known by what else follows from it
    how += "; or it drives backwards" if backwards else ""
    what = "the heading is turned against the course"
    severity: Severity = "fatal" if not backwards and abs(reading.offset) > _SPOILS else "warning"
    return Finding(severity, name, what, evidence, how, 0.8, (cure,), sure=not backwards)


def straight_rows(path: DrivenPath) -> Bool[np.ndarray, " n"]:
    """Rows in which the vehicle moves and its course turns least."""
    moving = under_way(path)
    return _straight(path, moving) if moving.any() else moving


def course_minus_heading(path: DrivenPath) -> Float[np.ndarray, " n"]:
    """Direction of travel minus heading, backward counted as forward: from -pi / 2 to pi / 2 [rad]."""
    return np.asarray(np.angle(np.exp(2j * (_course(path) - path.yaw))) / 2)


def under_way(path: DrivenPath) -> Bool[np.ndarray, " n"]:
    """Rows in which the vehicle moves, not slowly for this drive."""
    moving: np.ndarray = np.isfinite(path.yaw) & (path.speed > max(0.3, 0.3 * path.cruise))
    return moving


def _course(path: DrivenPath) -> Float[np.ndarray, " n"]:
    """Direction of travel, the opposite where the gear is reverse [rad]."""
    course = np.asarray(np.arctan2(path.velocity[:, 1], path.velocity[:, 0]))
    return course if path.reverse is None else course + np.pi * path.reverse


def _straight(path: DrivenPath, moving: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """The moving rows whose course turns least: a vehicle that slides or drifts there does so briefly."""
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
    """How far course and heading agree: where it drives straight, if it does so in many directions, or else anywhere.

    A vehicle that drifts goes elsewhere than it heads, but hardly where its course is straight.
    """
    overall = _together(difference[moving])
    if straight.sum() > 3 / STEP and _together(yaw[straight]) < _ONE_WAY:
        return max(overall, _together(difference[straight]))
    return overall


def _together(difference: Float[np.ndarray, " n"]) -> float:
    """Length of the mean of exp(i difference); backward stretches count as forward."""
    return float(np.sqrt(np.abs(np.nanmean(np.exp(2j * difference)))))


def _offset(
    difference: Float[np.ndarray, " n"], rows: Bool[np.ndarray, " n"], moving: Bool[np.ndarray, " n"]
) -> tuple[float, float]:
    """Mean angle of some rows, and its standard deviation by a jackknife over blocks of 5 s [rad].

    Angles are averaged modulo pi, as a vehicle that reverses at times goes where its tail points; most of the moving
    rows say which.
    """
    at = np.flatnonzero(rows & np.isfinite(difference))
    if not len(at):
        return 0.0, np.inf
    twice = np.exp(2j * difference[at])
    blocks = [twice[at // round(5 / STEP) == block].sum() for block in np.unique(at // round(5 / STEP))]
    total = np.sum(blocks)
    left_out = np.angle((total - np.array(blocks)) / total) / 2 if len(blocks) > 1 else np.zeros(1)
    mean = float(np.angle(total)) / 2
    if np.nansum(np.cos(difference[moving] - mean)) < 0:
        mean += np.pi if mean <= 0 else -np.pi
    return mean, jackknife(left_out)
