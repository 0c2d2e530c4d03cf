"""Which topics and fields feed which channel, in what unit, sign and frame, by which clock."""

from collections.abc import Collection, Mapping
from typing import Final, Literal

import msgspec
import numpy as np

from offpiste.core.channels import all_actuators, all_controls
from offpiste.core.errors import RigError, did_you_mean

GEOGRAPHIC: Final = "lat lon"
"""Unit of positions in degrees of latitude and longitude, with the height in metres."""
REPEATED: Final = 0.25
"""A value that stays is measured again after this time [s], as of a vehicle that stands (`ChannelSource.repeats`)."""
POSE: Final = ("position", "orientation", "yaw")
"""Channels of the pose: no log is usable without a position and a heading, so they are not declared absent."""

_UNITS: dict[str, dict[str, float]] = {
    "m": {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048, GEOGRAPHIC: 111_195.0},  # of the last: about, and northward
    "rad": {"rad": 1.0, "deg": np.pi / 180, "mrad": 0.001},
    "m/s": {"m/s": 1.0, "km/h": 1 / 3.6, "mph": 0.44704, "kn": 0.514444},
    "rad/s": {"rad/s": 1.0, "deg/s": np.pi / 180, "rev/min": 2 * np.pi / 60},
    "1000 rev/min": {"1000 rev/min": 1.0, "rev/min": 0.001, "rad/s": 60 / (2 * np.pi) / 1000},
    "1": {"1": 1.0, "percent": 0.01, "permille": 0.001},
}
"""Factors from the units a log may use to the one offpiste uses (the key)."""

ANGLES: Final[Mapping[str, float]] = _UNITS["rad"]
"""Units of angles, in which a steering command may be recorded as well (`unit_factor`)."""
TURN_RATES: Final[Mapping[str, float]] = _UNITS["rad/s"]
"""Units of turn rates, which a steering command may be, beside a speed (`ChannelSource.turns`)."""

OTHER_CHANNELS: dict[str, tuple[str, tuple[int, ...]]] = {
    "position": ("m", (2, 3)),
    "orientation": ("1", (4,)),
    "yaw": ("rad", (1,)),
    "linear_velocity": ("m/s", (2, 3)),
    "angular_velocity": ("rad/s", (3,)),
    "yaw_rate": ("rad/s", (1,)),
    "wheel_speed": ("m/s", (1, 2, 4)),
}
"""Channels besides controls and actuators: name -> (unit inside offpiste, allowed numbers of fields)."""


def declare_channel(
    name: str, *, unit: str, fields: tuple[int, ...] = (1,), units: Mapping[str, float] | None = None
) -> None:
    """Let rigs name one more channel; controls and actuators are declared in `offpiste.core.channels`.

    Args:
        unit: inside offpiste.
        fields: allowed numbers of fields.
        units: factors from the units a log may use to `unit`, where that is a new one.

    Raises:
        RigError: there is a channel of this name.
    """
    if name in known_channels():
        raise RigError(f"there are two channels called '{name}'", how="give one of them another name")
    OTHER_CHANNELS[name] = unit, fields
    _UNITS.setdefault(unit, {unit: 1.0}).update(units or {})


def known_channels() -> dict[str, tuple[str, tuple[int, ...]]]:
    """Every channel that a rig can give: name -> (unit inside offpiste, allowed numbers of fields)."""
    single = (1,)
    controls = {control.name: (control.unit, single) for control in all_controls()}
    actuators = {actuator.channel: (actuator.unit, single) for actuator in all_actuators()}
    return OTHER_CHANNELS | controls | actuators


