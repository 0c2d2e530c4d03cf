"""Candidate topics and fields for each channel, by names, units and types; unnamed quaternions by their values."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.core.channels import ACTUATORS, CONTROLS, all_actuators, all_controls
from offpiste.core.errors import OffpisteError
from offpiste.core.geometry import rotation_from_quaternion
from offpiste.inspection.commanded_motion import is_commanded, motion_commands
from offpiste.logs.channel import brought_together
from offpiste.logs.log import Log, Topic
from offpiste.logs.transforms import frame_pair
from offpiste.rig.channels import GEOGRAPHIC
from offpiste.rig.labels import (
    PATTERNS,
    PRESSURES,
    VOCABULARY,
    Label,
    channel_unit,
    field_labels,
    is_array_entry,
    is_beside_quantity,
    is_named,
    parse_label,
    with_letters,
)

MEASURED: Final = 2
"""Rank of a steering position: the measured angle next to a command, otherwise the steering itself."""
MOTION: Final = 3
"""Rank of a commanded speed or turn rate, used as throttle or steering only as a fallback."""
ACCELERATOR: Final = 9
"""Rank of fields called `accel`: a pedal or an acceleration, depending on the values."""
FALLBACK: Final = 10
"""First rank of fallback names."""
_SIDES: Final = {"left": "right", "right": "left"}
"""Vehicle sides with separate commands per wheel or track."""
_SELDOM: Final = 0.04
"""Maximum sample ratio of a slow copy to its channel."""
_UNIT, _MOST = 0.02, 0.95
"""Maximum deviation of a quaternion's norm from 1, and minimum share of such rows."""
_SCALARS: Final = tuple((channel, rank, re.compile(names)) for channel, rank, names in VOCABULARY["draft"]["scalars"])
_NEVER: Final = {channel: re.compile(names) for channel, names in VOCABULARY["draft"]["never"].items()}
_CORNERS: Final = {corner: re.compile(names) for corner, names in VOCABULARY["draft"]["corners"].items()}


@dataclass(frozen=True)
class Guess:
    """Candidate source of a channel.

    Attributes:
        unit: as stated by the log (`offpiste.rig.labels`), or "".
        rank: distance between the source's name and the channel's name; 0 is the best match.
        is_command: True if the topic's type or name, or a field name, marks a command.
        is_handwheel: whether the angle appears to be a steering-wheel angle, judging from the motion.
        why: reason of the guess.
    """

    channel: str
    topic: str
    fields: tuple[str, ...]
    unit: str = ""
    rank: int = 0
    is_command: bool = False
    is_handwheel: bool = False
    why: str = "by its name"


@dataclass(frozen=True)
class _Vector:
    """Row of the vocabulary: a kind of vector."""

    names: str
    channel: str
    sizes: Sequence[int]
    take: Sequence[int] = ()
    unit: str = ""
    rank: int = 0
    arrays: bool = False

    def group(self, fields: tuple[str, ...], unit: str, rank: int = 0) -> "_Group":
        taken = tuple(fields[index] for index in self.take) or fields
        return self.channel, taken, self.unit or unit, rank or self.rank


_Group = tuple[str, tuple[str, ...], str, int]
"""A channel, its candidate fields, their unit, and the rank of their names (0 is best)."""
_VECTORS: Final = tuple(_Vector(**row) for row in VOCABULARY["draft"]["vectors"])


def guess_channels(log: Log, namespace: str = "") -> list[Guess]:
    """Return all guesses from names, units and types, in log order, best names first.

    The most frequent commanded motion is first: it is the one forwarded to the vehicle. A topic with a rate below
    `_SELDOM` of another one of its channel is last, as it is likely a monitor. Transforms are included if their frames
    are named like a body in a world.

    Args:
        namespace: of the vehicle, if the log holds several, e.g. `/robot1`; other topics and transforms are left out.
    """
    part = f"/{namespace.strip('/')}/" if namespace else ""
    topics = [topic for topic in log.topics.values() if part in f"/{topic.name}/".replace(" ", "/")]
    topics = [topic for topic in topics if topic.count > 1 and (not topic.part_of or _is_of_a_body(topic))]
    guesses = [guess for topic in topics for guess in _of_topic(log, topic)]
    count = {name: topic.count for name, topic in log.topics.items()}
    most: dict[str, int] = {}
    for guess in guesses:
        most[guess.channel] = max(most.get(guess.channel, 0), count[guess.topic])

    def order(guess: Guess) -> tuple[bool, int, int]:
        often = count[guess.topic]
        return often < _SELDOM * most[guess.channel], guess.rank, -often if guess.rank == MOTION else 0

    return sorted(guesses, key=order)


