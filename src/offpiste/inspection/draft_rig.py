"""A first rig for a log: guessed from names and numbers, each guess stated in a comment."""

import json
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from offpiste.errors import LogError, OffpisteError, RigError
from offpiste.files import write_text
from offpiste.inspection.channel_guesses import Guess, by_topic, guess_channels
from offpiste.inspection.draft_sensors import draft_sensors, missing
from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.findings import number
from offpiste.inspection.signals import find_wrap
from offpiste.inspection.velocity import fit_frames
from offpiste.logs.drive import drive_from_log
from offpiste.logs.log import Log
from offpiste.rig.channels import Wrap, undeclared
from offpiste.rig.rig import Rig, parse_rig

_NO_STEERING = (
    "# MISSING: steering: no field looks like it; no model can do without. Add [channels.steer] and take steer out of"
    " `absent`. {candidates}\n"
)
_COMMANDS = re.compile(r"steer|joy|com+and|cmd|control", re.IGNORECASE)
_HEADER = """\
# A first rig for {name}, guessed by `offpiste inspect`. Every line is a guess: read it, fix it, and inspect again
# with --rig until nothing is left to fix.
name = {quoted}
absent = {absent}

[vehicle]               # GUESSED: a small car's. Measure your vehicle
mass = 1000.0           # [kg] with its load
max_steer = 0.5         # [rad] road-wheel angle at steer = 1
pose_point = "unknown"  # which point of the vehicle the pose is of
# x forward, y left of the pose point [m]: front-left, front-right, rear-left, rear-right
wheel_positions = [[1.0, 0.7], [1.0, -0.7], [-1.0, 0.7], [-1.0, -0.7]]
"""


@dataclass(frozen=True)
class _Entry:
    guess: Guess
    lines: tuple[str, ...]
    comment: str


def write_draft(log: Log, path: Path) -> list[str]:
    """Write a first rig for a log to a new file.

    Returns:
        What the log lacks, in words.

    Raises:
        RigError: the file is there already.
        LogError: nothing in the log looks like a pose, or its samples cannot be read.
    """
    if path.exists():
        raise RigError("is there already", where=path, how="give --write-rig a new name")
    drafted = draft_rig(log)
    write_text(path, drafted)
    return missing(drafted)


def draft_rig(log: Log) -> str:
    """A first rig as TOML that `offpiste.rig.rig.parse_rig` accepts.

    Raises:
        LogError: nothing in the log looks like a pose, or its samples cannot be read.
    """
    text = _text(log, "unknown")
    rig = parse_rig(text, where="the drafted rig")
    if "linear_velocity" not in rig.channels:
        return text
    return _text(log, _frame(log, rig))


def _text(log: Log, frame: str) -> str:
    entries = _entries(log, frame)
    if not {"position"} <= set(entries) or not {"orientation", "yaw"} & set(entries):
        raise LogError(
            "no topic looks like a pose (position and heading)",
            where=log.path,
            how=f"write a rig that names one; it has: {', '.join(log.topics) or 'no topic'}",
        )
    absent = undeclared(entries)
    name = log.path.resolve().name.split(".")[0]
    parts = [_HEADER.format(name=name, quoted=_toml(name), absent=_toml(absent))]
    parts += [_NO_STEERING.format(candidates=_candidates(log))] if "steer" in absent else []
    for channel, entry in entries.items():
        parts += [
            f"[channels.{channel}]  # {entry.comment}",
            f"topic = {_toml(entry.guess.topic)}",
            f"fields = {_toml(entry.guess.fields)}",
            *entry.lines,
            "",
        ]
    return "\n".join([*parts, draft_sensors(log, entries["position"].guess.topic)])


def _candidates(log: Log) -> str:
    """Numbers that may be the steering under another name, as a sentence."""
    named = [
        f"{t.name} ({', '.join(t.fields[:8])})" for t in log.topics.values() if t.fields and _COMMANDS.search(t.name)
    ]
    return f"It may be in: {'; '.join(named)}" if named else "No topic is named like a command."


def _toml(value: object) -> str:
    """Texts and lists of them are written alike in JSON and TOML."""
    return json.dumps(value, ensure_ascii=False)


