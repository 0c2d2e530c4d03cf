"""Sources of a rig's channels: topics, fields, units, signs, frames and clocks."""

from collections.abc import Collection, Mapping
from typing import Annotated, Final, Literal

import msgspec
from msgspec import Meta

from offpiste.core.channels import all_actuators, all_controls
from offpiste.core.errors import RigError, did_you_mean
from offpiste.core.limits import packaged_table
from offpiste.rig.schema import Positive, refuse

GEOGRAPHIC: Final = "lat lon"
"""Unit of positions in degrees of latitude and longitude, with the height in metres."""
REPEATED: Final = 0.25
"""Interval at which repeated values are kept as new measurements [s] (`ChannelSource.repeats`)."""
POSE: Final = ("position", "orientation", "yaw")
"""Channels of the pose, which cannot be declared absent."""

_TABLES: Final = packaged_table("offpiste.rig", "units.toml")
_UNITS: dict[str, dict[str, float]] = _TABLES["units"]
"""Conversion factors from recorded units to the internal unit (the key)."""
ANGLES: Final[Mapping[str, float]] = _UNITS["rad"]
"""Units of angles, also of steering commands (`unit_factor`)."""
TURN_RATES: Final[Mapping[str, float]] = _UNITS["rad/s"]
"""Units of turn rates, also of steering commands beside a speed (`ChannelSource.turns`)."""

OTHER_CHANNELS: dict[str, tuple[str, tuple[int, ...]]] = {
    name: (entry["unit"], tuple(entry["fields"])) for name, entry in _TABLES["channels"].items()
}
"""Internal unit and allowed numbers of fields of channels besides controls and actuators."""


def declare_channel(
    name: str, *, unit: str, fields: tuple[int, ...] = (1,), units: Mapping[str, float] | None = None
) -> None:
    """Declare a new channel for rigs; controls and actuators are declared in `offpiste.core.channels`.

    Args:
        unit: internal unit.
        fields: allowed numbers of fields.
        units: conversion factors from recorded units to a new `unit`.
    """
    if name in known_channels():
        raise RigError(f"two channels are called '{name}'", how="give one of them another name")
    OTHER_CHANNELS[name] = unit, fields
    _UNITS.setdefault(unit, {unit: 1.0}).update(units or {})


def known_channels() -> dict[str, tuple[str, tuple[int, ...]]]:
    """Return the internal unit and the allowed numbers of fields of every channel."""
    single = (1,)
    controls = {control.name: (control.unit, single) for control in all_controls()}
    actuators = {actuator.channel: (actuator.unit, single) for actuator in all_actuators()}
    return OTHER_CHANNELS | controls | actuators


class Wrap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Wrapped counter: raw values above `above` are `period` too large."""

    above: float
    period: float


class ChannelSource(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Source of a channel: value = sign * ((unwrapped raw value) * scale + offset), converted from `unit`.

    For an orientation only `offset` applies: the rotation of the body about its z axis against the logged frame [rad].
    """

    # Fields or columns in the channel's order: x y z, or a quaternion as x y z w. A steering command that is a turn
    # rate, as in geometry_msgs/Twist, has two: the turn rate and the speed [m/s].
    fields: tuple[str, ...]
    topic: str = ""  # topic or folder; "" for a table
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    sign: Literal[-1, 1] = 1
    delay: float = 0.0  # how much later than measured a sample is stamped [s]
    # Frame of velocities; if "unknown", the pose is differentiated instead.
    frame: Literal["", "world", "body", "unknown"] = ""
    wrap: Wrap | None = None
    valid: tuple[float, float] | None = None  # converted values outside are dropped as measurement faults
    clip: tuple[float, float] | None = None  # converted values are limited to this interval
    absolute: bool = False  # take the magnitude of a control whose sign is a direction, such as a speed; before `clip`
    # Meanings of recorded values, for channels with one field; keys are numbers, true, false, or single letters for
    # recorded character codes. The other entries apply to the meanings.
    values: dict[str, float] = {}
    joints: tuple[str, ...] = ()  # names in sensor_msgs/JointState by which the entries `fields` are found
    # Latitude and longitude of x = y = 0 [degrees], so that drives share coordinates; by default near each log's start.
    origin: tuple[Annotated[float, Meta(ge=-90, le=90)], Annotated[float, Meta(ge=-360, le=360)]] | None = None
    # "linear" for measurements, "hold" for commands, "on change" for commands that are published only when they change
    # and hold for any time.
    interpolation: Literal["linear", "hold", "on change"] = "linear"
    # "drop" leaves out samples equal to the previous one, except for one every `REPEATED`, for tables that repeat the
    # last value of a slower sensor.
    repeats: Literal["keep", "drop"] = "keep"

    @property
    def holds(self) -> bool:
        """True if a sample is valid until the next."""
        return self.interpolation != "linear"

    @property
    def turns(self) -> bool:
        """True if steering is commanded as a turn rate, from which a bicycle model gives the steering angle."""
        return len(self.fields) == 2 and self.unit in TURN_RATES

    def meanings(self) -> dict[float, float]:
        """Return the meanings of recorded numbers (`values`)."""
        return {_recorded(key): value for key, value in self.values.items()}


def _recorded(key: str) -> float:
    """Return the recorded number for a key of `ChannelSource.values`."""
    if key in ("true", "false"):
        return float(key == "true")
    try:
        return float(key)
    except ValueError:
        if len(key) == 1:
            return float(ord(key))
        how = 'write recorded numbers, "true", "false" or single letters, such as values = { "R" = -1, "D" = 1 }'
        raise RigError(f"values has a key '{key}' that is not a recorded number", how=how) from None


