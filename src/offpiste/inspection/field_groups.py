"""Groups of fields: vectors, positions and wheel speeds by their names, quaternions by their values."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import OffpisteError
from offpiste.core.geometry import rotation_from_quaternion
from offpiste.logs.log import Log, Topic
from offpiste.rig.channels import GEOGRAPHIC
from offpiste.rig.labels import PATTERNS, VOCABULARY, Label, is_named, parse_label, with_letters

Group = tuple[str, tuple[str, ...], str, int]
"""A channel, its candidate fields, their unit, and the rank of their names (0 is best)."""

_UNIT, _MOST = 0.02, 0.95
"""Maximum deviation of a quaternion's norm from 1, and minimum share of such rows."""


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

    def group(self, fields: tuple[str, ...], unit: str, rank: int = 0) -> Group:
        taken = tuple(fields[index] for index in self.take) or fields
        return self.channel, taken, self.unit or unit, rank or self.rank


_VECTORS: Final = tuple(_Vector(**row) for row in VOCABULARY["draft"]["vectors"])
_CORNERS: Final = {corner: re.compile(names) for corner, names in VOCABULARY["draft"]["corners"].items()}


def field_groups(topic: Topic, named: Mapping[str, Label]) -> Iterator[Group]:
    """Yield groups of a topic's fields, most reliable first; units are not checked.

    Args:
        named: name and unit of the topic's fields.
    """
    yield from _notation(named)
    yield from _vectors(named)
    yield from _arrays(topic)
    yield from _places(named)
    yield from _wheels(topic, named)


def _notation(named: Mapping[str, Label]) -> Iterator[Group]:
    """Yield fields whose names have a meaning only together."""
    columns = {label.name: field for field, label in named.items()}
    for notation in VOCABULARY["draft"]["notations"]:
        if {name for names in notation.values() for name in names} <= set(columns):
            for channel, names in notation.items():
                fields = tuple(columns[name] for name in names)
                yield channel, fields, named[fields[0]].unit, 0
            return


def _vectors(named: Mapping[str, Label]) -> Iterator[Group]:
    """Yield fields that differ in one letter: x, y, z or w."""
    for before, after, found in _letters(named):
        vector = _vector(f"{before}x{after}", before, after)
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


def _vector(name: str, before: str, after: str) -> _Vector | None:
    """Return the kind of a vector by the part of its name before the letter, or behind it if there is none before."""
    if is_named("not_vectors", name):
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


def fours(named: Mapping[str, Label]) -> Iterator[tuple[tuple[str, ...], bool]]:
    """Yield fields that differ in one letter (x, y, z or w) without an orientation's name, but may be one.

    Returns:
        The fields, and False if they belong to a reference or an error instead of the vehicle.
    """
    for before, after, found in _letters(named):
        name = f"{before}x{after}"
        vector = _vector(name, before, after)
        if len(found) == 4 and (vector is None or vector.channel != "orientation"):
            yield tuple(found.values()), not is_named("not_vectors", name)


def _arrays(topic: Topic) -> Iterator[Group]:
    """Yield arrays with as many entries as a vector, counted from 0 or 1: `q[0]` to `q[3]`, `vel_1` to `vel_3`."""
    arrays: dict[str, dict[int, str]] = {}
    for field in topic.fields:
        if not topic.joints and (match := PATTERNS["numbered"].match(field)):
            arrays.setdefault(match[1], {})[int(match[2] or match[3] or match[4])] = field
    for name, entries in arrays.items():
        label, first = parse_label(name), min(entries)
        vector = _vector(label.name, label.name, "")
        counted = first in (0, 1) and set(entries) == set(range(first, first + len(entries)))
        if is_named("other_parts", topic.name, topic.type, label.name) or not counted or vector is None:
            continue
        if len(entries) in vector.sizes:
            fields = tuple(entries[number] for number in sorted(entries))
            yield vector.group(fields, topic.units.get(fields[0], "") or label.unit)


def _places(named: Mapping[str, Label]) -> Iterator[Group]:
    """Yield geographic positions, e.g. of sensor_msgs/NavSatFix."""
    found = []
    for kind, units in (("latitude", ("", "deg", "rad")), ("longitude", ("", "deg", "rad")), ("height", ("", "m"))):
        of_unit = ((field, label.name) for field, label in named.items() if label.unit in units)
        found.append(next((f for f, name in of_unit if is_named(kind, name) and not is_named("lateral", name)), ""))
    if found[0] and found[1]:
        yield "position", tuple(filter(None, found)), GEOGRAPHIC, 1


def _wheels(topic: Topic, named: Mapping[str, Label]) -> Iterator[Group]:
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
