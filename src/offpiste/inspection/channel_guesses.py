"""Candidate topics and fields for each channel, by names, units and types."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

from offpiste.core.channels import ACTUATORS, CONTROLS, all_actuators, all_controls
from offpiste.inspection.commanded_motion import is_asked_for, motion_commands
from offpiste.inspection.field_groups import are_quaternions, field_groups, fours
from offpiste.logs.log import Log, Topic
from offpiste.logs.transforms import STAMPED, frame_pair
from offpiste.rig.labels import (
    COMMANDED,
    COURSE_NAMES,
    PRESSURES,
    Label,
    channel_unit,
    field_labels,
    is_array_entry,
    is_beside_quantity,
    parse_label,
)

_ANGLE = r"(angle|ang(?!le))(?![ _]?(vel|rate|speed|acc|jerk))"
_TURN_RATE: Final = re.compile(r"ang(ular)?_?vel(ocity)?[/._]z$|yaw[_ ]?vel(ocity)?$")
"""Names of a scalar angular velocity about z, or of a yaw rate."""
_COMMANDED_JOINTS: Final = re.compile(r"cmd|com+and|desired|target|setpoint", re.IGNORECASE)
"""Topics of commanded joint states."""
MOTION: Final = 3
"""Rank of a commanded speed or turn rate, used as throttle or steering only as a fallback."""
MEASURED: Final = 2
"""Rank of a steering position: the measured angle next to a command, otherwise the steering itself."""
ACCELERATOR: Final = 9
"""Rank of fields called `accel`: a pedal or an acceleration, depending on the values."""
_SCALARS: tuple[tuple[str, int, str], ...] = (
    ("yaw_rate", 0, r"yaw_?rate|(^|[ ._/])w( \(imu\))?$|gyro_?z|(?<![a-z])(omega|gz|wz)$|(yaw|psi|theta)_?(dot|vel)$"),
    ("yaw_rate", 0, r"(gyro|rate)[_ ]yaw$"),
    ("yaw_rate", 0, _TURN_RATE.pattern),
    ("yaw", -1, r"(?<![a-z])head(ing)?_?veh(icle)?$"),
    ("yaw", 0, r"(?<![a-z])(yaw|heading|psi|hdg)$"),
    ("yaw", 1, r"(?<![a-z])(theta|azimuth|bearing|compass)$|(yaw|heading)_?(angle|true)$|compass_?bearing$"),
    ("yaw", 1, r"(?<![a-z])angle_yaw(?![a-z])"),
    ("yaw", 1, r"(euler|rpy|attitude).*[._/]z$|(yaw_?pitch_?roll|ypr).*[._/]x$"),
    ("yaw", 2, rf"(?<![a-z])(phi|{COURSE_NAMES})$"),
    ("brake_pressure", 0, r"(brake|brk).*press(ure)?(?!ed)|press(ure)?(?!ed).*(brake|brk)|(?<![a-z])p_?(brake|brk)"),
    (
        "steer_angle",
        0,
        rf"(steer(ing)?|(?<![a-z])(str|stg)_?whl).*{_ANGLE}|(?<![a-z])delta(_?f|_front)?(_(cmd|des|ref|target))?$",
    ),
    ("steer_angle", 0, rf"(road_?wheel|front_?wheel|(?<![a-z])front|tyre|tire)_?{_ANGLE}"),
    ("steer_angle", 1, rf"(^|[ ._/])wheel_?{_ANGLE}$"),
    ("throttle", 0, r"^pps$"),
    ("throttle", 1, r"(?<![a-z])tps(?![a-z])"),
    ("steer_angle", MEASURED, r"(?<![a-z])steer(ing)?_?(pos(ition)?|feedback|fb|act(ual)?|meas(ured)?)$"),
    ("steer_angle", MEASURED, r"(?<![a-z])(act(ual)?|meas(ured)?|current|feedback)_?steer(ing)?$"),
    ("steer", 0, r"(?<![a-z])hand(_?wheel|le_?bars?)(_?(angle|ang|pos(ition)?))?$"),
    ("steer", 1, r"(?<![a-z])servo([_/. ]?(cmd|com+and|input|value|pos(ition)?))?$"),
    ("throttle", 1, r"(?<![a-z])(motor|duty(_?cycle)?|pwm|esc)_?(cmd|com+and|input|value)$"),
    ("throttle", 1, r"(^|[ ./])motor$|(?<![a-z])(pwm|esc)$|(cmd|com+and).*(?<![a-z])duty(_?cycle)?$"),
    ("throttle", 2, r"(?<![a-z])accel(_?(rpt|cmd))?[._/]?_?(cmd|com+and|manual_input|input|output|pct|pos(ition)?)$"),
    ("throttle", 1, r"(?<![a-z])(effort|torque)_?(cmd|com+and|input|req(uest)?)$"),
    ("throttle", 1, r"(?<![a-z])apps(_?[\da-b])?(_(raw|adc|volts?|voltage))?$"),
    ("brake", 1, r"^bps(_?(\d|front|rear|f|r))?(_(raw|adc|volts?|voltage))?$"),
    ("steer", 1, r"(cmd|com+and(ed)?|desired|target|setpoint).*curvature|curvature.*(cmd|com+and|setpoint|target)"),
    (
        "gear",
        1,
        r"(gear_?shift|(?<![a-z])shift_?(rpt|cmd|report|feedback|state|pos(ition)?))([._/](output|command|state|gear))?$",
    ),
    ("gear", 1, r"(?<![a-z])(machine|vehicle|travel|driving|drive|motion)_?direction$"),
    ("throttle", 1, r"propulsive_linear_effort_x$"),
    ("brake", 1, r"resistive_linear_effort_x$"),
    ("steer", 1, r"propulsive_rotational_effort_z$"),
    ("throttle", ACCELERATOR, r"(^|[ ./])accel$"),
    ("throttle", MOTION + 1, r"(?<![a-z])duty(_?cycle)?$"),
    ("wheel_speed", 1, r"wheels?[ _]?(speed|vel)|(speed|vel)_?wheels?"),
    ("wheel_speed", 1, r"(^|[ ._/])v_ego$"),
    ("wheel_speed", 1, r"(^|[ ._/])speed \(\d+: (obd|can)\w*\)$"),
    ("wheel_speed", 2, r"(^|[ ._/])((vehicle|car|ego)_?)?speed$|(^|[ ._/])veh(icle)?_?spd$"),
)
"""Scalar channels: rank of the name and its pattern, best match first."""
_DESIRED: Final = re.compile(r"(?<![a-z])(des(ired)?|target|demand(ed)?|setpoint)(?![a-z])")
"""Names of a desired heading or rate, which is not a measurement, such as ArduPilot's `DesYaw`."""
_NEVER: Final = {
    "throttle": re.compile(r"steer|servo|brake|brk"),
    "brake": re.compile(r"temp|wear|fluid"),
    "steer_angle": re.compile(r"normali[sz]ed|(?<![a-z])norm(?![a-z])"),
    "yaw_rate": _DESIRED,
    "yaw": re.compile(rf"{_DESIRED.pattern}|brake|brk|press|tire|tyre|oil|boost|fuel|gyro|rate"),
    "wheel_speed": re.compile(
        r"(?<![a-z])(eng(?![a-z])|load|limit)|engine|motor|turbine|steer|fan|shaft|wind|gps|gnss|percent"
    ),
}
"""Names excluded for a channel, except for a throttle with its own name."""
_BESIDE: Final = re.compile(
    r"torque|rate|speed|(?<![a-z])vel(?![a-z])|press|current|force|effort|temp|engage|light|lamp|switch|bias|park|hand_?brake|on_off"
)
"""Names of other quantities measured at a pedal or the steering, used only as a fallback."""
_SET: Final = re.compile(r"(?<![a-z])(set|req(uest(ed)?)?|demand(ed)?)(?![a-z])")
_ACTUAL: Final = re.compile(r"(?<![a-z])(actual|measured|feedback|current)(?![a-z])")
"""Words for desired values, besides those of commands, and for measured values, whatever the topic."""
_DEVICES: Final = re.compile(r"(can|bus|ecu|plc|gps|gnss|imu)_?\d*$", re.IGNORECASE)
"""Namespaces of devices of which one vehicle may have several."""
_SELDOM: Final = 0.04
"""Maximum sample ratio of a slow copy to its channel."""
FALLBACK: Final = 10
"""First rank of fallback names."""


