"""First rig for a log, guessed from names and values; a comment states each guess."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np
from msgspec import structs

from offpiste.core.errors import OffpisteError, RigError
from offpiste.inspection.by_motion import find_controls, find_heading
from offpiste.inspection.clocks import read_by_arrival
from offpiste.inspection.draft_channels import LARGEST_SHARE, Facts, draft_channels
from offpiste.inspection.draft_pose import Entry, choose_pose, points_down, pose_cure, varies
from offpiste.inspection.draft_sensors import draft_sensors
from offpiste.inspection.draft_values import (
    SMALL_CAR,
    USUAL_STEER,
    full_curvature,
    shown_wheelbase,
    steering_straight,
    vehicle_size,
    wheels_of,
)
from offpiste.inspection.driven_path import DrivenPath, driven_path
from offpiste.inspection.gear import reverses_by_pedal
from offpiste.inspection.missing import steering_candidates, why_missing
from offpiste.inspection.naming import MOTION, Guess, field_values, guess_channels
from offpiste.inspection.recorded_log import ReceivedLog, is_bulk
from offpiste.inspection.response import steering_fit, steering_fits, turn_rate_fit
from offpiste.inspection.usual_ranges import RANGES
from offpiste.inspection.velocity import fit_frames
from offpiste.logs.channel import read_channel
from offpiste.logs.drive import Drive, drive_from_log
from offpiste.logs.log import Log, Topic
from offpiste.rig.channels import ANGLES, ChannelSource, Clock, undeclared
from offpiste.rig.edits import edited, toml_value
from offpiste.rig.labels import is_array_entry
from offpiste.rig.rig import GUESSED, Rig, parse_rig

_MISSING = {
    "steer": "# MISSING: steering: {why}; no model can do without. Add [channels.steer] and take steer out of `absent`."
    " {candidates}\n",
    "throttle": "# MISSING: throttle: {why}; without it no model can predict the speed. Add [channels.throttle] and"
    " take throttle out of `absent`.\n",
}
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
_LISTED = 60
"""Maximum number of fields listed per topic."""


def refuse_existing(path: Path) -> None:
    """Raise an error if a new rig would replace a file.

    Raises:
        RigError: the file exists.
    """
    if path.exists():
        raise RigError("already exists", where=path, how="give --write-rig a new name")


@dataclass(frozen=True)
class Draft:
    """First rig of a log as far as it is known.

    Attributes:
        guesses: of the channels, best first.
    """

    log: Log
    guesses: tuple[Guess, ...]
    facts: Facts = field(default_factory=Facts)

    @cached_property
    def entries(self) -> dict[str, Entry]:
        """Channels; see `draft_channels` for errors."""
        return draft_channels(self.log, self.guesses, self.facts)

    @cached_property
    def text(self) -> str:
        """TOML; see `draft_channels` for errors."""
        log, entries, absent = self.log, self.entries, undeclared(self.entries)
        parts = [_header(self, absent)]
        for control, words in _MISSING.items():
            if control in absent:
                why, candidates = why_missing(log, self.guesses, control), steering_candidates(log)
                parts.append(words.format(why=why, candidates=candidates))
        parts += [_channel(log.topics[entry.guess.topic], channel, entry) for channel, entry in entries.items()]
        if points_down(log, entries["position"].guess):
            parts += ["[motion]  # GUESSED by the pose's name, or the type of its messages", 'axes = "ned"', ""]
        parts += _clock(log) + _unread(log, entries)
        return "\n".join([*parts, draft_sensors(log, entries["position"].guess.topic)])

    @cached_property
    def rig(self) -> Rig:
        """Rig of the text; see `draft_channels` for errors."""
        return parse_rig(self.text, where="the drafted rig")

    def changed(self, channel: str, **changes: Any) -> "Draft":
        """Return the draft with another guess of a channel."""
        old = self.entries[channel].guess
        return replace(self, guesses=tuple(replace(one, **changes) if one == old else one for one in self.guesses))


def draft_rig(log: Log, namespace: str = "") -> str:
    """Return a first rig as TOML for `offpiste.rig.rig.parse_rig`.

    Facts that only the motion shows are found by reading the log through the rig so far.

    Args:
        namespace: of the vehicle, if the log holds several, e.g. `/robot1`.

    Raises:
        LogError: no pose was found, or its samples cannot be read.
    """
    draft = Draft(log, _guesses(log, namespace))
    if read_by_arrival(log, draft.rig):  # as in the remedy
        log = ReceivedLog(log)
        draft = replace(draft, log=log)
    posed = pose_cure(log, draft.rig)
    if _are_shares(log, edited(draft.rig, posed)):
        draft = _with_shares(draft)
    found = find_controls(log, edited(draft.rig, posed))
    draft = replace(draft, guesses=(*draft.guesses, *found.values()))
    if (seen := _driven(log, edited(draft.rig, posed))) is None:
        return draft.text
    wheelbase = shown_wheelbase(*seen, steering_fits(*seen).get("steer_angle"))
    if wheelbase > RANGES["wheelbases"][1]:
        draft = draft.changed("steer_angle", is_handwheel=True)
        seen = _driven(log, edited(draft.rig, posed)) or seen
    rig, steering = seen[0].rig, steering_fits(*seen).get("steer")
    unit = next((str(edit.value) for edit in posed if edit.key == "channels.yaw.unit"), "")
    if unit and not (yaw := draft.entries["yaw"]).guess.unit and "scale" not in yaw.settings:
        draft = draft.changed("yaw", unit=unit, why=f"{yaw.guess.why}; in {unit} by the course")
    size = vehicle_size(wheelbase, full_curvature(log, rig, steering), rig)
    facts = Facts(_frame(*seen), *size, steering_straight(rig, steering), reverses_by_pedal(log, rig))
    return replace(draft, facts=facts).text


def _driven(log: Log, rig: Rig) -> tuple[Drive, DrivenPath] | None:
    """Return the drive as read through a rig, and the driven path; None if that fails."""
    try:
        return (drive := drive_from_log(log, rig)), driven_path(drive)
    except OffpisteError:
        return None


def _guesses(log: Log, namespace: str) -> tuple[Guess, ...]:
    """Return the guesses by names, and a heading that only the course shows if no name is that of one."""
    guesses = tuple(guess_channels(log, namespace))
    places = [guess for guess in guesses if guess.channel == "position" and varies(field_values(log, guess))]
    heading = find_heading(log, places[0]) if places and not choose_pose(log, guesses) else None
    return guesses if heading is None else (*guesses, heading)


def _are_shares(log: Log, rig: Rig) -> bool:
    """Return True if a field named as a turn rate is the steering: the yaw rate follows it times the speed."""
    source = rig.channels.get("steer")
    seen = _driven(log, rig) if source is not None and source.turns else None
    if source is None or seen is None:
        return False
    plain = structs.replace(rig, channels={**rig.channels, "steer": ChannelSource(source.fields[:1], source.topic)})
    try:
        channel = read_channel(log, plain, "steer", plain.channels["steer"])[0]
        return turn_rate_fit(channel, seen[1], plain, steering_fit(channel, seen[1], plain)) is None
    except OffpisteError:
        return False


def _with_shares(draft: Draft) -> Draft:
    """Return a draft in which a commanded turn rate is the steering of any unit, and a speed up to 1 the throttle."""
    draft = draft.changed("steer", fields=draft.entries["steer"].guess.fields[:1], unit="", rank=1)
    throttle = draft.entries.get("throttle")
    values = None if throttle is None or throttle.guess.rank != MOTION else field_values(draft.log, throttle.guess)
    if values is None or np.abs(values).max() > LARGEST_SHARE:
        return draft
    guesses = tuple(guess for guess in draft.guesses if guess.channel != "gear")
    return replace(draft, guesses=guesses).changed("throttle", unit="", rank=1)


def _channel(topic: Topic, channel: str, entry: Entry) -> str:
    """Return a channel's table, with names of joints if its fields are array entries of joint states."""
    fields = entry.guess.fields
    named = "".join(f"; {topic.joints[field]} is {field}" for field in fields if field in topic.joints)
    joints = [topic.joint_of(field) for field in fields]
    why = "; ".join(filter(None, (f"GUESSED {entry.guess.why}", entry.note)))
    lines = [f"[channels.{channel}]  # {why}{named}", f"topic = {toml_value(topic.name)}"]
    lines += [f"{key} = {toml_value(value)}" for key, value in {"fields": fields, **entry.settings}.items()]
    return "\n".join([*lines, *([f"joints = {toml_value(joints)}"] if all(joints) else []), ""])