def by_topic(guesses: Iterable[Guess]) -> dict[str, dict[str, Guess]]:
    """Return the first guess for each channel, by topic."""
    first: dict[str, dict[str, Guess]] = {}
    for guess in guesses:
        first.setdefault(guess.topic, {}).setdefault(guess.channel, guess)
    return first


def labels(topic: Topic) -> dict[str, Label]:
    """Return name and unit of each field of a topic (`offpiste.rig.labels.field_labels`)."""
    return field_labels(topic.name, topic.fields, topic.units, topic.joints)


def field_values(log: Log, guess: Guess) -> Float[np.ndarray, "n k"] | None:
    """Return the finite rows of a guess's fields, or None if they cannot be read."""
    try:
        samples = log.read(guess.topic, guess.fields)
    except OffpisteError:
        return None
    values = brought_together(samples.time, samples.values)
    values = values[np.isfinite(values).all(axis=1)]
    return values if len(values) > 1 else None


def is_measured_topic(topic: Topic) -> bool:
    """Return True if a topic's name or type marks a measurement; for tables, the columns decide.

    Topics named as commands are excluded, such as TartanDrive's `cmd/twist.npy`, unless they command a motion.
    """
    if is_named("commanded", topic.name) and not is_named("of_motion", *topic.fields):
        return False
    return bool(topic.name) and is_named("measured_topics", f"{topic.name} {topic.type}")


def of_one_side(topic: Topic, log: Log) -> list[str]:
    """Return fields of one vehicle side that have a counterpart on the other side, by field names or the topic's."""
    fields = [field for field in topic.fields if _other_side(field) in topic.fields]
    return fields or (list(topic.fields) if _other_side(topic.name) in log.topics else [])


def _other_side(name: str) -> str | None:
    """Return the name of the opposite side's counterpart; None if it names no side."""
    other = PATTERNS["sides"].sub(lambda side: _SIDES[side[0].lower()], name)
    return None if other == name else other


def _is_of_a_body(part: Topic) -> bool:
    """Return True for a transform of a body."""
    pair = frame_pair(part.name)
    return pair is not None and pair.is_of_a_body


def _of_topic(log: Log, topic: Topic) -> Iterator[Guess]:
    """Yield the guesses of a topic; each field is used once, by the most reliable of them."""
    named = labels(topic)
    commands = motion_commands(topic, named)
    motion = [Guess(channel, topic.name, fields, unit, MOTION) for channel, fields, unit in commands]
    yield from motion
    taken = {field for guess in motion for field in guess.fields}
    groups = _layouts(topic, named), _vectors(log, topic, named), _arrays(topic), _places(named), _wheels(topic, named)
    for channel, fields, unit, rank in chain(*groups):
        if taken & set(fields) or (channel and channel_unit(channel, unit) is None):
            continue
        taken |= set(fields)
        if channel:
            yield Guess(channel, topic.name, fields, unit, rank)
    yield from _scalars(topic, {field: label for field, label in named.items() if field not in taken})


def _layouts(topic: Topic, named: Mapping[str, Label]) -> Iterator[_Group]:
    """Yield fields whose names have a meaning only together, or in messages of one type."""
    columns = {label.name: field for field, label in named.items()} | {field: field for field in named}
    for layout in VOCABULARY["draft"]["layouts"]:
        channels = {channel: names for channel, names in layout.items() if channel != "type"}
        in_type = layout.get("type", topic.type) == topic.type
        if in_type and {name for names in channels.values() for name in names} <= set(columns):
            for channel, names in channels.items():
                fields = tuple(columns[name] for name in names)
                yield channel, fields, named[fields[0]].unit, 0
            return


