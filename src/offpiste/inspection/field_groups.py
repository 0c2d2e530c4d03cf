"""Groups of fields: vectors, positions and wheel speeds by their names, quaternions by their values."""

import re
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import OffpisteError
from offpiste.core.geometry import rotation_from_quaternion
from offpiste.logs.log import Log, Topic
from offpiste.rig.channels import GEOGRAPHIC
from offpiste.rig.labels import GEOGRAPHIC_NAMES, Label, parse_label, with_letters

Group = tuple[str, tuple[str, ...], str, int]
"""A channel, its candidate fields, their unit, and the rank of their names (0 is best)."""

_RADII: Final = (6.34e6, 6.39e6)
_EASTING: Final = 1e6
"""Threshold between projected and Earth-centred coordinates; northings may exceed it [m]."""
_UNIT, _MOST = 0.02, 0.95
"""Maximum deviation of a quaternion's norm from 1, and minimum share of such rows."""
_AXIS = re.compile(r"(?<![a-z])([pqtvwg]?)x(?![a-z])")
_TRANSLATION: Final = re.compile(r"(?<![a-z])t[._ ]*$")
"""Prefix of the letter x in TUM's `tx`, which may also be a torque: a position only as a fallback."""
_FRAMES: Final = re.compile(r"((?:^|[./ ])[pqvw])(_[a-z]{1,2}){1,2}$")
"""Frame suffixes of a vector's letter, e.g. from R to S, expressed in R: `p_RS_R_x`."""
_PLACES = (
    "utm|enu|local|global|world|map|gps|gnss|ego|car|veh|vehicle|odom|rtk|slam|base|robot|center|cog|pos|gt|ground_?truth"
    "|ekf|est|state|cg|rear_?axle|loc(ation)?|coord(inate)?s?"
)
_GROUPS: tuple[tuple[str, re.Pattern[str], str], ...] = (
    ("angular_velocity", re.compile(r"angular|gyro|omega|rot(ation)?_?rate|rate_of_rot|(^|[^a-z])[wg]$"), "yz"),
    ("orientation", re.compile(r"orient|quat|attitude|rot|(^|[^a-z])q(n2b)?$"), "yzw"),
    ("linear_velocity", re.compile(r"linear_?vel|twist[._/]linear|vel|(^|[^a-z])(v|uvw)$"), "yz"),
    ("position", re.compile(rf"pos|vicon|mocap|optitrack|translation|(^|[^a-z])[pt]?$|(?<![a-z])({_PLACES})$"), "yz"),
)
"""Vectors by the prefix of the letter x, and the other letters."""
_WIDTHS: Final = {"orientation": (4,), "angular_velocity": (3,), "linear_velocity": (2, 3), "position": (2, 3)}
_NOT_GROUPS = re.compile(
    r"acc|magn|gravity|force|effort|imu.*orient|ll[ah](?![a-z])|(?<![a-z])g\("
    r"|(?<![a-z])(mag|err|error|ref|des|desired|target|goal|setpoint|waypoint|cov|covariance|std|stdev|sd|sigma)(?![a-z])"
)
_NUMBERED: Final = re.compile(r"^(.+?)(?:\[(\d)\]|[._](\d)|(?:(?<=q)|(?<=quat))(\d))$")
_LLA: Final = re.compile(r"(?<![a-z])ll[ah]$|(?<![a-z])geodetic(\.value)?$")
"""Names of arrays of latitude, longitude and height."""
_NED_VELOCITY: Final = re.compile(r"(?<![a-z])velocity_ned(\.value)?$")
_NED_ANGLES: Final = re.compile(r"(?<![a-z])(calibrated_)?orientation_ned(\.value)?$|(?<![a-z])theta$")
"""Names of north-east-down arrays: openpilot's velocities and roll, pitch, yaw (of device or, calibrated, of the car),
and Inertial Sense's."""
_EAST: Final = re.compile(r"(?<![a-z])(e|east)(?![a-z])")
"""Names of the east component."""
_ACTUATED: Final = re.compile(r"joint|wheel|motor|servo|actuator|output", re.IGNORECASE)
"""Names of parts whose positions and velocities are not the vehicle's."""

_TOGETHER: Final[tuple[tuple[frozenset[str], tuple[tuple[str, tuple[str, ...]], ...]], ...]] = (
    (frozenset("uvwpqr"), (("linear_velocity", ("u", "v", "w")), ("angular_velocity", ("p", "q", "r")))),
    (frozenset("uvr"), (("linear_velocity", ("u", "v")), ("yaw_rate", ("r",)))),
)
"""Names that are only meaningful together, in one notation (SNAME's, for marine vehicles)."""


