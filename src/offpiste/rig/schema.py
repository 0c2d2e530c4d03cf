"""Parsing and validation of rig files by the types of their entries.

The types set bounds of numbers and patterns of names; errors state the full key of the faulty entry.
"""

import copy
import math
import re
import sys
from collections.abc import Mapping
from typing import Annotated, Any, Final, TypeVar

import msgspec
from msgspec import Meta

from offpiste.core.errors import RigError
from offpiste.core.field_names import suggestion

_MOST: Final = sys.float_info.max
Finite = Annotated[float, Meta(ge=-_MOST, le=_MOST)]
Positive = Annotated[float, Meta(gt=0.0, le=_MOST)]
Fraction = Annotated[float, Meta(gt=0.0, le=1.0)]
_TOPIC: Final = r"^(/[a-zA-Z_]\w*)+\Z"
_TYPE: Final = r"^[a-zA-Z]\w*/msg/[A-Z]\w*\Z"
_PATH: Final = r"^[a-z][a-zA-Z0-9_]*(\.[a-z][a-zA-Z0-9_]*)*(\[\d{1,3}\])?\Z"
TopicName = Annotated[str, Meta(pattern=_TOPIC)]
MessageType = Annotated[str, Meta(pattern=_TYPE)]
FieldPath = Annotated[str, Meta(pattern=_PATH)]

_WORDS: Final = {
    f"`str` matching regex {_TOPIC!r}": "a topic such as /vehicle/command",
    f"`str` matching regex {_TYPE!r}": "a type such as geometry_msgs/msg/Twist",
    f"`str` matching regex {_PATH!r}": "a field path such as drive.speed or axes[2]",
    "`float`": "a number",
    "`array`": "a list",
    "`object`": "a table",
}
"""Plain words for those of msgspec's messages."""
_WHERE: Final = re.compile(r" - at (`key` in )?`\$\.?(.*)`")
_STEP: Final = re.compile(r"\[\.\.\.\]|\[\d+\]|[^.\[]+")
_T = TypeVar("_T")


def converted(given: Mapping[str, Any], kind: type[_T]) -> _T:
    """Convert parsed TOML to a struct; raise `RigError` with the full key and the value of the first fault."""
    try:
        return msgspec.convert(given, type=kind)
    except msgspec.ValidationError as error:
        what = _WHERE.sub("", str(error))
        for jargon, words in _WORDS.items():
            what = what.replace(jargon, words)
        if found := _WHERE.search(str(error)):
            steps = [*_STEP.findall(found[2]), *(["[...]"] if found[1] else [])]
            key, value = _located(given, kind, steps, str(error))
            if isinstance(value, float) and not math.isfinite(value):
                what = "Expected a finite number"
            shown = "" if found[1] or isinstance(value, dict | list) else f" is {value!r}"
            what = f"{key}{shown}: {what[0].lower()}{what[1:]}"
        raise RigError(what, how=f"{suggestion(error, kind)}see docs/rig.md for the keys of a rig") from error


def _located(given: Mapping[str, Any], kind: type, steps: list[str], message: str) -> tuple[str, Any]:
    """Return the full key and the value of a faulty entry, from a path in which `[...]` stands for any name.

    Args:
        message: msgspec's, which tells this fault from others.
    """
    whole: Any = copy.deepcopy(given)
    key, entry = "", whole
    for step in steps:
        if step.startswith("[") and step != "[...]":
            key, entry = key + step, entry[int(step[1:-1])]
            continue
        name = _faulty(whole, kind, entry, message) if step == "[...]" else step
        key += f".{name}" if re.fullmatch(r"[\w-]+", name) else f'."{name}"'
        entry = entry[name]
    return key.lstrip("."), entry


def _faulty(whole: Any, kind: type, table: dict[str, Any], message: str) -> str:
    """Return the name of the first entry of a table within a rig with this fault, and leave it as the only one."""
    for name, entry in dict(table).items():
        table.clear()
        table[name] = entry
        try:
            msgspec.convert(whole, type=kind)
        except msgspec.ValidationError as error:
            if str(error) == message:
                return name
    raise AssertionError("an entry is faulty")


def refuse(*rules: tuple[object, str, str]) -> None:
    """Raise an error for the first broken rule: (whether it is broken, fault, fix)."""
    for broken, what, how in rules:
        if broken:
            raise RigError(what, how=how)
