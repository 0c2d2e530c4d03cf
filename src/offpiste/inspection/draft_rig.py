"""First rig for a log, guessed from names and values; a comment states each guess."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from textwrap import wrap

import numpy as np
from msgspec import structs

from offpiste.core.errors import OffpisteError, RigError
from offpiste.core.files import write_text
from offpiste.inspection.channel_guesses import guess_channels
from offpiste.inspection.commanded_motion import is_turn_rate
from offpiste.inspection.controls_by_numbers import find_controls, steering_candidates
from offpiste.inspection.draft_channels import Found, draft_channels, of_other_vehicles
from offpiste.inspection.draft_pose import Entry, field_values, points_down, pose_cure
from offpiste.inspection.draft_sensors import draft_sensors
from offpiste.inspection.draft_values import (
    MASS,
    SMALL_CAR,
    WHEELBASES,
    WHEELS,
    estimated_max_steer,
    estimated_wheelbase,
    is_of_steering_wheel,
    steering_straight,
    wheels_of,
)
from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.gear import reverses_by_pedal
from offpiste.inspection.missing import no_pose
from offpiste.inspection.recorded_log import ReceivedLog, is_bulk
from offpiste.inspection.several_clocks import read_by_arrival
from offpiste.inspection.steering_scale import MAX_STEERS
from offpiste.inspection.velocity import fit_frames
from offpiste.logs.channel import read_channel
from offpiste.logs.drive import drive_from_log
from offpiste.logs.log import Log
from offpiste.rig.channels import ANGLES, ChannelSource, Clock, undeclared
from offpiste.rig.edits import edited
from offpiste.rig.labels import is_array_entry
from offpiste.rig.rig import GUESSED, Rig, parse_rig

_NO_STEERING = (
    "# MISSING: steering: {why}; no model can do without. Add [channels.steer] and take steer out of"
    " `absent`. {candidates}\n"
)
_NO_THROTTLE = (
    "# MISSING: throttle: {why}; without it no model can foresee the speed. Add [channels.throttle]"
    " and take throttle out of `absent`.\n"
)
_HEADER = """\
# A first rig for {name}, guessed by `offpiste inspect`. Every line is a guess: read it, fix it, and inspect again
# with --rig until nothing is left to fix.
name = {quoted}
absent = {absent}

