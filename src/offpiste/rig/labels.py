"""Labels of columns and fields: name and unit in `x(m)`, `vx [m/s]`, `steer_deg`, `time_us`, and the axis of a name."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.core.channels import in_english
from offpiste.core.errors import RigError
from offpiste.rig.channels import known_channels, unit_factor

PER_SECOND: Final = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9, "d": 1 / 86_400}
"""Units of stamps in a second; spreadsheets count days."""
_SINCE_1970: Final = (1.0e9, 4.1e9)
"""Seconds from 1970 to 2001 and to 2100."""
RATES: Final = (0.2, 20_000.0)
"""Samples a second that recordings have."""

_SPELLINGS: Final[dict[str, str]] = {
    "s": "s sec secs second seconds",
    "ms": "ms msec msecs millis millisecond milliseconds",
    "us": "us µs μs usec usecs micros microsecond microseconds",
    "ns": "ns nsec nsecs nanos nanosecond nanoseconds",
    "d": "day days",
    "m": "m meter meters metre metres",
    "cm": "cm",
    "mm": "mm",
    "ft": "ft feet",
    "rad": "rad rads radian radians",
    "deg": "deg degs degree degrees ° º",
    "mrad": "mrad",
    "m/s": "m/s m_s mps m/sec m*s^-1 m·s-1 ms-1 ms^-1 m.s-1",
    "km/h": "km/h km_h kmh kph kmph",
    "mph": "mph",
    "kn": "kn knot knots kts",
    "rad/s": "rad/s rad_s radps rad/sec rad*s^-1 rad.s-1 rads^-1",
    "deg/s": "deg/s deg_s degps dps deg/sec °/s º/s",
    "rev/min": "rev/min rpm 1/min",
    "percent": "percent pct %",
    "permille": "permille ‰",
    "1": "1 - none unitless",
}
"""Units as rigs take them, and how logs spell them."""
_OTHERS: Final = (
    "m/s^2 m/s2 m/s² m/s/s m_s2 mps2 g rad/s^2 rad/s2 rad/s² deg/s^2 n nm n*m v mv a ma w pa kpa mpa bar psi c °c hz"
)
"""Units of what no channel holds."""

PRESSURES: Final = frozenset(("pa", "kpa", "mpa", "bar", "psi"))
"""Those of pressures."""

_UNITS: Final = {spelling: unit for unit, all_of in _SPELLINGS.items() for spelling in all_of.split()}
_BRACKETED: Final = {**_UNITS, **{unit: unit for unit in _OTHERS.split()}}
_AFTER: Final = {s: unit for s, unit in _UNITS.items() if unit != "1"} | {
    "m_s2": "m/s2", "mps2": "m/s2", "bar": "bar", "kpa": "kpa", "mpa": "mpa", "psi": "psi", "mv": "mv",
}  # fmt: skip
_WORD_BEGINS: Final = re.compile(r"(?<=[a-z0-9])(?=[A-Z])(?!(?<=[\W_][mk])(V|A|W|Pa|Hz)(?![a-z]))")
"""Where a capital begins a word, and is none of the unit mV or kPa."""
_BRACKET: Final = re.compile(r"^(.*?)[\s_]*(?:\[([^\[\]]*)\]|\(([^()]*)\)|\{([^{}]*)\}|<([^<>]*)>)$")
_PRESSED: Final = re.compile("brake|press|line|circuit|hydr|air")
"""Names that psi is the unit of; it is a heading, too."""
_WORDED: Final = re.compile(r"^(.*\S)(?:\s+/\s*|,\s*|\s+in\s+)\(?([^\s()]+)\)?$")
_SUFFIX: Final = re.compile(
    r"^(.*?[^\W_])(?:[_\s-]+("
    + "|".join(re.escape(s) for s in sorted(_AFTER, key=len, reverse=True))
    + r")|\s*([%‰°º]))$"
)
_OF_THE_TOPIC: Final = re.compile(
    r"^(vector|point|quaternion|angle)\.[xyzw]$|^(manual_input|command|output)$|^(front|rear)_(left|right)$"
    r"|^(percent|pressure|torque)_(cmd|com+and|input|output)$"
    r"|^pedal(_(cmd|com+and|value|input|output|pos(ition)?))?$"
)
"""Fields whose topic alone says what they are of: vectors of any kind, reports of any actuator, a pedal."""
_COMMAND_WORDS: Final = "cmd|com+and(ed)?|setpoint|desired|target|req(uest(ed)?)?|ref(erence)?"
_PLACE_WORDS: Final = "((road_?|front_?)?wheel_?|tyre_?|tire_?)?(angle|ang|pos(ition)?|pedal|value|percent|pct|effort)"
_ASKED: Final = re.compile(
    rf"^({_PLACE_WORDS}_)?({_COMMAND_WORDS})$|^({_COMMAND_WORDS})_{_PLACE_WORDS}$|^(measured|actual)_(wheel_)?angle$"
    r"|^(wheel_)?angle_(meas(ured)?|act(ual)?|feedback|fb)$"
)
"""Fields that say that a place is asked for or measured, and whose topic says what it is the place of."""
_BESIDES: Final = re.compile(
    r"(?<![a-z])(lim(it)?s?|max(imum)?|min(imum)?|seq(uence)?|crc|checksum|ok|id|valid(ity)?|status|mode|enabled?|active"
    r"|priority|faults?|overrid(e|den)|time_?out|(alive|rolling|message|msg)_?count(er)?|counter)$"
    r"|^(max(imum)?|min(imum)?|enable|override|ignore|clear|watchdog)_"
)
"""What a message says of a quantity besides the quantity: bounds, whether it counts, and numbers of the messages."""
_NUMBER_ONLY: Final = re.compile(r"[/.](data|value)$")
_COMMENT: Final = re.compile(r"^ *(#+|//+|%+(?!.*[,;|\t] *%)) *(?=[^\s,;|])")
"""What makes a header a comment, as numpy.savetxt or `rostopic echo -p` writes it; signs before each name are units."""
_NAMES: Final = {"rpm"}
"""Units that name a quantity by themselves, and stay a part of its name."""
_CLOCKS: Final = re.compile("m(illi)?s(ec(ond)?s?)?|u(s(ec)?s?)|ns(ec)?s?|(milli|micro|nano)(s|seconds?)")
"""Units of time that name a clock by themselves: `millis` of an Arduino."""


@dataclass(frozen=True)
class Label:
    """What a column's header says.

    Attributes:
        name: in English, without the unit, in lower case, words joined by `_` where they were by a capital: `posX` is
            `pos_x`.
        unit: as rigs take it, e.g. "deg", "km/h" or, of time, "us"; "" where the header says none.
    """

    name: str
    unit: str = ""


def parse_label(header: str) -> Label:
    """Name, in English, and unit of a column or field; brackets that hold no known unit stay a part of the name."""
    label = _as_written(header)
    return Label(in_english(label.name), label.unit)


def _as_written(header: str) -> Label:
    text = _WORD_BEGINS.sub("_", header.strip()).lower()
    # `x[m]`, then `x / m` and `x, m`, then `x_m`.
    if (match := _BRACKET.match(text)) and match[1]:
        name, inside = match[1], next(group for group in match.groups()[1:] if group is not None)
        if (unit := unit_of(inside)) is not None:
            return Label(name.strip(" /,"), unit)
    if (match := _WORDED.match(text)) and (unit := unit_of(match[2])) is not None:
        return Label(match[1].strip(), unit)
    if (match := _SUFFIX.match(text)) and (match[2] != "psi" or _PRESSED.search(match[1])):
        spelling = match[2] or match[3]
        return Label(text if spelling in _NAMES else match[1], _AFTER[spelling])
    return Label(text, _UNITS[text] if _CLOCKS.fullmatch(text) else "")


def field_labels(
    topic: str, fields: Sequence[str], units: Mapping[str, str], joints: Mapping[str, str]
) -> dict[str, Label]:
    """Name and unit of each field of a topic.

    A message with one or two quantities is named by its topic, and so is a field that does not say what it is of. A
    limit, a counter or a switch that enables is no quantity (`is_beside_quantity`).

    Args:
        units: of fields, where the topic has them apart.
        joints: names of entries of arrays, where the messages have them.
    """
    result = {}
    quantities = [name for name in fields if not is_beside_quantity(name)]
    for name in fields:
        asked = _OF_THE_TOPIC.search(name) or _ASKED.search(parse_label(name).name)
        alone = len(quantities) <= 2 and name in quantities
        by_topic = len(fields) <= 2 or (topic and (alone or asked))
        whole = joints.get(name) or (f"{topic}/{name}" if by_topic else name)
        label = parse_label(whole)
        if not label.unit and (number := _NUMBER_ONLY.search(label.name)):
            label = parse_label(whole[: number.start()])
        result[name] = Label(label.name, units.get(name, "") or label.unit)
    return result


def is_beside_quantity(field: str) -> bool:
    """Whether a field is a limit, a counter, a switch or the like, which goes with a quantity and is none itself."""
    return _BESIDES.search(re.split("[./]", parse_label(field).name)[-1]) is not None


def is_array_entry(field: str) -> bool:
    """Whether a field is an entry of an array, `data[3]`; a bracket with a unit is none."""
    return re.search(r"\[\d+\]$", field) is not None


def without_comment(header: str) -> str:
    """A header, or the name that is its first, without what makes it a comment."""
    return _COMMENT.sub("", header)


def unit_of(text: str) -> str | None:
    """The unit that a cell or a bracket names, as rigs take it; None where it is no unit, "" where it is empty."""
    spelled = re.sub(r"\s+", "", text.strip().strip("[](){}").lower()).replace("|", "/")
    if spelled in ("", "1", "-", "none", "unitless"):
        return ""
    return _BRACKETED.get(spelled)


def channel_unit(channel: str, unit: str) -> str | None:
    """What a rig says of a unit for a channel: "" for offpiste's own, None where the unit does not measure it."""
    own = known_channels()[channel][0]
    if unit == "ms" and own == "m/s":
        unit = "m/s"  # as in `speed_ms`
    try:
        unit_factor(channel, unit)
    except RigError:
        return None
    return "" if unit == own else unit


