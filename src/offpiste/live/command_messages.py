"""Commands as the rig's outputs say them: topics, types, fields, signs and scales."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from offpiste.errors import RigError
from offpiste.logs.ros.writer import header
from offpiste.rig.outputs import CommandLimits, Output, OutputField
from offpiste.rig.rig import Rig
from offpiste.runtime.prediction import Prediction
from offpiste.transport.message_types import MessageTypes


@dataclass(frozen=True)
class Command:
    """What is to be sent.

    Attributes:
        time: [s].
        control: throttle, brake, steer.
        gear: 1 forward, -1 reverse.
        prediction: of the plan that is followed; None while stopping, when speed and yaw rate are zero.
    """

    time: float
    control: Float[np.ndarray, " 3"]
    gear: float = 1.0
    prediction: Prediction | None = None

    def value(self, field: OutputField, limits: CommandLimits) -> float:
        """What a field holds, in offpiste's unit.

        Args:
            limits: of speed and yaw rate; the controls are within theirs already.
        """
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
    """Makes the messages of a rig's outputs.

    Args:
        types: message types that are known.

    Raises:
        RigError: an output's type is not known, or has no such field.
    """

    def __init__(self, rig: Rig, types: MessageTypes) -> None:
        self._types, self._rig = types, rig
        for name, output in rig.outputs.items():
            if output.type not in types:
                how = "give the file of its definition in live.definitions"
                raise RigError(f"message type {output.type} is not known", where=f"outputs.{name}", how=how)
            try:
                types.store.serialize_cdr(self._message(output, Command(0.0, np.zeros(3))), output.type)
            except (AttributeError, TypeError, IndexError, ValueError, AssertionError) as error:
                reason = str(error).splitlines()[0][:100] if str(error) else "does not fit"
                how = f"give fields of {output.type}, which are numbers"
                raise RigError(f"a field is not one of its type: {reason}", where=f"outputs.{name}", how=how) from error

    @property
    def topics(self) -> dict[str, str]:
        """Topics with their types."""
        return {output.topic: output.type for output in self._rig.outputs.values()}

    def messages(self, command: Command) -> dict[str, Any]:
        """The messages of a command, by topic."""
        return {output.topic: self._message(output, command) for output in self._rig.outputs.values()}

    def _message(self, output: Output, command: Command) -> Any:
        message = self._types.empty(output.type)
        if hasattr(message, "header"):
            message.header = header(round(max(command.time, 0.0) * 1e9), output.frame)
        for path, field in output.fields.items():
            value = command.value(field, self._rig.live.limits)
            _put(message, path, field.written(value, self._rig.vehicle.max_steer))
        return message


def _put(message: Any, path: str, value: float) -> None:
    """Set a number of a message: `drive.speed`, or `axes[2]`, which makes a sequence as long as needed.

    Raises:
        AttributeError, TypeError: there is no such number.
    """
    *parents, last = path.split(".")
    for name in parents:
        message = getattr(message, name)
    name, _, index = last.removesuffix("]").partition("[")
    present = getattr(message, name)
    if index:
        if not isinstance(present, np.ndarray):
            raise TypeError(f"{name} is no sequence of numbers")
        if int(index) >= len(present):
            present = np.concatenate((present, np.zeros(int(index) + 1 - len(present), present.dtype)))
        present[int(index)] = value
        setattr(message, name, present)
    elif isinstance(present, bool):
        setattr(message, name, value > 0.5)
    elif isinstance(present, int | float):
        setattr(message, name, type(present)(value) if isinstance(present, float) else round(value))
    else:
        raise TypeError(f"{path} is no number")
