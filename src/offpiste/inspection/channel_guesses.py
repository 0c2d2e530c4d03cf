"""Guesses which topics and fields may feed which channel, by their names, units and types."""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from offpiste.channels import ACTUATORS, CONTROLS, all_actuators, all_controls
from offpiste.inspection.commanded_motion import motion_commands
from offpiste.logs.log import Log, Topic
from offpiste.rig.channels import GEOGRAPHIC
from offpiste.rig.labels import (
    GEOGRAPHIC_NAMES,
    Label,
    channel_unit,
    field_labels,
    is_array_entry,
    parse_label,
    with_letters,
)

_AXIS = re.compile(r"(?<![a-z])([pqvwg]?)x(?![a-z])")
_PLACES = (
    "utm|enu|local|global|world|map|gps|gnss|ego|car|veh|vehicle|odom|rtk|slam|base|robot|center|cog|pos|gt|ground_?truth"
    "|ekf|est|state|cg|rear_?axle|loc(ation)?|coord(inate)?s?"
)
_GROUPS: tuple[tuple[str, re.Pattern[str], str], ...] = (
    ("orientation", re.compile(r"orient|quat|rot|(^|[^a-z])q$"), "yzw"),
    ("angular_velocity", re.compile(r"angular|gyro|omega|(^|[^a-z])[wg]$"), "yz"),
    ("linear_velocity", re.compile(r"linear_?vel|twist[._/]linear|vel|(^|[^a-z])v$"), "yz"),
    ("position", re.compile(rf"pos|vicon|mocap|optitrack|translation|(^|[^a-z])p?$|(?<![a-z])({_PLACES})$"), "yz"),
)
"""Vectors, by what stands before the letter x, and the other letters."""
_WIDTHS: Final = {"orientation": (4,), "angular_velocity": (3,), "linear_velocity": (2, 3), "position": (2, 3)}
_NOT_GROUPS = re.compile(
    r"acc|magn|gravity|force|effort|imu.*orient|ll[ah](?![a-z])"
    r"|(?<![a-z])(mag|err|error|ref|des|desired|target|goal|setpoint|waypoint|cov|covariance|std|stdev|sd|sigma)(?![a-z])"
)

_TOGETHER: Final[tuple[tuple[frozenset[str], tuple[tuple[str, tuple[str, ...]], ...]], ...]] = (
    (frozenset("uvwpqr"), (("linear_velocity", ("u", "v", "w")), ("angular_velocity", ("p", "q", "r")))),
    (frozenset("uvr"), (("linear_velocity", ("u", "v")), ("yaw_rate", ("r",)))),
)
"""Names too short to mean anything alone; together they are of one notation (SNAME's, of marine vehicles)."""