def unit_by_rate(rate: float, unit: str, stamp: float = 0.0) -> str:
    """The unit of stamps, by their size, or by the rate that they have in another one [1/s].

    Args:
        rate: samples in each of the seconds that the stamps would have in `unit`; vehicles are recorded at some 50 Hz.
        unit: that is kept where the rate is one of recordings.
        stamp: one of them, as recorded: its size tells seconds since 1970 where the rate is one of recordings, too.
    """
    for name, per_second in PER_SECOND.items():
        since, samples = stamp / per_second, rate * per_second / PER_SECOND[unit]
        if _SINCE_1970[0] < since < _SINCE_1970[1] and RATES[0] < samples < RATES[1]:
            return name
    if not np.isfinite(rate) or RATES[0] < rate < RATES[1]:
        return unit
    wanted = np.log10(PER_SECOND[unit] * 50 / rate)
    return min(PER_SECOND, key=lambda name: abs(np.log10(PER_SECOND[name]) - wanted))


def are_since_1970(stamps: Float[np.ndarray, " n"]) -> bool:
    """Whether all of some numbers are times since 1970, in one unit but days, from 2001 to 2100."""
    first, last = _SINCE_1970
    return any(((first * each < stamps) & (stamps < last * each)).all() for each in (1.0, 1e3, 1e6, 1e9))


