"""Messages of commands, as described by the rig's outputs."""

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Float
from msgspec.structs import replace
from rosbags.serde import SerdeError

from offpiste.core.errors import RigError
from offpiste.logs.ros.writer import header, make, quaternion, vector
from offpiste.rig.outputs import CommandLimits, Output, OutputField
from offpiste.rig.rig import Rig
from offpiste.runtime.prediction import Prediction
from offpiste.transport.message_types import MessageTypes
from offpiste.transport.zenoh_transport import ZenohTransport

_BEYOND: Final = (100.0, 20.0)
"""Upper bounds of speed [m/s] and yaw rate [rad/s] in any plan, for rigs without limits."""


@dataclass(frozen=True)
class Command:
    """Command to the vehicle."""

    time: float  # [s]
    control: Float[np.ndarray, " 3"]  # throttle, brake, steer
    gear: float = 1.0  # 1 forward, -1 reverse
    prediction: Prediction | None = None  # of the followed plan; None while stopping: speed and yaw rate are zero

    def value(self, field: OutputField, limits: CommandLimits) -> float:
        """Return the value of a field in offpiste's unit, with speed and yaw rate limited."""
        throttle, brake, steer = (float(value) for value in self.control)
        known = {"throttle": throttle, "brake": brake, "steer": steer, "gear": self.gear, "pedal": throttle - brake}
        if field.of in known:
            return known[field.of]
        if field.of == "constant" or self.prediction is None:
            return 0.0
        state = self.prediction.at(self.time + field.ahead)
        slower = min(1.0, limits.speed / max(abs(float(state[3])), 1e-9))  # on the same curve
        if field.of == "speed":
            return slower * float(state[3])
        return min(max(slower * float(state[5]), -limits.yaw_rate), limits.yaw_rate)


class CommandMessages:
    """Create the messages of a rig's outputs.

    Raises:
        RigError: the type of an output is unknown, lacks a field, or a field cannot hold every possible value.
    """

    def __init__(self, rig: Rig, types: MessageTypes) -> None:
        self._types, self._rig = types, rig
        for name, output in rig.outputs.items():
            if output.type not in types:
                how = "give the file of its definition in live.definitions"
                raise RigError(f"message type {output.type} is unknown", where=f"outputs.{name}", how=how)
            for path, field in output.fields.items():
                for command in _ends(rig.live.limits):
                    self._check(name, replace(output, fields={path: field}), command)

    @property
    def topics(self) -> dict[str, str]:
        """Topics with their types."""
        return {output.topic: output.type for output in self._rig.outputs.values()}

    def messages(self, command: Command) -> dict[str, Any]:
        """Return the messages of a command, by topic."""
        return {output.topic: self._message(output, command) for output in self._rig.outputs.values()}

    def sender(self, transport: ZenohTransport) -> Callable[[Command], None]:
        """Return a function that publishes a command."""
        publish = {topic: transport.publisher(topic, msgtype) for topic, msgtype in self.topics.items()}

        def send(command: Command) -> None:
            for topic, message in self.messages(command).items():
                publish[topic](message)

        return send

    def _check(self, name: str, output: Output, command: Command) -> None:
        """Raise `RigError` if the only field of an output cannot be sent."""
        where, ((path, field),) = f"outputs.{name}", output.fields.items()
        try:
            self._types.store.serialize_cdr(self._message(output, command), output.type)
        except (struct.error, OverflowError) as error:
            held = field.written(command.value(field, self._rig.live.limits), self._rig.vehicle.max_steer)
            how = "set a scale, offset or clip with which all values fit (speed and yaw_rate: or live.limits)"
            raise RigError(f"'{path}' cannot hold {held:g}: {error}", where=where, how=how) from error
        except (AttributeError, TypeError, IndexError, ValueError, AssertionError, SerdeError) as error:
            reason = str(error).splitlines()[0][:100] if str(error) else "does not fit"
            how = f"give numeric fields of {output.type}"
            raise RigError(f"invalid field: {reason}", where=where, how=how) from error

    def _message(self, output: Output, command: Command) -> Any:
        message = self._types.empty(output.type)
        if hasattr(message, "header"):
            message.header = header(round(max(command.time, 0.0) * 1e9), output.frame)
        for path, field in output.fields.items():
            value = command.value(field, self._rig.live.limits)
            _put(message, path, field.written(value, self._rig.vehicle.max_steer))
        return message


def joy_message(nanoseconds: int, control: Float[np.ndarray, " n"]) -> Any:
    """Return a sensor_msgs/Joy whose axes are throttle, brake, steer."""
    axes, buttons = control.astype(np.float32), np.zeros(0, np.int32)
    return make("sensor_msgs/Joy", header=header(nanoseconds, "base_link"), axes=axes, buttons=buttons)


def path_message(places: Float[np.ndarray, "P 3"], yaw: Float[np.ndarray, " P"], nanoseconds: int, frame: str) -> Any:
    """Return a nav_msgs/Path."""
    head, poses = header(nanoseconds, frame), []
    for place, half in zip(places.tolist(), (yaw / 2).tolist(), strict=True):
        turn = quaternion((0.0, 0.0, math.sin(half), math.cos(half)))
        pose = make("geometry_msgs/Pose", position=vector(place, "geometry_msgs/Point"), orientation=turn)
        poses.append(make("geometry_msgs/PoseStamped", header=head, pose=pose))
    return make("nav_msgs/Path", header=head, poses=poses)


def _ends(limits: CommandLimits) -> tuple[Command, Command]:
    """Return commands with the lowest and the highest value of every quantity."""
    speed, yaw_rate = (min(pair) for pair in zip((limits.speed, limits.yaw_rate), _BEYOND, strict=True))
    state = np.array([[0.0, 0.0, 0.0, speed, 0.0, yaw_rate]])
    lowest = Command(0.0, np.array((0.0, 1.0, -limits.steer)), -1.0, Prediction(0.0, -state))
    return lowest, Command(0.0, np.array((limits.throttle, 0.0, limits.steer)), 1.0, Prediction(0.0, state))


def _put(message: Any, path: str, value: float) -> None:
    """Set a number of a message: `drive.speed`, or `axes[2]`, which extends a sequence as needed.

    Raises:
        AttributeError, TypeError: the field is missing or not a number.
        OverflowError: an element cannot hold the value; for other fields, serialising the message raises.
    """
    *parents, last = path.split(".")
    for name in parents:
        message = getattr(message, name)
    name, _, index = last.removesuffix("]").partition("[")
    present = getattr(message, name)
    if index:
        if not isinstance(present, np.ndarray):
            raise TypeError(f"{name} is not a sequence of numbers")
        if int(index) >= len(present):
            present = np.concatenate((present, np.zeros(int(index) + 1 - len(present), present.dtype)))
        number = _alike(present[int(index)].item(), value)
        if present.dtype.kind in "iu" and not np.iinfo(present.dtype).min <= number <= np.iinfo(present.dtype).max:
            raise OverflowError(f"its elements have type {present.dtype}")
        present[int(index)] = number
        setattr(message, name, present)
    elif isinstance(present, int | float):
        setattr(message, name, _alike(present, value))
    else:
        raise TypeError(f"{path} is not a number")


def _alike(present: int | float, value: float) -> int | float:
    """Convert a value to the kind of the present one: boolean, integer or float."""
    if isinstance(present, bool):
        return value > 0.5
    return round(value) if isinstance(present, int) else value
