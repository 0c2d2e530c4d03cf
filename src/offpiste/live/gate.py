"""Final check of every command: limits, rates, the dead man's switch, and other publishers of commands."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.core.conventions import DT
from offpiste.rig.outputs import CommandLimits, Enable

OTHERS_FOR: Final = 1.0
"""Duration of the stop after a message of another publisher of commands or of the enable topic [s]."""


@dataclass(frozen=True)
class Checked:
    """Checked command."""

    control: Float[np.ndarray, " 3"]  # throttle, brake, steer
    why: str = ""  # reason for a stop; empty if the command passed


class Gate:
    """Limit commands, or replace them by a stop. Times are those of the monotonic clock; in a replay, of its steps.

    Args:
        enable: the dead man's switch; None for none, as in shadow mode.
        stop: brake of a stop [0..1].
        last: throttle, brake, steer last sent by a previous process, from which rates count.

    Attributes:
        checked: the last checked command.
    """

    def __init__(
        self, limits: CommandLimits, enable: Enable | None, stop: float, last: Float[np.ndarray, " 3"] | None = None
    ) -> None:
        self._limits, self._enable, self._stop = limits, enable, stop
        self._pressed: bool | None = False
        self._pressed_at = self._other_at = self._heard_at = self._second_at = -np.inf
        self._age, self._publisher = 0.0, b""
        self.checked = Checked(np.array((0.0, stop, 0.0)) if last is None else np.asarray(last, np.float64))

    @property
    def steer(self) -> float:
        """Last steering sent [-1..1]."""
        return float(self.checked.control[2])

    def enabled(self, pressed: bool | None, now: float, *, age: float = 0.0, publisher: bytes = b"") -> None:
        """Take a message of the switch.

        Args:
            pressed: None if its message lacks the field.
            now: arrival [s].
            age: time since the message's stamp [s], from which its timeout counts. A stamp that is invalid, or further
                in the future than the timeout, does not count.
            publisher: identity of its publisher.
        """
        if publisher != self._publisher and now - self._heard_at < OTHERS_FOR:
            self._second_at = now
        self._publisher, self._heard_at, self._age = publisher, now, age
        timely = self._enable is not None and age >= -self._enable.timeout
        pressed_at = now - max(age, 0.0) if timely else -np.inf
        if not pressed or pressed_at >= self._pressed_at:  # else a newer message has overtaken it
            self._pressed, self._pressed_at = pressed, pressed_at

    def other(self, now: float) -> None:
        """Take note of a command from another publisher."""
        self._other_at = now

    def blocked(self, now: float) -> str:
        """Return the reason why only a stop may be sent; empty if there is none."""
        if now - self._other_at < OTHERS_FOR:
            return "another publisher commands the vehicle"
        if self._enable is None:
            return ""
        if now - self._second_at < OTHERS_FOR:
            return "more than one publisher of the enable topic"
        if now - self._pressed_at > self._enable.timeout:
            return self._why_late(now, self._enable.timeout)
        if self._pressed is None:
            return f"the messages of the enable topic have no number '{self._enable.field}'"
        return "" if self._pressed else "not enabled"

    def _why_late(self, now: float, timeout: float) -> str:
        """Return the reason why no message of the switch counts any more."""
        if now - self._heard_at > timeout or abs(self._age) <= timeout:
            return "the enable topic is not heard"
        if not np.isfinite(self._age):
            return "the messages of the enable topic have no valid stamp"
        when = f"{timeout:g} s {'ago' if self._age > 0 else 'in the future'}"
        return f"the messages of the enable topic are stamped more than {when}: check the clocks"

    def check(self, control: Float[np.ndarray, " 3"], speed: float, now: float, *, stopping: bool) -> Checked:
        """Check a command.

        Args:
            control: throttle, brake, steer.
            speed: of the vehicle [m/s].
            stopping: whether the command is a stop, whose brake is applied at once.
        """
        why, limits = self.blocked(now), self._limits
        if not np.isfinite(control).all():
            why = "the command is not finite"
        if why:
            steer = float(control[2]) if np.isfinite(control[2]) else self.steer
            control, stopping = np.array((0.0, self._stop, steer)), True
        throttle, brake, steer = (float(value) for value in control)
        too_fast = not (np.isfinite(speed) and speed <= limits.speed)  # also if the speed is unknown
        throttle = 0.0 if stopping or too_fast else min(max(throttle, 0.0), limits.throttle)
        brake = min(max(brake, 0.0), 1.0 if stopping else limits.brake)
        steer = min(max(steer, -limits.steer), limits.steer)
        before = self.checked.control
        throttle = min(throttle, float(before[0]) + limits.throttle_rate * DT)
        if not stopping:
            turn = limits.brake_rate * DT
            brake = min(max(brake, float(before[1]) - turn), float(before[1]) + turn)
        turn = limits.steer_rate * DT
        steer = min(max(steer, float(before[2]) - turn), float(before[2]) + turn)
        self.checked = Checked(np.array((throttle, brake, steer)), why)
        return self.checked
