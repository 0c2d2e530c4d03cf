"""Command messages to the vehicle, and their limits, timeouts and enabling switch."""

from collections.abc import Mapping
from typing import Annotated, Final, Literal

import msgspec
import numpy as np
from msgspec import Meta

from offpiste.core.errors import RigError
from offpiste.rig.channels import TURN_RATES, unit_factor
from offpiste.rig.schema import FieldPath, Finite, Fraction, MessageType, Positive, TopicName, refuse

Quantity = Literal["throttle", "brake", "steer", "gear", "pedal", "speed", "yaw_rate", "constant"]
"""Quantities that a field can hold: a control, the pedal (throttle minus brake), or a planned state."""
_CHANNELS: Final = {"pedal": "throttle", "speed": "linear_velocity"}
"""Channels that define the units of quantities that are not channels."""
_LIMITED: Final = {
    "throttle": {"throttle", "pedal"},
    "brake": {"brake", "pedal"},
    "steer": {"steer"},
    "speed": {"speed", "throttle", "pedal"},
    "yaw_rate": {"yaw_rate"},
}
"""Quantities affected by each of `CommandLimits`, or by the limit of its rate."""


class OutputField(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Field of a command message; the entries mean the same as for a `ChannelSource` that reads it back."""

    of: Quantity
    unit: str = ""
    scale: Finite = 1.0
    offset: Finite = 0.0
    sign: Literal[-1, 1] = 1
    value: Finite = 0.0  # value of a constant
    ahead: Annotated[float, Meta(ge=0.0, le=5.0)] = 0.2  # look-ahead on the plan for speed and yaw rate [s]
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

    topic: TopicName
    type: MessageType
    # By their paths, such as `drive.speed` or `axes[2]`; all others are zero or empty.
    fields: Annotated[dict[FieldPath, OutputField], Meta(min_length=1)]
    frame: str = "base_link"  # frame of the header, if the type has one


class Enable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Dead man's switch: commands are sent only while its messages arrive and it is pressed."""

    topic: TopicName
    field: FieldPath = "data"  # number or boolean; above 0.5 is pressed
    timeout: Positive = 0.3  # largest age of a message [s]


class CommandLimits(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of sent commands, regardless of the plan; releasing the throttle and braking to a stop are not limited."""

    throttle: Fraction = 1.0  # throttle, brake, steer: largest commands
    brake: Fraction = 1.0
    steer: Fraction = 1.0
    throttle_rate: Positive = 4.0  # throttle_rate, brake_rate, steer_rate: largest rates of change [1/s]
    brake_rate: Positive = 8.0
    steer_rate: Positive = 4.0
    speed: Annotated[float, Meta(gt=0.0)] = np.inf  # in either direction [m/s]; above it, the throttle is released
    yaw_rate: Annotated[float, Meta(gt=0.0)] = np.inf  # [rad/s]


class Timeouts(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Largest ages of inputs [s]; messages stamped further `ahead` of the clock are dropped."""

    state: Annotated[float, Meta(ge=0.04, le=1.0)] = 0.1  # age of the vehicle's state beyond which it stops
    scan: Annotated[float, Meta(ge=0.1, le=5.0)] = 0.5  # age of scans beyond which it slows down
    scan_limit: Annotated[float, Meta(ge=0.1, le=5.0)] = 1.0  # age of scans beyond which it stops
    image: Annotated[float, Meta(ge=0.1, le=30.0)] = 1.5  # age of images beyond which only features in the map count
    plan: Annotated[float, Meta(ge=0.2, le=1.0)] = 0.5  # age of the followed plan beyond which it stops
    ahead: Annotated[float, Meta(ge=0.01, le=1.0)] = 0.1


class Live(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Settings for driving on a vehicle."""

    enable: Enable | None = None  # switch; without it, commands are always sent
    limits: CommandLimits = CommandLimits()
    timeouts: Timeouts = Timeouts()
    types: dict[TopicName, MessageType] = {}  # of topics whose Zenoh keys do not state them (zenoh-bridge-ros2dds)
    definitions: tuple[str, ...] = ()  # files PACKAGE/msg/NAME.msg of types unknown to rosbags, beside the rig file


def can_reverse(outputs: Mapping[str, Output]) -> bool:
    """Return whether commands include a direction of travel: a gear, or a signed speed."""
    return any(field.of in ("gear", "speed") for output in outputs.values() for field in output.fields.values())


def check_outputs(outputs: Mapping[str, Output], live: Live, max_steer: float) -> None:
    """Refuse contradictions that types do not exclude."""
    for name, output in outputs.items():
        for path, field in output.fields.items():
            _check_field(f'outputs.{name}.fields."{path}"', field, max_steer)
    one_topic = len({output.topic for output in outputs.values()}) < len(outputs)
    never = live.timeouts.scan > live.timeouts.scan_limit
    refuse(
        (one_topic, "two outputs use the same topic", "put their fields into one of them"),
        (never, "live.timeouts.scan is above scan_limit", "raise scan_limit, too, or lower scan"),
    )
    held = {field.of for output in outputs.values() for field in output.fields.values()}
    for limit in CommandLimits.__struct_fields__:
        limited = _LIMITED.get(limit) or _LIMITED[limit.removesuffix("_rate")]
        changed = getattr(live.limits, limit) != getattr(CommandLimits(), limit)
        how = f"leave it out, or send one of {', '.join(sorted(limited))}"
        refuse((held and changed and not held & limited, f"live.limits.{limit} has no effect on any output", how))


def _check_field(key: str, field: OutputField, max_steer: float) -> None:
    turns, clip = field.of == "steer" and field.unit in TURN_RATES, field.clip
    refuse(
        (field.scale == 0, f"{key}.scale is 0", "give another number"),
        (clip and not clip[0] < clip[1], f"{key}.clip is not an interval", "give the lowest and the highest value"),
        (turns, f"{key}: '{field.unit}' is a unit of turn rates", 'send it with of = "yaw_rate"'),
    )
    try:
        field.written(0.0, max_steer)
    except RigError as error:
        raise RigError(f"{key}: {error.what}", how=error.how) from None