[vehicle]               # measure your vehicle, and say in `source` where the numbers come from
source = {source}
mass = {mass}           # [kg] with its load
max_steer = {max_steer:<11} # [rad] road-wheel angle at steer = 1{origin}
pose_point = "unknown"  # which point of the vehicle the pose is of
# x forward, y left of the pose point [m]: front-left, front-right, rear-left, rear-right
wheel_positions = {wheels}
"""
_MAX_STEER = 0.5
"""Default without a measured angle [rad]."""
_COVARIANCE = re.compile(r"covariance")
_LISTED = 60
"""Maximum number of fields listed per topic."""


@dataclass(frozen=True)
class _Seen:
    """Results of reading the log through an incomplete rig.

    Attributes:
        frame: of its velocity.
        wheelbase: [m], or 0.
        max_steer: for the rig's wheelbase [rad], or 0.
        assumed: True if the wheelbase is chosen to match a usual `max_steer`.
        found: controls found by the vehicle's response only, with their correlation.
        straight: recorded steering in straight driving; None if its centre is not guessed.
        plain: True if fields named as speed and turn rate are throttle and steering themselves.
        heading: unit of a yaw if the course contradicts its range, e.g. for an unwrapped yaw.
        backwards: True if negative pedal values drive backwards.
        in_hand: True if the steering angle is the steering wheel's.
    """

    frame: str = "unknown"
    wheelbase: float = 0.0
    max_steer: float = 0.0
    assumed: bool = False
    found: Found = field(default_factory=dict)
    straight: float | None = None
    plain: bool = False
    heading: str = ""
    backwards: bool = False
    in_hand: bool = False


def write_rig(text: str, path: Path) -> None:
    """Write the text of a rig to a new file.

    Raises:
        RigError: the file exists.
    """
    refuse_existing(path)
    write_text(path, text)


def refuse_existing(path: Path) -> None:
    """Raise an error if a new rig would replace a file.

    Raises:
        RigError: the file exists.
    """
    if path.exists():
        raise RigError("already exists", where=path, how="give --write-rig a new name")


def draft_rig(log: Log) -> str:
    """Return a first rig as TOML for `offpiste.rig.rig.parse_rig`.

    Raises:
        LogError: no pose was found, or its samples cannot be read.
    """
    text = _text(log, _Seen())
    rig = parse_rig(text, where="the drafted rig")
    if read_by_arrival(log, rig):  # as in the remedy
        log = ReceivedLog(log)
        rig = parse_rig(text := _text(log, _Seen()), where="the drafted rig")
    posed = pose_cure(log, rig)
    plain = _is_plain(log, edited(rig, posed))
    if plain:
        rig = parse_rig(_text(log, _Seen(plain=True)), where="the drafted rig")
    if found := find_controls(log, edited(rig, posed)):
        rig = parse_rig(_text(log, _Seen(found=found, plain=plain)), where="the drafted rig")
    if in_hand := is_of_steering_wheel(log, edited(rig, posed)):
        rig = parse_rig(_text(log, _Seen(found=found, plain=plain, in_hand=True)), where="the drafted rig")
    rig = edited(rig, posed)
    frame = _frame(log, rig) if "linear_velocity" in rig.channels else "unknown"
    wheelbase = estimated_wheelbase(log, rig)
    max_steer, assumed = estimated_max_steer(log, rig, wheelbase or rig.vehicle.wheelbase), False
    if not wheelbase and max_steer and rig.channels["steer"].unit in ("rad", "deg"):  # a commanded angle
        shown = rig.vehicle.wheelbase * float(np.tan(rig.vehicle.max_steer) / np.tan(max_steer))
        wheelbase = shown if WHEELBASES[0] < shown < WHEELBASES[1] else 0.0
    if max_steer > MAX_STEERS[1] and not wheelbase:  # a vehicle smaller than the default
        wheelbase, assumed = rig.vehicle.wheelbase * float(np.tan(_MAX_STEER) / np.tan(max_steer)), True
        max_steer = _MAX_STEER
    heading = next((str(edit.value) for edit in posed if edit.key == "channels.yaw.unit"), "")
    straight, backwards = steering_straight(log, rig), reverses_by_pedal(log, rig)
    seen = _Seen(frame, wheelbase, max_steer, assumed, found, straight, plain, heading, backwards, in_hand)
    return text if seen == _Seen() else _text(log, seen)


def _is_plain(log: Log, rig: Rig) -> bool:
    """Return True if a field named as a turn rate is the steering: the yaw rate follows it times the speed."""
    source = rig.channels.get("steer")
    if source is None or not source.turns:
        return False
    plain = structs.replace(rig, channels={**rig.channels, "steer": ChannelSource(source.fields[:1], source.topic)})
    try:
        path = driven_path(drive_from_log(log, rig))
        return not is_turn_rate(read_channel(log, plain, "steer", plain.channels["steer"])[0], path, plain)
    except OffpisteError:
        return False


def _text(log: Log, seen: _Seen) -> str:
    known = {"plain": seen.plain, "backwards": seen.backwards, "in_hand": seen.in_hand}
    entries = draft_channels(log, seen.frame, seen.found, seen.straight, max_steer=seen.max_steer, **known)
    if not {"position"} <= set(entries) or not {"orientation", "yaw"} & set(entries):
        raise no_pose(log)
    if seen.heading and not entries["yaw"].guess.unit and "scale" not in str(entries["yaw"].lines):
        unit = () if seen.heading == "rad" else (f'unit = "{seen.heading}"',)
        comment = f"{entries['yaw'].comment}; in {seen.heading} by the course"
        entries["yaw"] = replace(entries["yaw"], lines=unit, comment=comment)
    absent = undeclared(entries)
    parts = [_header(log, entries, absent, seen)]
    if "steer" in absent:
        why = _why_missing(log, "steer", "steer_angle")
        parts += [_NO_STEERING.format(why=why, candidates=steering_candidates(log))]
    parts += [_NO_THROTTLE.format(why=_why_missing(log, "throttle"))] if "throttle" in absent else []
    parts += of_other_vehicles(entries)
    for channel, entry in entries.items():
        parts += [
            f"[channels.{channel}]  # {entry.comment}{_joints(log, entry)}",
            f"topic = {_toml(entry.guess.topic)}",
            f"fields = {_toml(entry.guess.fields)}",
            *entry.lines,
            *_named_joints(log, entry),
            "",
        ]
    if points_down(log, entries["position"].guess):
        parts += ["[motion]  # GUESSED by the pose's name, or the type of its messages", 'axes = "ned"', ""]
    parts += _clock(log) + _unread(log, entries)
    return "\n".join([*parts, draft_sensors(log, entries["position"].guess.topic)])


def _joints(log: Log, entry: Entry) -> str:
    """Return the message's names for fields that are array entries."""
    joints = log.topics[entry.guess.topic].joints
    named = [f"{joints[field]} is {field}" for field in entry.guess.fields if field in joints]
    return f"; {', '.join(named)}" if named else ""


