"""Names, units and axes in labels of columns and fields: `x(m)`, `vx [m/s]`, `steer_deg`, `time_us`."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal
from unicodedata import combining, normalize

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import RigError
from offpiste.core.limits import packaged_table
from offpiste.rig.channels import SECONDS_PER_UNIT, known_channels, unit_factor
from offpiste.rig.rig import Rig

_SINCE_1970: Final = (1.0e9, 4.1e9)
"""Seconds from 1970 to 2001 and to 2100."""
RATES: Final = (0.2, 20_000.0)
"""Plausible sampling rates of recordings [Hz]."""

VOCABULARY: Final = packaged_table("offpiste.rig", "vocabulary.toml")

PATTERNS: Final = {name: re.compile(pattern) for name, pattern in VOCABULARY["patterns"].items()}
"""Patterns of names (see vocabulary.toml)."""
PRESSURES: Final = frozenset(("pa", "kpa", "mpa", "bar", "psi"))
"""Units of pressures."""

_UNITS: Final[dict[str, str]] = {
    spelling: unit for unit, spellings in VOCABULARY["units"].items() for spelling in spellings
}
_BRACKETED: Final = _UNITS | {unit: unit for unit in VOCABULARY["other_units"]["in_brackets"]}
_AFTER: Final[dict[str, str]] = {spelling: unit for spelling, unit in _UNITS.items() if unit != "1"} | VOCABULARY[
    "other_units"
]["as_suffixes"]
_SUFFIX: Final = re.compile(
    r"^(.*?[^\W_])(?:[_\s-]+("
    + "|".join(re.escape(s) for s in sorted(_AFTER, key=len, reverse=True))
    + r")|\s*([%‰°º]))$"
)
_NAMES: Final = {"rpm"}
"""Units that are also the name of a quantity and stay part of it."""


@dataclass(frozen=True)
class Label:
    """Name and unit in a column's header."""

    name: str  # in English and in snake case, without the unit: `posX` is `pos_x`
    unit: str = ""  # as rigs write it, e.g. "deg", "km/h" or "us"; "" if the header has none


def parse_label(header: str) -> Label:
    """Split a column or field into its name, in English, and unit; brackets without a known unit stay in the name."""
    label = _as_written(header)
    name = _without_accents(label.name)
    for english, words in _WORDS.items():
        name = words.sub(english, name)
    return Label(name, label.unit)


def _without_accents(text: str) -> str:
    return normalize("NFC", "".join(each for each in normalize("NFD", text) if not combining(each)))


_WORDS: Final = {
    english: re.compile(rf"(?<![a-z])({_without_accents(words)})(?![a-z])")
    for english, words in VOCABULARY["words"].items()
}
"""Foreign words, by their English translations."""


def _as_written(header: str) -> Label:
    text = PATTERNS["word_begins"].sub("_", header.strip()).lower()
    # `x[m]`, then `x / m` and `x, m`, then `x_m`.
    if (match := PATTERNS["bracket"].match(text)) and match[1]:
        name, inside = match[1], next(group for group in match.groups()[1:] if group is not None)
        if (unit := unit_of(inside)) is not None:
            return Label(name.strip(" /,"), unit)
    if (match := PATTERNS["worded"].match(text)) and (unit := unit_of(match[2])) is not None:
        return Label(match[1].strip(), unit)
    if (match := _SUFFIX.match(text)) and (match[2] != "psi" or PATTERNS["pressed"].search(match[1])):
        spelling = match[2] or match[3]
        return Label(text if spelling in _NAMES else match[1], _AFTER[spelling])
    return Label(text, _UNITS[text] if PATTERNS["clock"].fullmatch(text) else "")


def field_labels(
    topic: str, fields: Sequence[str], units: Mapping[str, str], joints: Mapping[str, str]
) -> dict[str, Label]:
    """Return the name and the unit of each field of a topic.

    The topic names the fields of messages with one or two quantities, and fields whose names do not state a quantity.

    Args:
        units, joints: as of `offpiste.logs.log.Topic`.
    """
    result = {}
    quantities = [name for name in fields if not is_beside_quantity(name)]
    for name in fields:
        asked = is_named("of_the_topic", name) or is_named("asked", parse_label(name).name)
        alone = len(quantities) <= 2 and name in quantities
        by_topic = len(fields) <= 2 or (topic and (alone or asked))
        whole = joints.get(name) or (f"{topic}/{name}" if by_topic else name)
        label = parse_label(whole)
        if not label.unit and (number := PATTERNS["number_only"].search(label.name)):
            label = parse_label(whole[: number.start()])
        result[name] = Label(label.name, units.get(name, "") or label.unit)
    return result


def is_named(kind: str, *names: str) -> bool:
    """Return whether any of some names matches a pattern of vocabulary.toml."""
    return any(PATTERNS[kind].search(name) for name in names)