def field_groups(topic: Topic, named: Mapping[str, Label]) -> Iterator[Group]:
    """Yield groups of a topic's fields, most reliable first; units are not checked.

    Args:
        named: name and unit of the topic's fields.
    """
    yield from _together(named)
    yield from _vectors(named)
    yield from _numbered(topic)
    yield from _places(named)
    yield from _wheels(topic, named)


def _together(named: Mapping[str, Label]) -> Iterator[Group]:
    columns = {label.name: field for field, label in named.items()}
    for letters, channels in _TOGETHER:
        if letters <= set(columns):
            for channel, names in channels:
                fields = tuple(columns[name] for name in names)
                yield channel, fields, named[fields[0]].unit, 0
            return


def _vectors(named: Mapping[str, Label]) -> Iterator[Group]:
    """Yield fields that differ in one letter: x, y, z or w."""
    plain = {label.name: field for field, label in reversed(list(named.items()))}
    columns = {with_letters(name): field for name, field in plain.items()} | plain
    for name in dict.fromkeys(with_letters(label.name) for label in named.values()):
        for match in _AXIS.finditer(name):
            before, after = name[: match.end() - 1], name[match.end() :]
            if (group := _group_of(name, before, after)) is None:
                continue
            channel, _, letters = group
            fields = (columns[name], *(columns[n] for a in letters if (n := before + a + after) in columns))
            if channel == "position" and len(fields) == 2:
                fields += tuple(field for field, label in named.items() if _HEIGHT.fullmatch(label.name))[:1]
            if len(fields) == 3 and (named[fields[2]].unit or "m") != (named[fields[0]].unit or "m"):
                fields = fields[:2]  # a channel has one unit: east and north may be in m, the height in ft
            east = named[fields[0]].name
            if len(fields) == 2 and _EAST.search(east) and (down := plain.get(_EAST.sub(_down_of, east))):
                fields = (fields[1], fields[0], down)
            if len(fields) in _WIDTHS[channel]:
                torques = channel == "position" and _TRANSLATION.search(before)
                yield channel, fields, named[fields[0]].unit, 2 if torques else 0


def fours(named: Mapping[str, Label]) -> Iterator[tuple[tuple[str, ...], bool]]:
    """Yield fields that differ in one letter (x, y, z or w) without an orientation's name, but may be one.

    Returns:
        The fields, and False if they belong to a reference or an error instead of the vehicle.
    """
    columns = {label.name: field for field, label in reversed(list(named.items()))}
    for name in dict.fromkeys(label.name for label in named.values()):
        for match in _AXIS.finditer(name):
            before, after = name[: match.end() - 1], name[match.end() :]
            group = _group_of(name, before, after)
            others = [before + letter + after for letter in "yzw"]
            if set(others) <= set(columns) and (group is None or group[0] != "orientation"):
                yield (columns[name], *(columns[other] for other in others)), not _NOT_GROUPS.search(name)


def _down_of(east: re.Match[str]) -> str:
    return "down" if east[0] == "east" else "d"


def _group_of(name: str, before: str, after: str) -> tuple[str, re.Pattern[str], str] | None:
    """Return the group of a name by the prefix of its letter, or by the suffix without a prefix."""
    if _NOT_GROUPS.search(name):
        return None
    words, behind = (text.strip("._ /") for text in (before, after))
    words = _FRAMES.sub(r"\1", words)
    if not words and behind:
        *vectors, position = _GROUPS
        return next((group for group in vectors if group[1].search(behind)), position)
    return next((group for group in _GROUPS if group[1].search(words)), None)


def _numbered(topic: Topic) -> Iterator[Group]:
    """Yield arrays with as many entries as a vector, counted from 0 or 1: `q[0]` to `q[3]`, `vel_1` to `vel_3`."""
    if topic.joints or _ACTUATED.search(f"{topic.name} {topic.type}"):
        return
    arrays: dict[str, dict[int, str]] = {}
    for field in topic.fields:
        if match := _NUMBERED.match(field):
            arrays.setdefault(match[1], {})[int(match[2] or match[3] or match[4])] = field
    for name, entries in arrays.items():
        label = parse_label(name)
        group = None if _ACTUATED.search(label.name) or "ecef" in label.name else _group_of(label.name, label.name, "")
        numbers, fields = sorted(entries), tuple(entries[number] for number in sorted(entries))
        counted = numbers in ([*range(len(numbers))], [*range(1, len(numbers) + 1)])
        if counted and len(fields) == 3 and (ned := _of_north_east_down(label.name, fields)):
            yield ned
        elif group is not None and counted and len(numbers) in _WIDTHS[group[0]]:
            yield group[0], fields, topic.units.get(fields[0], "") or label.unit, 0


