"""Candidate topics and fields for each channel, by names, units and types."""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from offpiste.core.channels import ACTUATORS, CONTROLS, all_actuators, all_controls
from offpiste.inspection.commanded_motion import is_commanded, motion_commands
from offpiste.inspection.field_groups import are_quaternions, field_groups, fours
from offpiste.logs.log import Log, Topic
from offpiste.logs.transforms import frame_pair
from offpiste.rig.labels import (
    PRESSURES,
    VOCABULARY,
    Label,
    channel_unit,
    field_labels,
    is_array_entry,
    is_beside_quantity,
    is_named,
    parse_label,
)

MEASURED: Final = 2
"""Rank of a steering position: the measured angle next to a command, otherwise the steering itself."""
MOTION: Final = 3
"""Rank of a commanded speed or turn rate, used as throttle or steering only as a fallback."""
ACCELERATOR: Final = 9
"""Rank of fields called `accel`: a pedal or an acceleration, depending on the values."""
FALLBACK: Final = 10
"""First rank of fallback names."""
_SELDOM: Final = 0.04
"""Maximum sample ratio of a slow copy to its channel."""
_SCALARS: Final = tuple((channel, rank, re.compile(names)) for channel, rank, names in VOCABULARY["draft"]["scalars"])
_NEVER: Final = {channel: re.compile(names) for channel, names in VOCABULARY["draft"]["never"].items()}


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


def _is_of_a_body(part: Topic) -> bool:
    """Return True for a transform of a body."""
    pair = frame_pair(part.name)
    return pair is not None and pair.is_of_a_body


def labels(topic: Topic) -> dict[str, Label]:
    """Return name and unit of each field of a topic (`offpiste.rig.labels.field_labels`)."""
    return field_labels(topic.name, topic.fields, topic.units, topic.joints)


def _of_topic(log: Log, topic: Topic) -> Iterator[Guess]:
    """Yield the guesses of a topic; each field is used once, by the most reliable of them."""
    if (layout := VOCABULARY["draft"]["layouts"].get(topic.type)) is not None:
        known = {channel: tuple(fields) for channel, fields in layout.items() if set(fields) <= set(topic.fields)}
        yield from (Guess(channel, topic.name, fields) for channel, fields in known.items())
        return
    named = labels(topic)
    motion = [
        Guess(channel, topic.name, fields, unit, MOTION) for channel, fields, unit in motion_commands(topic, named)
    ]
    yield from motion
    taken = {field for guess in motion for field in guess.fields}
    for fields, of_the_vehicle in fours(named):
        if not taken & set(fields) and are_quaternions(log, topic.name, fields):
            if of_the_vehicle and not is_named("commanded", topic.name):
                yield Guess("orientation", topic.name, fields)
            taken |= set(fields)
    for channel, fields, unit, rank in field_groups(topic, named):
        if not taken & set(fields) and channel_unit(channel, unit) is not None:
            yield Guess(channel, topic.name, fields, unit, rank)
            taken |= set(fields)
    yield from _scalars(topic, {field: label for field, label in named.items() if field not in taken})


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


def _all_scalars() -> Iterator[tuple[str, int, re.Pattern[str]]]:
    """Yield scalar channels with rank and pattern of their names: registered ones, the vocabulary, built-in ones."""
    controls = [(control.name, control.pattern, control in CONTROLS) for control in all_controls()]
    actuators = [(actuator.channel, actuator.pattern, actuator in ACTUATORS) for actuator in all_actuators()]
    named = [
        (ships, (name, 0, re.compile(names, re.IGNORECASE))) for name, names, ships in controls + actuators if names
    ]
    yield from (row for ships, row in named if not ships)
    yield from _SCALARS
    yield from (row for ships, row in named if ships)


def by_topic(result: Iterable[Guess]) -> dict[str, dict[str, Guess]]:
    """Return the first guess for each channel, by topic."""
    sorted_out: dict[str, dict[str, Guess]] = {}
    for guess in result:
        sorted_out.setdefault(guess.topic, {}).setdefault(guess.channel, guess)
    return sorted_out