def _vectors(log: Log, topic: Topic, named: Mapping[str, Label]) -> Iterator[_Group]:
    """Yield fields that differ in one letter: x, y, z or w.

    Four fields of norm 1 are a quaternion under any name; one of a reference or an error is of no channel ("").
    """
    for before, after, found in _letters(named):
        vector, name = _vector(before, after), f"{before}x{after}"
        four = tuple(found.values())
        if (
            len(four) == 4
            and (vector is None or vector.channel != "orientation")
            and _are_quaternions(log, topic, four)
        ):
            of_the_vehicle = not (is_named("not_vectors", name) or is_named("commanded", topic.name))
            yield "orientation" if of_the_vehicle else "", four, "", 0
            continue
        if vector is None or vector.arrays:
            continue
        fields = tuple(found[letter] for letter in "xyzw"[: max(vector.sizes)] if letter in found)
        if vector.channel == "position":
            fields = _one_place(fields, named)
        if len(fields) in vector.sizes:
            torques = vector.channel == "position" and is_named("translation", before)
            yield vector.group(fields, named[fields[0]].unit, 2 if torques else 0)


def _letters(named: Mapping[str, Label]) -> Iterator[tuple[str, str, dict[str, str]]]:
    """Yield the parts of a name before and behind its letter, and the fields of each letter."""
    plain = {label.name: field for field, label in reversed(list(named.items()))}
    columns = {with_letters(name): field for name, field in plain.items()} | plain
    for name in dict.fromkeys(with_letters(label.name) for label in named.values()):
        for match in PATTERNS["letter"].finditer(name):
            before, after = name[: match.end() - 1], name[match.end() :]
            yield before, after, {a: columns[n] for a in "xyzw" if (n := f"{before}{a}{after}") in columns}


def _vector(before: str, after: str) -> _Vector | None:
    """Return the kind of a vector by the part of its name before the letter, or behind it if there is none before."""
    if is_named("not_vectors", f"{before}x{after}"):
        return None
    words, behind = (text.strip("._ /") for text in (before, after))
    words = PATTERNS["frames"].sub(r"\1", words)
    if not words and behind:
        *vectors, position = _VECTORS
        return next((vector for vector in vectors if re.search(vector.names, behind)), position)
    return next((vector for vector in _VECTORS if re.search(vector.names, words)), None)


def _one_place(fields: tuple[str, ...], named: Mapping[str, Label]) -> tuple[str, ...]:
    """Return the fields of a position with its height under another name, in one unit, and down only with north."""
    if len(fields) == 2:
        fields += tuple(f for f, label in named.items() if PATTERNS["height_beside"].fullmatch(label.name))[:1]
    if len(fields) == 3 and (named[fields[2]].unit or "m") != (named[fields[0]].unit or "m"):
        fields = fields[:2]  # a channel has one unit: east and north may be in m, the height in ft
    down = PATTERNS["east"].sub(lambda east: "down" if east[0] == "east" else "d", name := named[fields[0]].name)
    if len(fields) == 2 and down != name and (third := next((f for f in named if named[f].name == down), "")):
        return fields[1], fields[0], third
    return fields


def _arrays(topic: Topic) -> Iterator[_Group]:
    """Yield arrays with as many entries as a vector, counted from 0 or 1: `q[0]` to `q[3]`, `vel_1` to `vel_3`."""
    arrays: dict[str, dict[int, str]] = {}
    for field in topic.fields:
        if not topic.joints and (match := PATTERNS["numbered"].match(field)):
            arrays.setdefault(match[1], {})[int(match[2] or match[3] or match[4])] = field
    for name, entries in arrays.items():
        label, first = parse_label(name), min(entries)
        vector = _vector(label.name, "")
        counted = first in (0, 1) and set(entries) == set(range(first, first + len(entries)))
        if is_named("other_parts", topic.name, topic.type, label.name) or not counted or vector is None:
            continue
        if len(entries) in vector.sizes:
            fields = tuple(entries[number] for number in sorted(entries))
            yield vector.group(fields, topic.units.get(fields[0], "") or label.unit)


def _places(named: Mapping[str, Label]) -> Iterator[_Group]:
    """Yield geographic positions, e.g. of sensor_msgs/NavSatFix."""
    found = []
    for kind, units in (("latitude", ("", "deg", "rad")), ("longitude", ("", "deg", "rad")), ("height", ("", "m"))):
        of_unit = ((field, label.name) for field, label in named.items() if label.unit in units)
        found.append(next((f for f, name in of_unit if is_named(kind, name) and not is_named("lateral", name)), ""))
    if found[0] and found[1]:
        yield "position", tuple(filter(None, found)), GEOGRAPHIC, 1


