"""First rig for a log, guessed from names and values; a comment states each guess."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from textwrap import wrap

import numpy as np
from msgspec import structs

from offpiste.core.errors import OffpisteError, RigError
from offpiste.inspection.naming import guess_channels
from offpiste.inspection.clocks import read_by_arrival
from offpiste.inspection.controls_by_numbers import find_controls, steering_candidates
from offpiste.inspection.draft_channels import Known, draft_channels
from offpiste.inspection.draft_pose import Entry, field_values, points_down, pose_cure
from offpiste.inspection.draft_sensors import draft_sensors
from offpiste.inspection.draft_values import (
    SMALL_CAR,
    Driven,
    driven,
    estimated_max_steer,
    shown_wheelbase,
    steering_straight,
    wheels_of,
)
from offpiste.inspection.gear import reverses_by_pedal
from offpiste.inspection.missing import no_pose
from offpiste.inspection.recorded_log import ReceivedLog, is_bulk
from offpiste.inspection.response import steering_fit, turn_rate_fit
from offpiste.inspection.steering_scale import MAX_STEERS
from offpiste.inspection.usual_ranges import RANGES
from offpiste.inspection.velocity import fit_frames
from offpiste.logs.channel import read_channel
from offpiste.logs.log import Log, Topic
from offpiste.rig.channels import ANGLES, ChannelSource, Clock, undeclared
from offpiste.rig.edits import edited, toml_value
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
_LISTED = 60
"""Maximum number of fields listed per topic."""


def refuse_existing(path: Path) -> None:
    """Raise an error if a new rig would replace a file.

    Raises:
        RigError: the file exists.
    """
    if path.exists():
        raise RigError("already exists", where=path, how="give --write-rig a new name")


def draft_rig(log: Log, namespace: str = "") -> str:
    """Return a first rig as TOML for `offpiste.rig.rig.parse_rig`.

    Facts that only the motion shows are found by reading the log through the rig so far.

    Args:
        namespace: of the vehicle, if the log holds several, e.g. `/robot1`.

    Raises:
        LogError: no pose was found, or its samples cannot be read.
    """
    text = _text(log, known := Known(namespace))
    if read_by_arrival(log, parse_rig(text, where="the drafted rig")):  # as in the remedy
        log = ReceivedLog(log)
        text = _text(log, known)
    rig = parse_rig(text, where="the drafted rig")
    posed = pose_cure(log, rig)

    def redrafted(known: Known) -> Rig:
        return edited(parse_rig(_text(log, known), where="the drafted rig"), posed)

    rig = edited(rig, posed)
    if _is_plain(log, rig):
        rig = redrafted(known := replace(known, plain=True))
    if found := find_controls(log, rig):
        rig = redrafted(known := replace(known, found=found))
    seen, (shortest, longest) = driven(log, rig), RANGES["wheelbases"]
    wheelbase, assumed = shown_wheelbase(seen), False
    if wheelbase > longest:
        rig = redrafted(known := replace(known, is_handwheel=True))
        seen = driven(log, rig)
    wheelbase = wheelbase if shortest < wheelbase < longest else 0.0
    steering = None if seen is None else seen.steering("steer")
    max_steer = estimated_max_steer(log, rig, steering, wheelbase or rig.vehicle.wheelbase)
    if not wheelbase and max_steer and rig.channels["steer"].unit in ("rad", "deg"):  # a commanded angle
        shown = rig.vehicle.wheelbase * float(np.tan(rig.vehicle.max_steer) / np.tan(max_steer))
        wheelbase = shown if shortest < shown < longest else 0.0
    if max_steer > MAX_STEERS[1] and not wheelbase:  # a vehicle smaller than the default
        wheelbase, assumed = rig.vehicle.wheelbase * float(np.tan(_MAX_STEER) / np.tan(max_steer)), True
        max_steer = _MAX_STEER
    known = replace(
        known,
        frame=_frame(seen),
        wheelbase=wheelbase,
        max_steer=max_steer,
        assumed=assumed,
        straight=steering_straight(rig, steering),
        heading=next((str(edit.value) for edit in posed if edit.key == "channels.yaw.unit"), ""),
        backwards=reverses_by_pedal(log, rig),
    )
    return text if known == Known(namespace) else _text(log, known)


def _is_plain(log: Log, rig: Rig) -> bool:
    """Return True if a field named as a turn rate is the steering: the yaw rate follows it times the speed."""
    source = rig.channels.get("steer")
    seen = driven(log, rig) if source is not None and source.turns else None
    if source is None or seen is None:
        return False
    plain = structs.replace(rig, channels={**rig.channels, "steer": ChannelSource(source.fields[:1], source.topic)})
    try:
        channel = read_channel(log, plain, "steer", plain.channels["steer"])[0]
        return turn_rate_fit(channel, seen.path, plain, steering_fit(channel, seen.path, plain)) is None
    except OffpisteError:
        return False


def _text(log: Log, known: Known) -> str:
    entries = draft_channels(log, known)
    if "position" not in entries or not {"orientation", "yaw"} & set(entries):
        raise no_pose(log)
    absent = undeclared(entries)
    parts = [_header(log, entries, absent, known)]
    if "steer" in absent:
        why = _why_missing(log, known, "steer", "steer_angle")
        parts += [_NO_STEERING.format(why=why, candidates=steering_candidates(log))]
    parts += [_NO_THROTTLE.format(why=_why_missing(log, known, "throttle"))] if "throttle" in absent else []
    parts += [_channel(log.topics[entry.guess.topic], channel, entry) for channel, entry in entries.items()]
    if points_down(log, entries["position"].guess):
        parts += ["[motion]  # GUESSED by the pose's name, or the type of its messages", 'axes = "ned"', ""]
    parts += _clock(log) + _unread(log, entries)
    return "\n".join([*parts, draft_sensors(log, entries["position"].guess.topic)])


def _channel(topic: Topic, channel: str, entry: Entry) -> str:
    """Return a channel's table, with names of joints if its fields are array entries of joint states."""
    fields = entry.guess.fields
    named = "".join(f"; {topic.joints[field]} is {field}" for field in fields if field in topic.joints)
    joints = [topic.joint_of(field) for field in fields]
    why = "; ".join(filter(None, (f"GUESSED {entry.guess.why}", entry.note)))
    lines = [f"[channels.{channel}]  # {why}{named}", f"topic = {toml_value(topic.name)}"]
    lines += [f"fields = {toml_value(fields)}", *entry.lines]
    return "\n".join([*lines, *([f"joints = {toml_value(joints)}"] if all(joints) else []), ""])