def _scalars() -> tuple[tuple[str, int, re.Pattern[str]], ...]:
    """Return the scalar channels and their field name patterns, registered ones first."""
    named = [(control.name, control.pattern, control in CONTROLS) for control in all_controls()]
    named += [(actuator.channel, actuator.pattern, actuator in ACTUATORS) for actuator in all_actuators()]
    own, more = (
        tuple((name, 0, pattern) for name, pattern, ships in named if pattern and ships is kind)
        for kind in (True, False)
    )
    return tuple((name, rank, re.compile(pattern, re.IGNORECASE)) for name, rank, pattern in (*more, *_SCALARS, *own))


_CONTROLS: Final = tuple(control.name for control in CONTROLS)
_NOT_SCALARS = re.compile(r"velocity|rate_of|status|enable|mode(?!l)|valid|stamp|count|jerk")
_NUMBER: Final = re.compile(r"(^|\.)(data|value)$")
"""Generic field names."""
_APPLIED: Final = re.compile(r"^output$")
"""Name of an actuator's applied value in reports of manual and automatic driving."""
_LAYOUTS: dict[str, tuple[tuple[str, tuple[str, ...]], ...]] = {
    "odometry.npy": (
        ("position", ("0", "1", "2")),
        ("orientation", ("3", "4", "5", "6")),
        ("linear_velocity", ("7", "8", "9")),
        ("angular_velocity", ("10", "11", "12")),
    ),
    "control.npy": (("brake", ("0",)), ("throttle", ("1",))),
    "px4_msgs/msg/VehicleOdometry": (
        ("position", ("position[0]", "position[1]", "position[2]")),
        ("orientation", ("q[1]", "q[2]", "q[3]", "q[0]")),
        ("linear_velocity", ("velocity[0]", "velocity[1]", "velocity[2]")),
        ("angular_velocity", ("angular_velocity[0]", "angular_velocity[1]", "angular_velocity[2]")),
    ),
}
"""Unnamed array entries by type, for TartanDrive files and messages."""
DOWN: Final = "px4_msgs/"
"""Types of messages with a north-east-down world and a forward-right-down body."""