def _wheels(topic: Topic, named: Mapping[str, Label]) -> Iterator[_Group]:
    """Yield speeds of four wheels; if in rad/s, as for joints, the motion determines the wheel radius."""
    columns: dict[str, str] = {}
    for field, label in named.items():
        speed = "wheel_joint" if field in topic.joints else "wheel_speed"
        if is_named(speed, label.name) and not is_named("not_wheel_speed", label.name):
            corner = next((corner for corner, names in _CORNERS.items() if names.search(label.name)), "")
            columns.setdefault(corner, field)
    if set(_CORNERS) <= set(columns):
        fields = tuple(columns[corner] for corner in _CORNERS)
        yield "wheel_speed", fields, named[fields[0]].unit, 0


def _are_quaternions(log: Log, topic: Topic, fields: tuple[str, ...]) -> bool:
    """Return True if nearly all rows of four fields have norm 1."""
    rows = field_values(log, Guess("orientation", topic.name, fields))
    return rows is not None and bool(np.mean(np.abs(np.linalg.norm(rows, axis=1) - 1) < _UNIT) > _MOST)


def w_comes_first(fields: tuple[str, ...], values: Float[np.ndarray, "n 4"]) -> bool:
    """Return True if unnamed quaternion entries are in w x y z order, which keeps the vehicle upright."""
    if any(re.search(r"[xyzw]$", field, re.IGNORECASE) for field in fields):
        return False
    turned = (rotation_from_quaternion(rows)[:, 2, 2] for rows in (values, np.roll(values, -1, axis=1)))
    as_stored, w_first = (float(np.mean(up)) for up in turned)
    return w_first > as_stored


def _scalars(topic: Topic, named: Mapping[str, Label]) -> Iterator[Guess]:
    """Yield the fields named like a scalar channel, applied values of actuators first."""
    for field, label in sorted(named.items(), key=lambda item: not is_named("applied", item[0])):
        joint = field in topic.joints
        own = label.name if joint or is_named("generic", field) else parse_label(field).name
        is_quantity = not is_beside_quantity(own) and (joint or not is_array_entry(field))
        if is_quantity and (is_named("turn_rate", label.name) or not is_named("not_scalars", own)):
            yield from _first_match(topic, field, label)


def _first_match(topic: Topic, field: str, label: Label) -> Iterator[Guess]:
    """Yield the first channel whose names match a field, unless the unit contradicts it."""
    measured_joint = field in topic.joints and field.startswith("position[")
    measured_joint &= not is_named("commanded_joints", topic.name)
    in_any_unit = {"brake_pressure", *(control.name for control in all_controls())}
    for channel, rank, pattern in _all_scalars():
        if not (pattern.search(label.name) or pattern.search(label.name.replace(" ", "_"))):
            continue
        if channel == "steer" and measured_joint:
            channel, rank = "steer_angle", MEASURED
        if channel in _NEVER and (rank or channel != "throttle") and _NEVER[channel].search(label.name):
            continue
        turning = channel == "steer" and label.unit and channel_unit("steer_rate", label.unit) is not None
        if channel in ("throttle", "brake", "steer") and (turning or is_named("beside", label.name)):
            rank += FALLBACK
        if channel == "brake" and label.unit in PRESSURES:
            channel = "brake_pressure"
        if channel in in_any_unit or channel_unit(channel, label.unit) is not None:
            asked = is_commanded(topic, (field,)) or is_named("set", label.name)
            asked = asked and not is_named("actual", parse_label(field).name)
            yield Guess(channel, topic.name, (field,), label.unit, rank, asked)
            return


def _all_scalars() -> tuple[tuple[str, int, re.Pattern[str]], ...]:
    """Return scalar channels with rank and pattern of their names: registered ones, the vocabulary, built-in ones."""
    declared = [(control.name, control.pattern, control in CONTROLS) for control in all_controls()]
    declared += [(actuator.channel, actuator.pattern, actuator in ACTUATORS) for actuator in all_actuators()]
    registered, ours = (
        [(name, 0, re.compile(names, re.IGNORECASE)) for name, names, ships in declared if names and ships == built_in]
        for built_in in (False, True)
    )
    return (*registered, *_SCALARS, *ours)