def _of_north_east_down(name: str, fields: tuple[str, ...]) -> Group | None:
    """Return a three-entry array of a geographic position, or of velocities or angles in a north-east-down frame."""
    if _LLA.search(name):
        return "position", fields, GEOGRAPHIC, 1
    if _NED_VELOCITY.search(name):
        return "linear_velocity", (fields[1], fields[0]), "m/s", 0
    if match := _NED_ANGLES.search(name):
        return "yaw", fields[2:], "rad", 0 if match[1] else 1
    return None


_HEIGHT: Final = re.compile(r"((utm|gps|gnss|pos|position)_)?(z|alt|altitude|elevation|height)")
"""Names of the height of a position whose east and north are named differently."""
_LATERAL: Final = re.compile(r"acc|force|vel|speed|(^|[ ._/])[av]_")
"""Names of lateral or longitudinal quantities that are not coordinates."""


def _places(named: Mapping[str, Label]) -> Iterator[Group]:
    """Yield geographic positions, e.g. of sensor_msgs/NavSatFix."""
    places = {field: label for field, label in named.items() if not _LATERAL.search(label.name)}
    degrees = {field: label for field, label in places.items() if label.unit in ("", "deg", "rad")}
    metres = {field: label for field, label in places.items() if label.unit in ("", "m")}
    among = (degrees, degrees, metres)
    found = [
        next((f for f, label in fields.items() if pattern.search(label.name)), "")
        for pattern, fields in zip(GEOGRAPHIC_NAMES, among, strict=True)
    ]
    if not found[0]:
        found = [
            next((f for f, label in named.items() if re.search(rf"ll[ah][._/].*{a}$", label.name)), "") for a in "xyz"
        ]
    if found[0] and found[1]:
        yield "position", tuple(field for field in found if field), GEOGRAPHIC, 1


_CORNERS: Final = ("fl", "fr", "rl", "rr")
_CORNER: Final = re.compile(r"(?<![a-z])(fl|fr|rl|rr|lf|rf|lr|lb|rb)(?![a-z])")
_IN_WORDS: Final = tuple(
    (re.compile(f"{end}[_ ]?{side}|{side}[_ ]?{end}"), end[0] + side[0])
    for end in ("front", "rear")
    for side in ("left", "right")
)
_WHEEL_SPEED: Final = re.compile(r"(wheel|speed|vel|rpm|(?<![a-z])(ws|v|omega))")
_WHEEL_JOINT: Final = re.compile(r"wheel.*_vel$")
_NO_SPEED: Final = re.compile(r"valid|direction|steer|(?<![a-z])is_")


def _wheels(topic: Topic, named: Mapping[str, Label]) -> Iterator[Group]:
    """Yield speeds of four wheels; if in rad/s, as for joints, the motion determines the wheel radius."""
    turned = {"lf": "fl", "rf": "fr", "lr": "rl", "lb": "rl", "rb": "rr"}
    columns: dict[str, str] = {}
    for field, label in named.items():
        name = label.name
        for words, letters in _IN_WORDS:
            name = words.sub(letters, name)
        corner = _CORNER.search(name)
        speed = _WHEEL_JOINT if field in topic.joints else _WHEEL_SPEED
        if corner and speed.search(name) and not _NO_SPEED.search(name):
            columns.setdefault(turned.get(corner[1], corner[1]), field)
    if set(columns) == set(_CORNERS):
        fields = tuple(columns[corner] for corner in _CORNERS)
        yield "wheel_speed", fields, named[fields[0]].unit, 0


def are_quaternions(log: Log, topic: str, fields: tuple[str, ...]) -> bool:
    """Return True if nearly all rows of four fields have norm 1."""
    try:
        rows = log.read(topic, fields).values
    except OffpisteError:
        return False
    rows = rows[np.isfinite(rows).all(axis=1)]
    return len(rows) > 1 and bool(np.mean(np.abs(np.linalg.norm(rows, axis=1) - 1) < _UNIT) > _MOST)


def w_comes_first(fields: tuple[str, ...], values: Float[np.ndarray, "n 4"]) -> bool:
    """Return True if unnamed quaternion entries are in w x y z order, which keeps the vehicle upright."""
    if any(re.search(r"[xyzw]$", field, re.IGNORECASE) for field in fields):
        return False
    turned = (rotation_from_quaternion(rows)[:, 2, 2] for rows in (values, np.roll(values, -1, axis=1)))
    as_stored, w_first = (float(np.mean(up)) for up in turned)
    return w_first > as_stored


def are_earth_centred(places: Float[np.ndarray, "n k"]) -> bool:
    """Return True if positions are at the Earth's radius from the origin."""
    middle = np.abs(np.median(places, axis=0))
    near = _RADII[0] < float(np.linalg.norm(middle)) < _RADII[1]
    return near and len(middle) > 2 and float(np.sort(middle)[1]) > _EASTING