@dataclass(frozen=True)
class Guess:
    """Candidate source of a channel.

    Attributes:
        unit: as stated by the log (`offpiste.rig.labels`), or "".
        rank: distance between the source's name and the channel's name; 0 is the best match.
        asked_for: True if the topic's type or name, or a field name, marks a command.
        in_hand: whether the angle appears to be a steering-wheel angle, judging from the motion.
    """

    channel: str
    topic: str
    fields: tuple[str, ...]
    unit: str = ""
    rank: int = 0
    asked_for: bool = False
    in_hand: bool = False


def _is_of_a_body(part: Topic) -> bool:
    """Return True for a part with a body transform; alternating senders are guessed from the whole topic."""
    pair = frame_pair(part.name)
    return part.type == STAMPED and pair is not None and pair.is_of_a_body


def guess_channels(log: Log) -> list[Guess]:
    """Return all guesses from names, units and types, in log order, best names first.

    The most frequent commanded motion is first: it is the one forwarded to the vehicle. A topic with a rate below
    `_SELDOM` of another one of its channel is last, as it is likely a monitor. Transforms are included if their frames
    are named like a body in a world.
    """
    topics = [one for one in log.topics.values() if not one.part_of or _is_of_a_body(one)]
    guesses = [guess for topic in topics if topic.count > 1 for guess in _of_topic(log, topic)]
    count = {name: topic.count for name, topic in log.topics.items()}
    most = {g.channel: max(count[other.topic] for other in guesses if other.channel == g.channel) for g in guesses}

    def order(guess: Guess) -> tuple[bool, int, int]:
        often = count[guess.topic]
        return often < _SELDOM * most[guess.channel], guess.rank, -often if guess.rank == MOTION else 0

    return sorted(guesses, key=order)


def labels(topic: Topic) -> dict[str, Label]:
    """Return name and unit of each field of a topic (`offpiste.rig.labels.field_labels`)."""
    return field_labels(topic.name, topic.fields, topic.units, topic.joints)