def _entries(log: Log, frame: str) -> dict[str, _Entry]:
    result = guess_channels(log)
    entries = _pose(log, result, frame)
    for guess in result:
        if guess.channel in entries or guess.channel in ("position", "orientation", "linear_velocity"):
            continue
        if guess.channel == "yaw" and ("orientation" in entries or "position" not in entries):
            continue
        if guess.channel == "angular_velocity" or (guess.channel == "yaw_rate" and "angular_velocity" in entries):
            continue
        values = _values(log, guess)
        if values is None or np.ptp(values) == 0:
            continue
        entries[guess.channel] = _scalar(guess, values[:, 0])
    return entries


def _pose(log: Log, result: list[Guess], frame: str) -> dict[str, _Entry]:
    """The topic with most of a pose and velocities, by their number, its rate, then its place in the log."""
    best: dict[str, Guess] = {}
    best_score = (0, 0)
    for topic, channels in by_topic(result).items():
        if "position" not in channels or not {"orientation", "yaw"} & set(channels):
            continue
        moving = {c: g for c, g in channels.items() if c not in _POSE or _varies(_values(log, g))}
        score = (sum(c in _POSE for c in moving), log.topics[topic].count)
        if "position" in moving and score > best_score:
            best, best_score = moving, score
    entries = {}
    for channel in _POSE:
        if channel not in best:
            continue
        lines: tuple[str, ...] = ()
        comment = f"GUESSED by its name, as of {log.topics[best[channel].topic].type}"
        if channel == "linear_velocity":
            lines, comment = (f'frame = "{frame}"',), comment + ("" if frame == "unknown" else "; frame by the pose")
        elif channel == "angular_velocity":
            lines, comment = ('frame = "body"',), comment + "; frame as in REP 103"
        entries[channel] = _Entry(best[channel], lines, comment)
    return entries


_POSE = ("position", "orientation", "yaw", "linear_velocity", "angular_velocity")


def _scalar(guess: Guess, values: Float[np.ndarray, " n"]) -> _Entry:
    """Scale and wrap from the numbers: controls to 0..1 or -1..1, engine speed to 1000 rev/min."""
    lines: list[str] = []
    comment = "GUESSED by its name"
    wrap = find_wrap(values)
    if wrap is not None:
        lines.append(f"wrap = {{ above = {number(wrap.above)}, period = {wrap.period} }}")
        values = _unwrap(values, wrap)
    low, high = np.percentile(values, (0.5, 99.5))
    if guess.channel in ("throttle", "brake") and not (low >= -0.05 and 0.05 < high <= 1.05):
        scale = 1 / max(high - low, 1e-9)
        lines += [f"scale = {number(scale)}", f"offset = {number(-low * scale)}", "clip = [0.0, 1.0]"]
        comment += f"; scaled from {low:.4g}..{high:.4g} to 0..1"
    elif guess.channel == "steer" and max(-low, high) > 1.05:
        lines += [f"scale = {number(1 / max(-low, high))}", "clip = [-1.0, 1.0]"]
        comment += f"; scaled by its largest value, {max(-low, high):.4g}"
    elif guess.channel == "engine_rpm" and high > 20:
        lines.append('unit = "rev/min"')
    elif guess.channel == "yaw" and np.ptp(values) > 20 and np.abs(values).max() <= 361:
        lines.append('unit = "deg"')
    return _Entry(guess, tuple(lines), comment)


def _unwrap(values: Float[np.ndarray, " n"], wrap: Wrap) -> Float[np.ndarray, " n"]:
    return np.where(values > wrap.above, values - wrap.period, values)


def _varies(values: Float[np.ndarray, "n k"] | None) -> bool:
    return values is not None and bool(np.ptp(values, axis=0).max() > 0)


def _values(log: Log, guess: Guess) -> Float[np.ndarray, "n k"] | None:
    """Finite rows of a guess's fields, None where they cannot be read."""
    try:
        values = log.read(guess.topic, guess.fields).values
    except OffpisteError:
        return None
    values = values[np.isfinite(values).all(axis=1)]
    return values if len(values) > 1 else None


def _frame(log: Log, rig: Rig) -> str:
    """The frame that the recorded velocity fits, "unknown" where it is not clear."""
    try:
        drive = drive_from_log(log, rig)
        fits = sorted(fit_frames(drive, driven_path(drive)).values(), key=lambda fit: fit.misfit)
    except OffpisteError:
        return "unknown"
    return fits[0].frame if fits and fits[0].misfit < 0.3 else "unknown"
