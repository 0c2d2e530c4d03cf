"""Command messages to the vehicle, and their limits, timeouts and enabling switch."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final, Literal, get_args

import msgspec
import numpy as np
from msgspec.structs import replace

from offpiste.core.errors import RigError, did_you_mean
from offpiste.rig.channels import TURN_RATES, unit_factor

Quantity = Literal["throttle", "brake", "steer", "gear", "pedal", "speed", "yaw_rate", "constant"]
"""Quantities that a field can hold: a control, the pedal (throttle minus brake), or a planned state."""
_CHANNELS: Final = {"pedal": "throttle", "speed": "linear_velocity"}
"""Channels that define the units of quantities that are not channels."""
_LIMITED: Final = {
    "throttle": {"throttle", "pedal"},
    "brake": {"brake", "pedal"},
    "steer": {"steer"},
    "throttle_rate": {"throttle", "pedal"},
    "brake_rate": {"brake", "pedal"},
    "steer_rate": {"steer"},
    "speed": {"speed", "throttle", "pedal"},
    "yaw_rate": {"yaw_rate"},
}
"""Quantities affected by each of `CommandLimits`."""
_TIMEOUTS: Final = {
    "state": (0.04, 1.0),
    "scan": (0.1, 5.0),
    "scan_limit": (0.1, 5.0),
    "image": (0.1, 30.0),
    "plan": (0.2, 1.0),
    "ahead": (0.01, 1.0),
}
"""Smallest and largest of `Timeouts` [s]."""
_PATH: Final = re.compile(r"[a-z][a-zA-Z0-9_]*(\.[a-z][a-zA-Z0-9_]*)*(\[\d{1,3}\])?")
_TYPE: Final = re.compile(r"[a-zA-Z]\w*/msg/[A-Z]\w*")
_TOPIC: Final = re.compile(r"(/[a-zA-Z_]\w*)+")


class OutputField(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Field of a command message; the entries mean the same as for a `ChannelSource` that reads it back."""

    of: Quantity
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    sign: Literal[-1, 1] = 1
    value: float = 0.0  # value of a constant
    ahead: float = 0.2  # look-ahead on the plan for speed and yaw rate [s]
    clip: tuple[float, float] | None = None  # interval to which the field is limited

    def written(self, value: float, max_steer: float) -> float:
        """Return the field for a value in the internal unit."""
        if self.of == "constant":
            return self.value
        factor = unit_factor(_CHANNELS.get(self.of, self.of), self.unit, max_steer)
        field = (self.sign * value / factor - self.offset) / self.scale
        return field if self.clip is None else min(max(field, self.clip[0]), self.clip[1])