def _of_topic(log: Log, topic: Topic) -> Iterator[Guess]:
    if topic.type in _LAYOUTS:
        for channel, fields in _LAYOUTS[topic.type]:
            if set(fields) <= set(topic.fields):
                yield Guess(channel, topic.name, fields)
        return
    named = labels(topic)
    taken: set[str] = set()
    for channel, fields, unit in motion_commands(topic, named):
        yield Guess(channel, topic.name, fields, unit, MOTION)
        taken |= set(fields)
    for fields, of_the_vehicle in fours(named):
        if not taken & set(fields) and are_quaternions(log, topic.name, fields):
            if of_the_vehicle and not COMMANDED.search(topic.name):
                yield Guess("orientation", topic.name, fields)
            taken |= set(fields)
    for channel, fields, unit, rank in field_groups(topic, named):
        if not taken & set(fields) and channel_unit(channel, unit) is not None:
            yield Guess(channel, topic.name, fields, unit, rank)
            taken |= set(fields)
    scalars = _scalars()
    for field, label in sorted(named.items(), key=lambda item: not _APPLIED.search(item[0])):
        unnamed = is_array_entry(field) and field not in topic.joints
        own = label.name if _NUMBER.search(field) or field in topic.joints else parse_label(field).name
        other = _NOT_SCALARS.search(own) and not _TURN_RATE.search(label.name)
        if field in taken or unnamed or other or is_beside_quantity(own):
            continue
        for channel, rank, pattern in scalars:
            joint = field.startswith("position[") and field in topic.joints and not _COMMANDED_JOINTS.search(topic.name)
            if channel == "steer" and joint:
                channel, rank = "steer_angle", MEASURED  # joints are measured, in radians
            named_so = pattern.search(label.name) or pattern.search(label.name.replace(" ", "_"))
            if channel in _NEVER and (rank or channel != "throttle") and _NEVER[channel].search(label.name):
                continue
            turning = channel == "steer" and label.unit and channel_unit("steer_rate", label.unit) is not None
            if channel in _CONTROLS and (turning or _BESIDE.search(label.name)):
                rank += FALLBACK
            if channel == "brake" and label.unit in PRESSURES:
                channel = "brake_pressure"
            scalar = _guess(channel, topic, (field,), label, rank) if named_so else None
            if scalar is not None:
                yield scalar
                break


def _guess(channel: str, topic: Topic, fields: tuple[str, ...], label: Label, rank: int = 0) -> Guess | None:
    """Return a guess unless the unit contradicts it; pedals, steering and pressures may have any unit."""
    in_any = {"brake_pressure", *(control.name for control in all_controls())}
    if channel_unit(channel, label.unit) is None and channel not in in_any:
        return None
    asked = is_asked_for(topic, fields) or _SET.search(label.name) is not None
    measured = any(_ACTUAL.search(parse_label(field).name) for field in fields)
    return Guess(channel, topic.name, fields, label.unit, rank, asked and not measured)


def by_topic(result: Iterable[Guess]) -> dict[str, dict[str, Guess]]:
    """Return the first guess for each channel, by topic."""
    sorted_out: dict[str, dict[str, Guess]] = {}
    for guess in result:
        sorted_out.setdefault(guess.topic, {}).setdefault(guess.channel, guess)
    return sorted_out


def of_one_vehicle(guesses: Iterable[Guess], pose: str) -> list[Guess]:
    """Drop guesses of other vehicles for channels that the pose's own vehicle has, too.

    Args:
        pose: topic of the pose: `/robot2/odom` drops the throttle of `/robot1/pedals` if `/robot2/pedals` has one.
    """
    guesses = list(guesses)
    here = {(guess.topic, guess.channel) for guess in guesses}
    return [
        guess
        for guess in guesses
        if (names := _namespaces(guess.topic, pose)) is None or (names[2], guess.channel) not in here
    ]


def other_vehicle(topic: str, pose: str) -> tuple[str, str] | None:
    """Return the namespaces of a topic and the pose if they belong to two vehicles, i.e. differ in a number."""
    names = _namespaces(topic, pose)
    if names is None or re.sub(r"\d+", "", names[0]) != re.sub(r"\d+", "", names[1]) or _DEVICES.search(names[0]):
        return None
    return names[:2]


def _namespaces(topic: str, pose: str) -> tuple[str, str, str] | None:
    """Return the namespaces of two topics up to their difference and the first topic renamed to the second, or None."""
    parts, others = topic.split("/"), pose.split("/")
    differ = next((k for k, (a, b) in enumerate(zip(parts[:-1], others[:-1], strict=False)) if a != b), None)
    if differ is None:
        return None
    own, other = "/".join(parts[: differ + 1]), "/".join(others[: differ + 1])
    return own, other, "/".join((other, *parts[differ + 1 :]))