_ANGLE = r"(angle|ang)"
_TURN_RATE: Final = re.compile(r"ang(ular)?_?vel(ocity)?[/._]z$")
"""The z component alone of an angular velocity."""
_COMMANDED_JOINTS: Final = re.compile(r"cmd|com+and|desired|target|setpoint", re.IGNORECASE)
"""Topics of joint states that are commanded, not measured."""
MOTION: Final = 3
"""Rank of a commanded speed or turn rate, which stands for the throttle or the steering where nothing else does."""
MEASURED: Final = 2
"""Rank of a steering's position, which beside its command is the measured angle, and without one the steering."""
_SCALARS: tuple[tuple[str, int, str], ...] = (
    ("yaw_rate", 0, r"yaw_?rate|(^|[ ._/])w( \(imu\))?$|gyro_?z|(?<![a-z])(omega|gz|wz)$|(yaw|psi|theta)_?(dot|vel)$"),
    ("yaw_rate", 0, r"(gyro|rate)[_ ]yaw$"),
    ("yaw_rate", 0, _TURN_RATE.pattern),
    ("yaw", 0, r"(?<![a-z])(yaw|heading|psi|hdg)$"),
    ("yaw", 1, r"(?<![a-z])(theta|azimuth|bearing)$|(yaw|heading)_?(angle|true)$|compass_?bearing$"),
    ("yaw", 1, r"(euler|rpy|attitude).*[._/]z$|(yaw_?pitch_?roll|ypr).*[._/]x$"),
    ("yaw", 2, r"(?<![a-z])(phi|track|trk_gnd|course(_over_ground)?|cog)$"),
    ("brake_pressure", 0, r"(brake|brk).*press(ure)?(?!ed)|press(ure)?(?!ed).*(brake|brk)|(?<![a-z])p_?(brake|brk)"),
    ("steer_angle", 0, rf"steer(ing)?.*{_ANGLE}|(?<![a-z])delta(_?f|_front)?(_(cmd|des|ref|target))?$"),
    ("steer_angle", 0, rf"(road_?wheel|front_?wheel|(?<![a-z])front|tyre|tire)_?{_ANGLE}"),
    ("steer_angle", 1, rf"(^|[ ._/])wheel_?{_ANGLE}$"),
    ("throttle", 1, r"(?<![a-z])tps(?![a-z])"),
    ("steer_angle", MEASURED, r"(?<![a-z])steer(ing)?_?(pos(ition)?|feedback|fb|act(ual)?|meas(ured)?)$"),
    ("steer", 0, r"(?<![a-z])hand_?wheel(_?(angle|ang|pos(ition)?))?$"),
    ("steer", 1, r"(?<![a-z])servo([_/. ]?(cmd|com+and|input|value|pos(ition)?))?$"),
    ("throttle", 1, r"(?<![a-z])(motor|duty(_?cycle)?|pwm|esc)_?(cmd|com+and|input|value)$"),
    ("throttle", 1, r"(^|[ ./])motor$|(?<![a-z])(pwm|esc)$|(cmd|com+and).*(?<![a-z])duty(_?cycle)?$"),
    ("throttle", 2, r"(?<![a-z])accel(_?rpt)?[._/]?_?(cmd|com+and|manual_input|input|output|pct|pos(ition)?)$"),
    ("throttle", 1, r"(?<![a-z])(effort|torque)_?(cmd|com+and|input)$"),
    ("throttle", MOTION + 1, r"(?<![a-z])duty(_?cycle)?$"),
    ("wheel_speed", 1, r"wheels?[ _]?(speed|vel)|(speed|vel)_?wheels?"),
    ("wheel_speed", 2, r"(^|[ ._/])((vehicle|car|ego)_?)?speed$"),
)
"""Channels of one number: how far the name is from the channel's own, and its pattern. Nearer ones come first."""
_NEVER: Final = {
    "throttle": re.compile(r"steer|servo|brake|brk"),
    "yaw": re.compile(r"brake|brk|press|tire|tyre|oil|boost|fuel|gyro|rate"),
    "wheel_speed": re.compile(r"engine|motor|turbine|steer|fan|shaft|wind"),
}
"""What a channel is not called; a throttle that has a name of its own may be."""
_BESIDE: Final = re.compile(
    r"torque|rate|speed|press|current|force|effort|temp|engage|light|lamp|switch|bias|park|hand_?brake|on_off"
)
"""What is measured at a pedal or a steering, besides where it is; a channel only where nothing else is."""
FALLBACK: Final = 10
"""Ranks from here on are those of such names."""


def _scalars() -> tuple[tuple[str, int, re.Pattern[str]], ...]:
    """Channels of one number, with the names of fields that may hold them; registered ones are tried first."""
    named = [(control.name, control.pattern, control in CONTROLS) for control in all_controls()]
    named += [(actuator.channel, actuator.pattern, actuator in ACTUATORS) for actuator in all_actuators()]
    own, more = (
        tuple((name, 0, pattern) for name, pattern, ships in named if pattern and ships is kind)
        for kind in (True, False)
    )
    return tuple((name, rank, re.compile(pattern, re.IGNORECASE)) for name, rank, pattern in (*more, *_SCALARS, *own))