def _header(draft: Draft, absent: list[str]) -> str:
    facts = draft.facts
    name, wheelbase = draft.log.path.resolve().name.split(".")[0], facts.wheelbase or SMALL_CAR
    source = f"{GUESSED}: mass and wheel positions are a small car's"
    if facts.wheelbase:
        by = f"that turns so with {USUAL_STEER} rad" if facts.assumed else "by yaw rate and steering angle"
        source = f"{GUESSED}: a wheelbase of {wheelbase:.3g} m {by}; the rest is made up"
    stated = next((entry for entry in draft.entries.values() if entry.max_angle), None)
    origin = "; by the yaw rate, for this wheelbase" if facts.max_steer and not facts.assumed else ""
    if stated is not None:  # an angle, or a command that turns the wheels by one
        origin = (
            "; the largest of this log"
            if stated.settings.get("unit") in ANGLES
            else "; by the steering angle of this log"
        )
    return _HEADER.format(
        name=name,
        quoted=toml_value(name),
        absent=toml_value(absent),
        source=toml_value(source),
        mass=float(f"{RANGES['mass'] * (wheelbase / SMALL_CAR) ** 3:.2g}"),
        max_steer=stated.max_angle if stated is not None else facts.max_steer or USUAL_STEER,
        origin=origin,
        wheels=toml_value(wheels_of(wheelbase)),
    )


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


def _frame(drive: Drive, path: DrivenPath) -> str:
    """Return the frame that best fits the recorded velocity, or "unknown" if ambiguous."""
    fits = fit_frames(drive, path) if "linear_velocity" in drive.channels else {}
    best = min(fits.values(), key=lambda fit: fit.misfit, default=None)
    return best.frame if best is not None and best.misfit < 0.3 else "unknown"