class Wrap(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A counter that wraps around: raw values above `above` are `period` too large."""

    above: float
    period: float


class ChannelSource(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Source of a channel: value = sign * ((raw, unwrapped) * scale + offset), then from `unit`.

    Of an orientation only `offset` counts: the body is turned by it about its z axis, against the frame whose
    orientation the log has [rad].

    Attributes:
        topic: topic, folder or, in a table, "" for the table itself.
        fields: fields or columns in the channel's order: x y z, or a quaternion as x y z w; of a steering that is
            commanded as a turn rate, as by geometry_msgs/Twist, that and the speed [m/s].
        frame: for velocities: "world", "body", or "unknown" (then the pose is differentiated instead).
        delay: how much later than it happened a sample is stamped [s].
        valid: values outside of it (after conversion) are measurement faults and dropped.
        clip: values are limited to this interval.
        absolute: the size of a control whose sign says a direction, as of a commanded speed; before `clip`.
        values: what recorded values stand for, of channels of one field; keys are numbers, true, false, or the single
            letter whose character code is recorded. The other entries apply to what they stand for.
        joints: names of the joints of sensor_msgs/JointState whose entries `fields` are: they are found by these names,
            wherever a message, or another log, has them.
        origin: latitude and longitude of x = y = 0, for a position in these [degrees], so that drives share their
            coordinates; by default a place near the first one of each log.
        interpolation: between samples: a measurement is interpolated, a command holds; one that is published only when
            it changes holds however long that takes ("on change").
        repeats: "drop": samples equal to the one before are left out, but for one every `REPEATED`: tables hold the
            last value of a slower sensor.
    """

    fields: tuple[str, ...]
    topic: str = ""
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    sign: Literal[-1, 1] = 1
    delay: float = 0.0
    frame: Literal["", "world", "body", "unknown"] = ""
    wrap: Wrap | None = None
    valid: tuple[float, float] | None = None
    clip: tuple[float, float] | None = None
    absolute: bool = False
    values: dict[str, float] = {}
    joints: tuple[str, ...] = ()
    origin: tuple[float, float] | None = None
    interpolation: Literal["linear", "hold", "on change"] = "linear"
    repeats: Literal["keep", "drop"] = "keep"

    @property
    def holds(self) -> bool:
        """Whether a sample is valid until the next."""
        return self.interpolation != "linear"

    @property
    def turns(self) -> bool:
        """Whether a steering is commanded as a turn rate: the angle is that of a bicycle which turns so.

        The other entries apply to the turn rate.
        """
        return len(self.fields) == 2 and self.unit in TURN_RATES

    def meanings(self) -> dict[float, float]:
        """Recorded numbers and what they stand for (`values`).

        Raises:
            RigError: a key is neither a number, a boolean nor a single letter.
        """
        return {_recorded(key): value for key, value in self.values.items()}


def _recorded(key: str) -> float:
    """The number that a log has for a key of `ChannelSource.values`."""
    if key in ("true", "false"):
        return float(key == "true")
    try:
        return float(key)
    except ValueError:
        if len(key) == 1:
            return float(ord(key))
        how = 'write recorded numbers, "true", "false" or single letters, such as values = { "R" = -1, "D" = 1 }'
        raise RigError(f"values has a key '{key}' that is no recorded number", how=how) from None


def topic_in_words(topic: str) -> str:
    """A topic for people; that of a table has no name."""
    return f"topic '{topic}'" if topic else "the table"


def unit_factor(channel: str, unit: str, max_steer: float = 0.0) -> float:
    """Factor from a log's unit to offpiste's unit of this channel; an empty unit means offpiste's own.

    Args:
        max_steer: of the rig [rad], over which a steering command is that is an angle of the road wheels; for a
            turn rate it says only that the vehicle steers, and the factor is that to rad/s.

    Raises:
        RigError: the unit does not measure this channel.
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
            angle = "give vehicle.max_steer, over which an angle of the road wheels is" if unit in ANGLES else ""
            how = angle or f"{how}; or, of an angle of the road wheels, {', '.join(ANGLES)}"
        raise RigError(f"unit '{unit}' does not measure {channel}", how=how)
    return known[unit or own]


def undeclared(given: Collection[str]) -> list[str]:
    """Channels of controls and actuators that a rig must declare absent, or give, besides those that it gives."""
    names = [control.name for control in all_controls() if control.declared]
    names += [
        actuator.channel
        for actuator in all_actuators()
        if actuator.declared and not any(a.name == actuator.rate_of and a.channel in given for a in all_actuators())
    ]
    return [name for name in names if name not in given]


def check_channels(channels: Mapping[str, ChannelSource], absent: Collection[str], max_steer: float) -> None:
    """Refuse unknown, contradicting and missing channels.

    Args:
        max_steer: of the rig [rad].

    Raises:
        RigError: which channel, and how to fix it.
    """
    known = known_channels()
    for name, source in channels.items():
        if name not in known:
            how = f"{did_you_mean(name, known)}channels are: {', '.join(known)}"
            raise RigError(f"unknown channel '{name}'", how=how)
        widths = (1, 2) if name == "steer" else known[name][1]  # of a turn rate, with the speed
        if len(source.fields) not in widths:
            raise RigError(
                f"channels.{name}.fields has {len(source.fields)} entries",
                how=f"it takes {' or '.join(map(str, widths))}",
            )
        unit_factor(name, source.unit, max_steer)
        if name == "steer" and (len(source.fields) == 2) != (source.unit in TURN_RATES):
            count = "2 fields" if len(source.fields) == 2 else "1 field"
            raise RigError(
                f"channels.steer has {count} in '{source.unit or 1}'",
                how='a commanded turn rate takes two, that and the speed: fields = ["angular.z", "linear.x"], '
                'unit = "rad/s"; all else takes one',
            )
        if source.meanings() and len(source.fields) != 1:
            raise RigError(f"channels.{name}.values needs a single field", how="remove it")
        if source.joints and len(source.joints) != len(source.fields):
            raise RigError(f"channels.{name}.joints has to name each of its fields", how="name each, or remove it")
        if (at := source.origin) is not None and (source.unit != GEOGRAPHIC or abs(at[0]) > 90 or abs(at[1]) > 360):
            raise RigError(
                f"channels.{name}.origin is no place of positions in '{GEOGRAPHIC}'",
                how="give latitude and longitude in degrees, such as origin = [48.15, 11.58], or remove it",
            )
        if name in ("linear_velocity", "angular_velocity") and not source.frame:
            raise RigError(
                f"channels.{name}.frame is missing",
                how='say "world", "body" or "unknown"; `offpiste inspect` shows which fits',
            )
        if source.absolute and name in OTHER_CHANNELS:
            raise RigError(f"channels.{name}.absolute: its sign is a part of it", how="give it to controls alone")
        if source.interpolation == "on change" and name in OTHER_CHANNELS:
            raise RigError(
                f"channels.{name} is measured, and changes while nothing is published",
                how='give interpolation = "on change" to controls and actuators alone',
            )
        if name in absent:
            raise RigError(f"channel '{name}' is both given and declared absent", how="remove one of the two")
    unknown = set(absent) - set(known)
    if unknown:
        how = f"{did_you_mean(min(unknown), known)}channels are: {', '.join(known)}"
        raise RigError(f"absent: unknown channel '{min(unknown)}'", how=how)
    if "position" not in channels:
        raise RigError("channels.position is missing", how="every rig needs the vehicle's position")
    if not {"orientation", "yaw"} & set(channels):
        raise RigError("channels.orientation or channels.yaw is missing", how="every rig needs the vehicle's heading")
    for name in undeclared(channels):
        if name not in absent:
            raise RigError(
                f"channel '{name}' is neither given nor declared absent",
                how=f"add [channels.{name}], or '{name}' to absent",
            )


SECONDS_PER_UNIT: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "d": 86_400.0}
"""Length of the units of stamps [s]."""


class Clock(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Stamps of a log, and what counts as a gap.

    Attributes:
        stamps: of messages in bags: their headers', or their arrival.
        column: a table's time column.
        unit: of that column: s, ms, us, ns, or d for days.
        sort: samples, images and scans are put in the order of their stamps (the latter two where they come at most 20
            messages late); otherwise those out of order are dropped.
        max_gap: no interpolation between samples further apart; a drive is cut there [s].
    """

    stamps: Literal["header", "receive"] = "header"
    column: str = ""
    unit: Literal["s", "ms", "us", "ns", "d"] = "s"
    sort: bool = False
    max_gap: float = 0.5


class Alignment(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Topics whose common clock drifts against the poses'; the wheels' speed shows by how much.

    Attributes:
        topics: all topics stamped by that clock.
        speed: the vehicle's speed by the wheels, among them; several fields are averaged [m/s after conversion].
        max_lag: lags from minus half of it to all of it are tried [s].
    """

    topics: tuple[str, ...]
    speed: ChannelSource
    max_lag: float = 2.0
