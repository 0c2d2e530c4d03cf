"""Guesses which topics and fields may feed which channel, by their names and types."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from offpiste.channels import ACTUATORS, CONTROLS, all_actuators, all_controls
from offpiste.logs.log import Log, Topic

_AXIS = re.compile(r"(?<![a-z])([pqvw]?)x(?![a-z])", re.IGNORECASE)
_GROUPS: tuple[tuple[str, re.Pattern[str]], ...] = (
    ("orientation", re.compile(r"orient|quat|rot|(^|[^a-z])q$", re.IGNORECASE)),
    ("angular_velocity", re.compile(r"angular|gyro|omega|(^|[^a-z])w$", re.IGNORECASE)),
    ("linear_velocity", re.compile(r"linear_?vel|twist\.linear|vel|(^|[^a-z])v$", re.IGNORECASE)),
    ("position", re.compile(r"pos|vicon|mocap|optitrack|translation|(^|[^a-z])p?$", re.IGNORECASE)),
)
_NOT_GROUPS = re.compile(r"acc|magn|(?<![a-z])mag(?![a-z])|gravity|force|effort|imu.*orient", re.IGNORECASE)
_SCALARS: tuple[tuple[str, re.Pattern[str]], ...] = (
    ("yaw", re.compile(r"(?<![a-z])(yaw|heading|psi)$", re.IGNORECASE)),
    ("yaw_rate", re.compile(r"yaw_?rate|(^|[ ._])w( \(imu\))?$|gyro_?z", re.IGNORECASE)),
)


def _scalars() -> tuple[tuple[str, re.Pattern[str]], ...]:
    """Channels of one number, with the names of fields that may hold them; registered ones are tried first."""
    named = [(control.name, control.pattern, control in CONTROLS) for control in all_controls()]
    named += [(actuator.channel, actuator.pattern, actuator in ACTUATORS) for actuator in all_actuators()]
    own, more = (
        tuple((name, re.compile(pattern, re.IGNORECASE)) for name, pattern, ships in named if pattern and ships is kind)
        for kind in (True, False)
    )
    return (*more, *_SCALARS, *own)


_NOT_SCALARS = re.compile(r"velocity|rate_of|status|enable|mode|valid|stamp|count|jerk", re.IGNORECASE)
_TARTANDRIVE: dict[str, tuple[tuple[str, tuple[str, ...]], ...]] = {
    "odometry.npy": (
        ("position", ("0", "1", "2")),
        ("orientation", ("3", "4", "5", "6")),
        ("linear_velocity", ("7", "8", "9")),
        ("angular_velocity", ("10", "11", "12")),
    ),
    "control.npy": (("brake", ("0",)), ("throttle", ("1",))),
}
"""Columns of TartanDrive's arrays, which have no names."""


@dataclass(frozen=True)
class Guess:
    """A channel and where it may come from."""

    channel: str
    topic: str
    fields: tuple[str, ...]


def guess_channels(log: Log) -> list[Guess]:
    """All guesses that names and types suggest, in the log's order."""
    return [guess for topic in log.topics.values() if topic.count > 1 for guess in _of_topic(topic)]


def _of_topic(topic: Topic) -> Iterator[Guess]:
    if topic.type in _TARTANDRIVE:
        for channel, fields in _TARTANDRIVE[topic.type]:
            if set(fields) <= set(topic.fields):
                yield Guess(channel, topic.name, fields)
        return
    taken: set[str] = set()
    for guess in _vectors(topic):
        taken |= set(guess.fields)
        yield guess
    for field in topic.fields:
        # A message with a single number is named by its topic.
        name = f"{topic.name}/{field}" if len(topic.fields) <= 2 else field
        if field in taken or field.endswith("]") or _NOT_SCALARS.search(name):
            continue
        for channel, pattern in _scalars():
            if pattern.search(name):
                yield Guess(channel, topic.name, (field,))
                break


def _vectors(topic: Topic) -> Iterator[Guess]:
    """Guesses at vectors: fields that differ in one letter, x, y, z or w."""
    for field in topic.fields:
        for match in _AXIS.finditer(field):
            if _NOT_GROUPS.search(field):
                continue
            before, after = field[: match.end() - 1], field[match.end() :]
            axes = [a for a in "yzw" if before + a + after in topic.fields]
            fields = (field, *(before + a + after for a in axes))
            channel = next((name for name, pattern in _GROUPS if pattern.search(before.rstrip("._ /"))), None)
            wanted = {"orientation": (4,), "angular_velocity": (3,), "linear_velocity": (2, 3), "position": (2, 3)}
            if channel is not None and len(fields) in wanted[channel]:
                yield Guess(channel, topic.name, fields)


def by_topic(result: Iterable[Guess]) -> dict[str, dict[str, Guess]]:
    """First guess for each channel, by topic."""
    sorted_out: dict[str, dict[str, Guess]] = {}
    for guess in result:
        sorted_out.setdefault(guess.topic, {}).setdefault(guess.channel, guess)
    return sorted_out