_CONTROLS: Final = tuple(control.name for control in CONTROLS)
_NOT_SCALARS = re.compile(r"velocity|rate_of|status|enable|mode|valid|stamp|count|jerk")
_NUMBER: Final = re.compile(r"(^|\.)(data|value)$")
"""Fields that are called as any number is."""
_APPLIED: Final = re.compile(r"^output$")
"""What an actuator was given, by a driver or by commands, of reports that have either, too."""
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
"""Arrays whose entries have no names, by type: of TartanDrive's files, and of messages."""
DOWN: Final = "px4_msgs/"
"""Types of messages whose world is north, east, down, and whose body is forward, right, down."""


@dataclass(frozen=True)
class Guess:
    """A channel and where it may come from.

    Attributes:
        unit: that the log states (`offpiste.rig.labels`); "" where it states none.
        rank: how far the name is from the channel's own; 0 is nearest.
    """

    channel: str
    topic: str
    fields: tuple[str, ...]
    unit: str = ""
    rank: int = 0


def guess_channels(log: Log) -> list[Guess]:
    """All guesses that names, units and types suggest, in the log's order, the nearest names first.

    Of commanded motions the one that comes most often is first: others ask, and one is passed on to the vehicle.
    """
    guesses = [guess for topic in log.topics.values() if topic.count > 1 for guess in _of_topic(topic)]
    return sorted(guesses, key=lambda g: (g.rank, -log.topics[g.topic].count if g.rank == MOTION else 0))


def labels(topic: Topic) -> dict[str, Label]:
    """Name and unit of each field of a topic (`offpiste.rig.labels.field_labels`)."""
    return field_labels(topic.name, topic.fields, topic.units, topic.joints)


def _of_topic(topic: Topic) -> Iterator[Guess]:
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
    for guess in (*_together(topic, named), *_vectors(topic, named), *_places(topic, named), *_wheels(topic, named)):
        if not taken & set(guess.fields):
            yield guess
            taken |= set(guess.fields)
    scalars = _scalars()
    for field, label in sorted(named.items(), key=lambda item: not _APPLIED.search(item[0])):
        unnamed = is_array_entry(field) and field not in topic.joints
        own = label.name if _NUMBER.search(field) or field in topic.joints else parse_label(field).name
        other = _NOT_SCALARS.search(own) and not _TURN_RATE.search(label.name)
        if field in taken or unnamed or other:
            continue
        for channel, rank, pattern in scalars:
            joint = field.startswith("position[") and field in topic.joints and not _COMMANDED_JOINTS.search(topic.name)
            if channel == "steer" and joint:
                channel, rank = "steer_angle", MEASURED  # joints are measured, in radians
            named_so = pattern.search(label.name) or pattern.search(label.name.replace(" ", "_"))
            if channel in _NEVER and (rank or channel != "throttle") and _NEVER[channel].search(label.name):
                continue
            if channel in _CONTROLS and _BESIDE.search(label.name):
                rank += FALLBACK
            scalar = _guess(channel, topic, (field,), label, rank) if named_so else None
            if scalar is not None:
                yield scalar
                break


def _guess(channel: str, topic: Topic, fields: tuple[str, ...], label: Label, rank: int = 0) -> Guess | None:
    """A guess, unless the unit measures something else; pedals, steering and pressures may be recorded in any."""
    in_any = {"brake_pressure", *(control.name for control in all_controls())}
    if channel_unit(channel, label.unit) is None and channel not in in_any:
        return None
    return Guess(channel, topic.name, fields, label.unit, rank)


def _together(topic: Topic, named: Mapping[str, Label]) -> Iterator[Guess]:
    columns = {label.name: field for field, label in named.items()}
    for letters, channels in _TOGETHER:
        if letters <= set(columns):
            for channel, names in channels:
                fields = tuple(columns[name] for name in names)
                if (guess := _guess(channel, topic, fields, named[fields[0]])) is not None:
                    yield guess
            return