def _header(log: Log, entries: Mapping[str, Entry], absent: list[str], known: Known) -> str:
    name, wheelbase = log.path.resolve().name.split(".")[0], known.wheelbase or SMALL_CAR
    source = f"{GUESSED}: mass and wheel positions are a small car's"
    if known.wheelbase:
        by = f"that turns so with {_MAX_STEER} rad" if known.assumed else "by yaw rate and steering angle"
        source = f"{GUESSED}: a wheelbase of {wheelbase:.3g} m {by}; the rest is made up"
    stated = next((entry.max_angle for entry in entries.values() if entry.max_angle), 0.0)
    return _HEADER.format(
        name=name,
        quoted=toml_value(name),
        absent=toml_value(absent),
        source=toml_value(source),
        mass=float(f"{RANGES['mass'] * (wheelbase / SMALL_CAR) ** 3:.2g}"),
        max_steer=stated or known.max_steer or _MAX_STEER,
        origin=_origin(known, entries["steer"] if stated else None),
        wheels=toml_value(wheels_of(wheelbase)),
    )


def _origin(known: Known, stated: Entry | None) -> str:
    """Return the source of the drafted `max_steer`: the measured angle if the command is normalised."""
    if stated is not None:
        is_angle = any(f'unit = "{unit}"' in stated.lines for unit in ANGLES)
        return "; the largest of this log" if is_angle else "; by the steering angle of this log"
    return "; by the yaw rate, for this wheelbase" if known.max_steer and not known.assumed else ""


def _clock(log: Log) -> list[str]:
    """Return the clock settings if the log had to guess the clock."""
    clock = log.clock
    if clock == Clock():
        return []
    unit = [f"unit = {toml_value(clock.unit)}"] if clock.unit != Clock().unit else []
    return ["[clock]  # GUESSED", f"column = {toml_value(clock.column)}", *unit, ""]


def _unread(log: Log, entries: Mapping[str, Entry]) -> list[str]:
    """Return comments that list the unused fields, those of used topics first."""
    lines = []
    for name in dict.fromkeys((*(entry.guess.topic for entry in entries.values()), *log.topics)):
        read = {field for e in entries.values() if e.guess.topic == name for field in e.guess.fields}
        topic = log.topics[name]
        if is_bulk(topic) or (topic.part_of and not read):
            continue
        named = [f for f in topic.fields if f in topic.joints or not read or not is_array_entry(f)]
        named = [f for f in named if "covariance" not in f]
        rest = [topic.in_words(f) for f in named if f not in read and f != log.clock.column]
        if rest:
            more = [f"and {len(rest) - _LISTED} more"] if len(rest) > _LISTED else []
            where = f"fields of {name}" if name else "columns"
            lines += wrap(f"Not read: {where}: {', '.join(rest[:_LISTED] + more)}", 118)
    return [*(f"# {line}" for line in lines), ""] if lines else []


def _why_missing(log: Log, known: Known, *channels: str) -> str:
    """Return the reason why a control has no field: unreadable, constant or not found."""
    for guess in (guess for guess in guess_channels(log, known.namespace) if guess.channel in channels):
        try:
            log.read(guess.topic, guess.fields)
        except OffpisteError as error:
            return error.what
        values = field_values(log, guess)
        if values is not None and np.ptp(values) == 0:
            return f"{guess.topic and f'{guess.topic} '}{', '.join(guess.fields)} is always {values[0, 0]:g}"
    return "no field looks like it"


def _frame(seen: Driven | None) -> str:
    """Return the frame that best fits the recorded velocity, or "unknown" if ambiguous."""
    if seen is None or "linear_velocity" not in seen.drive.channels:
        return "unknown"
    fits = sorted(fit_frames(seen.drive, seen.path).values(), key=lambda fit: fit.misfit)
    return fits[0].frame if fits and fits[0].misfit < 0.3 else "unknown"