def topic_in_words(topic: str) -> str:
    """Return a topic's name for messages; tables have no name."""
    return f"topic '{topic}'" if topic else "the table"


def unit_factor(channel: str, unit: str, max_steer: float = 0.0) -> float:
    """Return the conversion factor from a recorded unit ("" for the internal one) to a channel's internal unit.

    Args:
        max_steer: of the rig [rad], by which steering commands in angles are divided; for turn rates it only states
            that the vehicle steers, and the factor converts to rad/s.
    """
    if channel == "steer" and max_steer > 0 and unit in ANGLES:
        return ANGLES[unit] / max_steer
    if channel == "steer" and max_steer > 0 and unit in TURN_RATES:
        return TURN_RATES[unit]
    own = known_channels()[channel][0]
    known = _UNITS.get(own, {own: 1.0})
    if unit and unit not in known:
        how = f"use one of: {', '.join(known)}"
        if channel == "steer":
            angle = "give vehicle.max_steer, which converts road-wheel angles" if unit in ANGLES else ""
            how = angle or f"{how}; or, for road-wheel angles, {', '.join(ANGLES)}"
        raise RigError(f"unit '{unit}' does not measure {channel}", how=how)
    return known[unit or own]


def undeclared(given: Collection[str]) -> list[str]:
    """Return the controls and actuators that a rig with the given channels must declare absent."""
    names = [control.name for control in all_controls() if control.declared]
    names += [
        actuator.channel
        for actuator in all_actuators()
        if actuator.declared and not any(a.name == actuator.rate_of and a.channel in given for a in all_actuators())
    ]
    return [name for name in names if name not in given]


def check_channels(channels: Mapping[str, ChannelSource], absent: Collection[str], max_steer: float) -> None:
    """Refuse unknown, contradicting and missing channels; `max_steer` is the rig's [rad]."""
    known = known_channels()
    for name in (*channels, *sorted(absent)):
        how = f"{did_you_mean(name, known)}channels are: {', '.join(known)}"
        refuse((name not in known, f"unknown channel '{name}'", how))
    for name, source in channels.items():
        _check_source(f"channels.{name}", name, source, max_steer)
        refuse((name in absent, f"channel '{name}' is both given and declared absent", "remove one of the two"))
    heading = {"orientation", "yaw"} & set(channels)
    refuse(
        ("position" not in channels, "channels.position is missing", "every rig needs the vehicle's position"),
        (not heading, "channels.orientation or channels.yaw is missing", "every rig needs the vehicle's heading"),
    )
    for name in undeclared(channels):
        how = f"add [channels.{name}], or '{name}' to absent"
        refuse((name not in absent, f"channel '{name}' is neither given nor declared absent", how))


def _check_source(key: str, name: str, source: ChannelSource, max_steer: float) -> None:
    count, measured = len(source.fields), name in OTHER_CHANNELS
    counts = (1, 2) if name == "steer" else known_channels()[name][1]  # of a turn rate, with the speed
    refuse((count not in counts, f"{key}.fields has {count} entries", f"it takes {' or '.join(map(str, counts))}"))
    unit_factor(name, source.unit, max_steer)
    without_speed = name == "steer" and (count == 2) != (source.unit in TURN_RATES)
    turn = 'a commanded turn rate takes two, turn rate and speed: fields = ["angular.z", "linear.x"], unit = "rad/s"; '
    unframed = name in ("linear_velocity", "angular_velocity") and not source.frame
    frame, unnamed = '"world", "body" or "unknown"', source.joints and len(source.joints) != count
    misplaced, late = source.origin and source.unit != GEOGRAPHIC, source.interpolation == "on change" and measured
    fields = f"{count} field{'s' * (count == 2)} in '{source.unit or 1}'"
    only, fix = 'set interpolation = "on change" for controls and actuators only', "remove it, or fix the unit"
    refuse(
        (without_speed, f"{key} has {fields}", f"{turn}other commands take one"),
        (source.meanings() and count != 1, f"{key}.values needs a single field", "remove it"),
        (unnamed, f"{key}.joints must name every field", "name each, or remove it"),
        (misplaced, f"{key}.origin is given, and the unit is not '{GEOGRAPHIC}'", fix),
        (unframed, f"{key}.frame is missing", f"set {frame}; `offpiste inspect` shows which fits"),
        (source.absolute and measured, f"{key}.absolute would drop its sign", "set it for controls only"),
        (late, f"{key} is a measurement, which changes between messages", only),
    )


SECONDS_PER_UNIT: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "d": 86_400.0}
"""Lengths of time units [s]."""


class Clock(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Clock of a log."""

    stamps: Literal["header", "receive"] = "header"  # stamps of messages in bags: from their headers, or their arrival
    column: str = ""  # time column of a table
    unit: Literal["s", "ms", "us", "ns", "d"] = "s"  # unit of that column; d for days
    # Sort samples, images and scans by their stamps (the latter two if they come at most 20 messages late); otherwise
    # those out of order are dropped.
    sort: bool = False
    max_gap: Positive = 0.5  # largest gap between samples to interpolate across; drives are cut at larger ones [s]


class Alignment(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Alignment of topics whose common clock drifts against the poses', by the speed of the wheels."""

    topics: tuple[str, ...]  # all topics stamped by that clock
    speed: ChannelSource  # speed by the wheels, on one of these topics; several fields are averaged [m/s]
    max_lag: Positive = 2.0  # lags from -max_lag / 2 to max_lag are tried [s]