def _vectors(topic: Topic, named: Mapping[str, Label]) -> Iterator[Guess]:
    """Guesses at vectors: fields that differ in one letter, x, y, z or w."""
    plain = {label.name: field for field, label in reversed(list(named.items()))}
    columns = {with_letters(name): field for name, field in plain.items()} | plain
    for name in dict.fromkeys(with_letters(label.name) for label in named.values()):
        for match in _AXIS.finditer(name):
            if _NOT_GROUPS.search(name):
                continue
            before, after = name[: match.end() - 1], name[match.end() :]
            group = next((g for g in _GROUPS if g[1].search(before.rstrip("._ /"))), None)
            if group is None:
                continue
            channel, _, letters = group
            fields = (columns[name], *(columns[n] for a in letters if (n := before + a + after) in columns))
            if channel == "position" and len(fields) == 2:
                fields += tuple(field for field, label in named.items() if _HEIGHT.fullmatch(label.name))[:1]
            guess = _guess(channel, topic, fields, named[fields[0]])
            if guess is not None and len(fields) in _WIDTHS[channel]:
                yield guess


_HEIGHT: Final = re.compile(r"((utm|gps|gnss|pos|position)_)?(z|alt|altitude|elevation|height)")
"""What the height of a place is called whose east and north are called otherwise."""
_LATERAL: Final = re.compile(r"acc|force|vel|speed|(^|[ ._/])[av]_")
"""What is lateral or longitudinal, and no latitude or longitude."""


def _places(topic: Topic, named: Mapping[str, Label]) -> Iterator[Guess]:
    """A guess at geographic positions, as of sensor_msgs/NavSatFix."""
    places = {field: label for field, label in named.items() if not _LATERAL.search(label.name)}
    degrees = {field: label for field, label in places.items() if label.unit in ("", "deg")}
    among = (degrees, degrees, places)
    found = [
        next((f for f, label in fields.items() if pattern.search(label.name)), "")
        for pattern, fields in zip(GEOGRAPHIC_NAMES, among, strict=True)
    ]
    if not found[0]:
        found = [
            next((f for f, label in named.items() if re.search(rf"ll[ah][._/].*{a}$", label.name)), "") for a in "xyz"
        ]
    if found[0] and found[1]:
        yield Guess("position", topic.name, tuple(field for field in found if field), GEOGRAPHIC, rank=1)


_CORNERS: Final = ("fl", "fr", "rl", "rr")
_CORNER: Final = re.compile(r"(?<![a-z])(fl|fr|rl|rr|lf|rf|lr|lb|rb)(?![a-z])")
_IN_WORDS: Final = tuple(
    (re.compile(f"{end}[_ ]?{side}|{side}[_ ]?{end}"), end[0] + side[0])
    for end in ("front", "rear")
    for side in ("left", "right")
)
_WHEEL_SPEED: Final = re.compile(r"(wheel|speed|vel|rpm|(?<![a-z])(ws|v|omega))")
_NO_SPEED: Final = re.compile(r"valid|direction|(?<![a-z])is_")


def _wheels(topic: Topic, named: Mapping[str, Label]) -> Iterator[Guess]:
    """Speeds of four wheels; those of joints are in rad/s, and how large the wheels are is not known."""
    turned = {"lf": "fl", "rf": "fr", "lr": "rl", "lb": "rl", "rb": "rr"}
    columns: dict[str, str] = {}
    for field, label in named.items():
        name = label.name
        for words, letters in _IN_WORDS:
            name = words.sub(letters, name)
        corner = _CORNER.search(name)
        if corner and field not in topic.joints and _WHEEL_SPEED.search(name) and not _NO_SPEED.search(name):
            columns.setdefault(turned.get(corner[1], corner[1]), field)
    if set(columns) == set(_CORNERS):
        fields = tuple(columns[corner] for corner in _CORNERS)
        if (guess := _guess("wheel_speed", topic, fields, named[fields[0]])) is not None:
            yield guess


def by_topic(result: Iterable[Guess]) -> dict[str, dict[str, Guess]]:
    """First guess for each channel, by topic."""
    sorted_out: dict[str, dict[str, Guess]] = {}
    for guess in result:
        sorted_out.setdefault(guess.topic, {}).setdefault(guess.channel, guess)
    return sorted_out