class Output(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Topic with commands."""

    topic: str
    type: str  # message type, such as `ackermann_msgs/msg/AckermannDriveStamped`
    fields: dict[str, OutputField]  # by their paths, such as `drive.speed` or `axes[2]`; all others are zero or empty
    frame: str = "base_link"  # frame of the header, if the type has one


class Enable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Dead man's switch: commands are sent only while its messages arrive and it is pressed."""

    topic: str
    field: str = "data"  # number or boolean; above 0.5 is pressed
    timeout: float = 0.3  # largest age of a message [s]


class CommandLimits(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of sent commands, regardless of the plan.

    Attributes:
        throttle, brake, steer: largest commands; the brake of a stop is not limited.
        throttle_rate, brake_rate, steer_rate: largest rates of change [1/s]; the throttle is released, and the brake of
            a stop applied, without delay.
        speed: largest speed in either direction [m/s]; above it, the throttle is released.
        yaw_rate: largest yaw rate [rad/s].
    """

    throttle: float = 1.0
    brake: float = 1.0
    steer: float = 1.0
    throttle_rate: float = 4.0
    brake_rate: float = 8.0
    steer_rate: float = 4.0
    speed: float = np.inf
    yaw_rate: float = np.inf


@dataclass(frozen=True)
class Timeouts:
    """Largest ages of inputs [s]."""

    state: float = 0.1  # age of the vehicle's state beyond which it makes a controlled stop
    scan: float = 0.5  # age of scans beyond which it slows down
    scan_limit: float = 1.0  # age of scans beyond which it makes a controlled stop
    image: float = 1.5  # age of images beyond which it continues in degraded mode, on the features in the map
    plan: float = 0.5  # age of the followed plan beyond which it makes a controlled stop
    ahead: float = 0.1  # messages stamped further ahead of the clock are dropped


class Live(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings for driving on a vehicle.

    Attributes:
        enable: switch; without it, commands are always sent.
        types: message types of topics whose Zenoh keys do not state them (zenoh-bridge-ros2dds).
        definitions: files PACKAGE/msg/NAME.msg of types unknown to rosbags, relative to the rig file.
    """

    enable: Enable | None = None
    limits: CommandLimits = CommandLimits()
    timeouts: Timeouts = Timeouts()
    types: dict[str, str] = {}
    definitions: tuple[str, ...] = ()

    def beside(self, folder: Path) -> "Live":
        """Return the same settings with absolute paths of definitions."""
        return replace(self, definitions=tuple(str(folder / name) for name in self.definitions))


def check_names(rig: Mapping[str, Any]) -> None:
    """Refuse unknown quantities and timeouts in parsed TOML, for which msgspec's messages lack the name."""
    live = rig.get("live")
    timeouts = live.get("timeouts") if isinstance(live, dict) else None
    for name in timeouts if isinstance(timeouts, dict) else {}:
        if name not in (there := [each.name for each in fields(Timeouts)]):
            how = f"{did_you_mean(name, there)}give {', '.join(there)}"
            raise RigError(f"unknown timeout live.timeouts.{name}", how=how)
    outputs = rig.get("outputs")
    for name, output in (outputs if isinstance(outputs, dict) else {}).items():
        written = output.get("fields") if isinstance(output, dict) else None
        for path, field in (written if isinstance(written, dict) else {}).items():
            held = field.get("of") if isinstance(field, dict) else None
            if isinstance(held, str) and held not in get_args(Quantity):
                what = f"outputs.{name}.fields.\"{path}\" holds '{held}'"
                how = f"{did_you_mean(held, get_args(Quantity))}give one of {', '.join(get_args(Quantity))}"
                raise RigError(what, how=how)


def can_reverse(outputs: Mapping[str, Output]) -> bool:
    """Return whether commands include a direction of travel: a gear, or a signed speed."""
    return any(field.of in ("gear", "speed") for output in outputs.values() for field in output.fields.values())


def check_outputs(outputs: Mapping[str, Output], live: Live, max_steer: float) -> None:
    """Refuse impossible numbers, names and types."""
    for name, output in outputs.items():
        key = f"outputs.{name}"
        _check_topic(f"{key}.topic", output.topic)
        _check_type(f"{key}.type", output.type)
        if not output.fields:
            raise RigError(f"{key}.fields is empty", how='give each field, such as "drive.speed" = { of = "speed" }')
        for path, field in output.fields.items():
            _check_field(f'{key}.fields."{path}"', path, field, max_steer)
    if len({output.topic for output in outputs.values()}) < len(outputs):
        raise RigError("two outputs have one topic", how="put their fields into one of them")
    for topic, msgtype in live.types.items():
        _check_topic("live.types", topic)
        _check_type(f'live.types."{topic}"', msgtype)
    if live.enable is not None:
        _check_topic("live.enable.topic", live.enable.topic)
        if not _PATH.fullmatch(live.enable.field) or not 0 < live.enable.timeout < np.inf:
            raise RigError("live.enable: invalid field or timeout", how='give field = "data" and seconds above zero')
    for name, seconds in vars(live.timeouts).items():
        least, most = _TIMEOUTS[name]
        if not least <= seconds <= most:
            raise RigError(f"live.timeouts.{name} is {seconds} s", how=f"give {least:g} to {most:g}")
    if live.timeouts.scan > live.timeouts.scan_limit:
        raise RigError("live.timeouts.scan is above scan_limit", how="raise scan_limit, too, or lower scan")
    for limit in CommandLimits.__struct_fields__:
        number, limited = getattr(live.limits, limit), _LIMITED[limit]
        if not number > 0 or (limit in ("throttle", "brake", "steer") and number > 1):
            how = "give a number above zero" + ("" if "_" in limit or limit == "speed" else ", and at most 1")
            raise RigError(f"live.limits.{limit} is {number}", how=how)
        held = {field.of for output in outputs.values() for field in output.fields.values()}
        if held and not held & limited and number != getattr(CommandLimits(), limit):
            how = f"leave it out, or send one of {', '.join(sorted(limited))}"
            raise RigError(f"live.limits.{limit} has no effect on any output", how=how)


def _check_topic(key: str, topic: str) -> None:
    if not _TOPIC.fullmatch(topic):
        raise RigError(f"{key}: '{topic}' is not a topic", how="give a name such as /vehicle/command")


def _check_type(key: str, msgtype: str) -> None:
    if not _TYPE.fullmatch(msgtype):
        raise RigError(f"{key}: '{msgtype}' is not a message type", how="give one such as geometry_msgs/msg/Twist")


def _check_field(key: str, path: str, field: OutputField, max_steer: float) -> None:
    if not _PATH.fullmatch(path):
        raise RigError(f"{key} is not a field path", how="give one such as drive.steering_angle or axes[2]")
    if not np.isfinite([field.scale, field.offset, field.value]).all() or field.scale == 0:
        raise RigError(f"{key}: scale, offset or value is not usable", how="give finite numbers, and no scale of zero")
    if not 0 <= field.ahead <= 5:
        raise RigError(f"{key}.ahead is {field.ahead}", how="give seconds within the plan: 0 to 5")
    if field.clip is not None and not field.clip[0] < field.clip[1]:
        raise RigError(f"{key}.clip is not an interval", how="give the lowest and the highest value")
    if field.of == "steer" and field.unit in TURN_RATES:
        raise RigError(f"{key}: '{field.unit}' is a unit of turn rates", how='send it with of = "yaw_rate"')
    try:
        field.written(0.0, max_steer)
    except RigError as error:
        raise RigError(f"{key}: {error.what}", how=error.how) from None