def is_beside_quantity(field: str) -> bool:
    """Return whether a field is a limit, counter, switch or the like, rather than a quantity."""
    return is_named("beside_quantity", re.split("[./]", parse_label(field).name)[-1])


def is_array_entry(field: str) -> bool:
    """Return whether a field is an entry of an array, such as `data[3]`."""
    return re.search(r"\[\d+\]$", field) is not None


def without_comment(header: str) -> str:
    """Remove the comment sign of a header, or of the first name in it."""
    return PATTERNS["comment"].sub("", header)


def unit_of(text: str) -> str | None:
    """Return the unit in a cell or a bracket as rigs write it; None for other text, "" for no unit."""
    spelled = re.sub(r"\s+", "", text.strip().strip("[](){}").lower()).replace("|", "/")
    if spelled in ("", "1", "-", "none", "unitless"):
        return ""
    return _BRACKETED.get(spelled)


def channel_unit(channel: str, unit: str) -> str | None:
    """Return a channel's unit as a rig writes it: "" for the internal one, None if the unit does not measure it."""
    own = known_channels()[channel][0]
    if unit == "ms" and own == "m/s":
        unit = "m/s"  # as in `speed_ms`
    try:
        unit_factor(channel, unit)
    except RigError:
        return None
    return "" if unit == own else unit


def unit_by_rate(rate: float, unit: str, stamp: float = 0.0) -> str:
    """Return the unit of stamps, judged by their magnitude and rate; vehicles are recorded at about 50 Hz.

    Args:
        rate: sampling rate if the stamps are in `unit` [Hz].
        unit: assumed unit, kept if the rate is plausible.
        stamp: one recorded stamp, to detect time since 1970.
    """
    for name, seconds in SECONDS_PER_UNIT.items():
        since, samples = stamp * seconds, rate * SECONDS_PER_UNIT[unit] / seconds
        if _SINCE_1970[0] < since < _SINCE_1970[1] and RATES[0] < samples < RATES[1]:
            return name
    if not np.isfinite(rate) or RATES[0] < rate < RATES[1]:
        return unit
    wanted = np.log10(SECONDS_PER_UNIT[unit] * rate / 50)
    return min(SECONDS_PER_UNIT, key=lambda name: abs(np.log10(SECONDS_PER_UNIT[name]) - wanted))


def are_since_1970(stamps: Float[np.ndarray, " n"]) -> bool:
    """Return whether all stamps are times since 1970, between 2001 and 2100, in s, ms, us or ns."""
    first, last = _SINCE_1970
    return any(((first * each < stamps) & (stamps < last * each)).all() for each in (1.0, 1e3, 1e6, 1e9))


_AXIS_WORDS: Final = tuple(
    (re.compile(rf"(?<![a-z]){each['words']}(?![a-z])"), each["letters"]) for each in VOCABULARY["axes"]
)


def with_letters(name: str) -> str:
    """Replace words for axes in a name by the letters x, y and z."""
    for pattern, letter in _AXIS_WORDS:
        name = pattern.sub(letter, name)
    return name


def named_axis(field: str) -> str:
    """Return the axis in the name of a position's field: "x" (or east), "y" (or north), "z" (or up); "" for none."""
    return _last_letter(with_letters(parse_label(field).name))


def named_coordinate(field: str) -> str:
    """Return the geographic coordinate in the name of a position's field: "lat" or "lon"; "" for none."""
    name = parse_label(field).name
    return next((what for what in ("latitude", "longitude") if is_named(what, name)), "")[:3]


def named_down(field: str) -> bool:
    """Return whether a position's field is named as a coordinate that points down."""
    return is_named("down", parse_label(field).name)


def named_direction(field: str) -> bool:
    """Return whether a position's field is named east or north, rather than by a letter."""
    return named_axis(field) in ("x", "y") and named_axis(field) != _last_letter(parse_label(field).name)


def named_course(field: str) -> bool:
    """Return whether a field is named as a course over ground, which is not a heading."""
    return is_named("course", field)


def _last_letter(name: str) -> str:
    found = PATTERNS["axis"].findall(name)
    return str(found[-1]) if found else ""


def is_measured_steering(name: str, rig: Rig) -> bool:
    """Return whether a steering channel holds a measured angle, not a command, judging by its names."""
    if name == "steer_angle" or rig.reads_alike("steer", "steer_angle"):
        return True
    names = " ".join((rig.channels[name].topic, *rig.channels[name].fields))
    return is_named("measured", names) and not is_named("commanded", names)


def looks(name: str) -> Literal["forward", "left", "back", "right"]:
    """Return a sensor's viewing direction, guessed from its name; forward by default.

    A name with `front` denotes a forward sensor, even with `left` or `right` of a stereo pair.
    """
    directions: dict[Literal["forward", "left", "back", "right"], str] = VOCABULARY["draft"]["looks"]
    return next((side for side, names in directions.items() if re.search(names, name)), "forward")