def _named_joints(log: Log, entry: Entry) -> list[str]:
    """Return the names used to look up array entries in each message."""
    names = [log.topics[entry.guess.topic].joint_of(field) for field in entry.guess.fields]
    return [f"joints = {_toml(names)}"] if all(names) else []


def _header(log: Log, entries: Mapping[str, Entry], absent: list[str], seen: _Seen) -> str:
    name, wheelbase = log.path.resolve().name.split(".")[0], seen.wheelbase
    wheels = WHEELS if not wheelbase else wheels_of(wheelbase)
    source = f"{GUESSED}: mass and wheel positions are a small car's"
    if wheelbase:
        by = f"that turns so with {_MAX_STEER} rad" if seen.assumed else "by yaw rate and steering angle"
        source = f"{GUESSED}: a wheelbase of {wheelbase:.3g} m {by}; the rest is made up"
    stated = next((entry.max_angle for entry in entries.values() if entry.max_angle), 0.0)
    return _HEADER.format(
        name=name,
        quoted=_toml(name),
        absent=_toml(absent),
        source=_toml(source),
        mass=MASS if not wheelbase else float(f"{MASS * (wheelbase / SMALL_CAR) ** 3:.2g}"),
        max_steer=stated or seen.max_steer or _MAX_STEER,
        origin=_origin(seen, entries["steer"] if stated else None),
        wheels=_toml(wheels),
    )


def _origin(seen: _Seen, stated: Entry | None) -> str:
    """Return the source of the drafted `max_steer`: the measured angle if the command is normalised."""
    if stated is not None:
        is_angle = any(f'unit = "{unit}"' in stated.lines for unit in ANGLES)
        return "; the largest of this log" if is_angle else "; by the steering angle of this log"
    return "; by the yaw rate, for this wheelbase" if seen.max_steer and not seen.assumed else ""


def _clock(log: Log) -> list[str]:
    """Return the clock settings if the log had to guess the clock."""
    clock = log.clock
    if clock == Clock():
        return []
    unit = [f"unit = {_toml(clock.unit)}"] if clock.unit != Clock().unit else []
    return ["[clock]  # GUESSED", f"column = {_toml(clock.column)}", *unit, ""]


def _unread(log: Log, entries: Mapping[str, Entry]) -> list[str]:
    """Return comments that list the unused fields, those of used topics first."""
    lines = []
    for name in dict.fromkeys((*(entry.guess.topic for entry in entries.values()), *log.topics)):
        read = {field for e in entries.values() if e.guess.topic == name for field in e.guess.fields}
        topic = log.topics[name]
        if is_bulk(topic) or (topic.part_of and not read):
            continue
        named = [f for f in topic.fields if f in topic.joints or not read or not is_array_entry(f)]
        named = [f for f in named if not _COVARIANCE.search(f)]
        rest = [topic.in_words(f) for f in named if f not in read and f != log.clock.column]
        if rest:
            more = [f"and {len(rest) - _LISTED} more"] if len(rest) > _LISTED else []
            where = f"fields of {name}" if name else "columns"
            lines += wrap(f"Not read: {where}: {', '.join(rest[:_LISTED] + more)}", 118)
    return [*(f"# {line}" for line in lines), ""] if lines else []


def _why_missing(log: Log, *channels: str) -> str:
    """Return the reason why a control has no field: unreadable, constant or not found."""
    for guess in (guess for guess in guess_channels(log) if guess.channel in channels):
        try:
            log.read(guess.topic, guess.fields)
        except OffpisteError as error:
            return error.what
        values = field_values(log, guess)
        if values is not None and np.ptp(values) == 0:
            return f"{guess.topic and f'{guess.topic} '}{', '.join(guess.fields)} is always {values[0, 0]:g}"
    return "no field looks like it"


def _toml(value: object) -> str:
    """Return a string or a list of strings; JSON and TOML share this syntax."""
    return json.dumps(value, ensure_ascii=False)


def _frame(log: Log, rig: Rig) -> str:
    """Return the frame that best fits the recorded velocity, or "unknown" if ambiguous."""
    try:
        drive = drive_from_log(log, rig)
        fits = sorted(fit_frames(drive, driven_path(drive)).values(), key=lambda fit: fit.misfit)
    except OffpisteError:
        return "unknown"
    return fits[0].frame if fits and fits[0].misfit < 0.3 else "unknown"
