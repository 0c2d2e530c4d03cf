"""The pose of a first rig, and velocities beside it: which topics hold them, by names, types and numbers."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.errors import OffpisteError
from offpiste.inspection.channel_guesses import Guess, by_topic
from offpiste.inspection.commanded_motion import COMMANDED
from offpiste.logs.log import Log
from offpiste.rig.labels import channel_unit

_POSE: Final = ("position", "orientation", "yaw", "linear_velocity", "angular_velocity")
_LAST: Final = re.compile(r"wheel|controller|ecef", re.IGNORECASE)
"""Names of topics with the odometry of wheels, or in the earth's own frame, whose z is not up."""
_RATES: Final = {"angular_velocity", "yaw_rate"}


@dataclass(frozen=True)
class Entry:
    """A channel of a first rig.

    Attributes:
        lines: TOML besides topic and fields.
        comment: why it was chosen.
        max_angle: of road wheels at a steering command of 1 [rad], where this channel says so; else 0.
    """

    guess: Guess
    lines: tuple[str, ...]
    comment: str
    max_angle: float = 0.0


def draft_pose(log: Log, guesses: Sequence[Guess], frame: str) -> dict[str, Entry]:
    """The topic with most of a pose and velocities, by their number, its rate, then its place in the log.

    The odometry of wheels, which slip, and poses in the earth's frame come after others. Where none has both a position
    and a heading, as with a GNSS receiver beside an IMU, each comes from its own topic.
    """
    best: dict[str, Guess] = {}
    best_score = (0, False, 0)
    channels_of = by_topic(guesses)
    for topic in (name for name in log.topics if name in channels_of):
        channels = channels_of[topic]
        if "position" not in channels or not {"orientation", "yaw"} & set(channels):
            continue
        moving = {c: g for c, g in channels.items() if c not in _POSE or _varies(field_values(log, g))}
        score = (sum(c in _POSE for c in moving), _LAST.search(topic) is None, log.topics[topic].count)
        if "position" in moving and score > best_score:
            best, best_score = moving, score
    best = best or _places_and_headings(log, channels_of)
    if best and not _RATES & set(best):
        best |= _from_imu(log, channels_of)
    if best and "linear_velocity" not in best:
        best |= _velocity_beside(log, channels_of)
    entries: dict[str, Entry] = {}
    for channel in _POSE:
        if channel not in best:
            continue
        guess = best[channel]
        lines, comment = unit_line(channel, guess), f"GUESSED by its name, as of {log.topics[guess.topic].type}"
        if channel == "linear_velocity":
            lines += (f'frame = "{frame}"',)
            comment += "" if frame == "unknown" else "; frame by the pose"
        elif channel == "angular_velocity":
            lines, comment = (*lines, 'frame = "body"'), comment + "; in the body's frame, as gyroscopes measure"
        elif channel == "yaw" and not guess.unit and (values := field_values(log, guess)) is not None:
            lines += degrees(values[:, 0])
        entries[channel] = Entry(guess, lines, comment)
    return entries


def _places_and_headings(log: Log, channels_of: Mapping[str, Mapping[str, Guess]]) -> dict[str, Guess]:
    """A position and a heading of different topics, those with most samples; empty where one is missing."""
    often = sorted(channels_of, key=lambda topic: -log.topics[topic].count)
    of_kind = [
        [g for topic in often for c, g in channels_of[topic].items() if c in kind and _varies(field_values(log, g))]
        for kind in (("position",), ("orientation", "yaw"))
    ]
    return {guesses[0].channel: guesses[0] for guesses in of_kind} if all(of_kind) else {}


def _from_imu(log: Log, channels_of: Mapping[str, Mapping[str, Guess]]) -> dict[str, Guess]:
    """The angular velocity of the IMU that reports most often, where the pose's topic has none."""
    imus = [topic for topic in channels_of if "imu" in log.topics[topic].type.lower()]
    for topic in sorted(imus, key=lambda topic: -log.topics[topic].count):
        guess = channels_of[topic].get("angular_velocity")
        if guess is not None and _varies(field_values(log, guess)):
            return {"angular_velocity": guess}
    return {}


def _velocity_beside(log: Log, channels_of: Mapping[str, Mapping[str, Guess]]) -> dict[str, Guess]:
    """The velocity that is reported most often, where the pose's topic has none; commands are none."""
    for topic in sorted(channels_of, key=lambda topic: -log.topics[topic].count):
        guess = channels_of[topic].get("linear_velocity")
        if guess is not None and not COMMANDED.search(topic) and _varies(field_values(log, guess)):
            return {"linear_velocity": guess}
    return {}


def field_values(log: Log, guess: Guess) -> Float[np.ndarray, "n k"] | None:
    """Finite rows of a guess's fields, None where they cannot be read."""
    try:
        values = log.read(guess.topic, guess.fields).values
    except OffpisteError:
        return None
    values = values[np.isfinite(values).all(axis=1)]
    return values if len(values) > 1 else None


def unit_line(channel: str, guess: Guess) -> tuple[str, ...]:
    """The unit that the log states, where it is one of the channel's and not offpiste's own."""
    unit = channel_unit(channel, guess.unit)
    return (f'unit = "{unit}"',) if unit else ()


def degrees(values: Float[np.ndarray, " n"]) -> tuple[str, ...]:
    """The unit of an angle that no radians would be; receivers of u-blox count hundred-thousandths of a degree."""
    largest = np.abs(values).max()
    if np.ptp(values) > 20 and largest <= 361:
        return ('unit = "deg"',)
    counted = np.ptp(values) > 2e6 and largest <= 361e5 and bool((values == np.round(values)).all())
    return ("scale = 1e-5", 'unit = "deg"') if counted else ()


def _varies(values: Float[np.ndarray, "n k"] | None) -> bool:
    return values is not None and bool(np.ptp(values, axis=0).max() > 0)