def time_unit(unit: str) -> str:
    """A unit of time as a clock takes it; "" for any other."""
    return unit if unit in PER_SECOND else ""


_AXIS_WORDS: Final = tuple(
    (re.compile(rf"(?<![a-z]){pattern}(?![a-z])"), to)
    for pattern, to in (
        ("(easting|east)", "x"),
        ("(northing|north)", "y"),
        ("(up|altitude|alt|elevation|height)", "z"),
        ("(utm|p|pos|position|enu)_?e", r"\1_x"),
        ("(utm|p|pos|position|enu)_?n", r"\1_y"),
        ("(utm|pos|position|enu)_?[uh]", r"\1_z"),
        ("(v|vel|velocity|speed)_(lon|long|longitudinal|forward|fwd)", "v_x"),
        ("(v|vel|velocity|speed)_(lat|lateral|left)", "v_y"),
        ("([xyz])_?dot", r"v_\1"),
        ("(v|vel|velocity)_?e", "v_x"),
        ("(v|vel|velocity)_?n", "v_y"),
        ("(v|vel|velocity)_?u", "v_z"),
        ("([xyz])[_ ](v|vel|velocity)", r"v_\1"),
    )
)
"""Words for the letters x, y and z of vectors."""
_DOWN_NAME: Final = re.compile(r"(?<![a-z])(d|down)$")
_AXIS_NAME: Final = re.compile(r"(?<![a-z])[pt]?([xyz])(?![a-z])")
GEOGRAPHIC_NAMES: Final = tuple(
    re.compile(rf"(?<![a-z])({words})$")
    for words in ("lat|latitude", "lon|lng|long|longitude", "alt|altitude|height|elevation")
)
"""What latitude, longitude and height are called."""
COURSE_NAMES: Final = r"track|head(ing)?_?(of_?)?mot(ion)?|trk_gnd|course([_ ]over[_ ]ground|[_ ]?angle)?|cog"
"""What a course over ground is called, as part of a pattern."""
_COURSE_WORD: Final = re.compile(r"(?i)course|(?<![a-z])(cog|trk|track)(?![a-z])|gps[ _.]?(heading|hdg)|head\w*mot")
"""What every such name holds, and longer ones too, and what loggers call it."""


def with_letters(name: str) -> str:
    """A name with the letters x, y and z in place of words for them."""
    for pattern, letter in _AXIS_WORDS:
        name = pattern.sub(letter, name)
    return name


def named_axis(field: str) -> str:
    """The axis that a position's field is named by: "x" (or east), "y" (or north), "z" (or up); "" for none."""
    return _last_letter(with_letters(parse_label(field).name))


def named_coordinate(field: str) -> str:
    """The coordinate that a position's field is named by: "lat" (latitude) or "lon" (longitude); "" for none."""
    name = parse_label(field).name
    return next(
        (what for what, pattern in zip(("lat", "lon"), GEOGRAPHIC_NAMES, strict=False) if pattern.search(name)), ""
    )


def named_down(field: str) -> bool:
    """Whether a position's field is named by the way down, as the third of north, east, down."""
    return _DOWN_NAME.search(parse_label(field).name) is not None


def named_direction(field: str) -> bool:
    """Whether a position's field is named by a direction, east or north, and not by a letter."""
    return named_axis(field) in ("x", "y") and named_axis(field) != _last_letter(parse_label(field).name)


def named_course(field: str) -> bool:
    """Whether a field is named as a course over ground, which is no heading."""
    return _COURSE_WORD.search(field) is not None


def _last_letter(name: str) -> str:
    found = _AXIS_NAME.findall(name)
    return str(found[-1]) if found else ""
