"""The last thing a command passes: limits of size and rate, the dead man's switch, and others who command."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from offpiste.core.conventions import DT
from offpiste.rig.outputs import CommandLimits, Enable

OTHERS_FOR = 1.0
"""How long another publisher of commands, or of the enable topic, keeps the vehicle at a stop [s]."""


@dataclass(frozen=True)
class Passed:
    """What may be sent.

    Attributes:
        control: throttle, brake, steer.
        why: why it is a stop; empty where it is what was commanded.
    """

    control: Float[np.ndarray, " 3"]
    why: str = ""


class Gate:
    """Lets commands pass.

    Args:
        enable: the dead man's switch; None for none, as in shadow mode, where nothing is sent.
        stop: brake of a stop [0..1].
        last: throttle, brake, steer that were sent last, where another process sent them: rates count from there.
    """

    def __init__(
        self, limits: CommandLimits, enable: Enable | None, stop: float, last: Float[np.ndarray, " 3"] | None = None
    ) -> None:
        self._limits, self._enable, self._stop = limits, enable, stop
        self._pressed: bool | None = False
        self._pressed_at = self._other_at = self._heard_at = self._second_at = -np.inf
        self._age, self._publisher = 0.0, b""
        self._last = np.array((0.0, stop, 0.0)) if last is None else np.asarray(last, np.float64)

    @property
    def steer(self) -> float:
        """Steering that was sent last [-1..1]."""
        return float(self._last[2])

    def enabled(self, pressed: bool | None, now: float, *, age: float = 0.0, publisher: bytes = b"") -> None:
        """The switch was heard.

        Args:
            pressed: None where its message has no such field.
            now: by the computer's steady clock [s], which no message sets; in lockstep, by its steps.
            age: time since the message's stamp [s]: its time-out counts from there. It does not count where the stamp
                is further in the future than the time-out, or is no time.
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
        """A command of another publisher was heard."""
        self._other_at = now

    def restart(self, now: float) -> None:
        """The clock went back: the switch has to be heard again, and other publishers count from now on."""
        self._pressed, self._pressed_at, self._heard_at = False, -np.inf, -np.inf
        self._other_at, self._second_at = min(self._other_at, now), min(self._second_at, now)

    def blocked(self, now: float) -> str:
        """Why nothing but a stop may be sent; empty for nothing."""
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
        """Why no message of the switch counts any more."""
        if now - self._heard_at > timeout or abs(self._age) <= timeout:
            return "the enable topic is not heard"
        if not np.isfinite(self._age):
            return "the messages of the enable topic have no valid stamp"
        when = f"{timeout:g} s {'ago' if self._age > 0 else 'in the future'}"
        return f"the messages of the enable topic are stamped more than {when}: check the clocks"

    def passed(self, control: Float[np.ndarray, " 3"], speed: float, now: float, *, stopping: bool) -> Passed:
        """What may be sent of a command.

        Args:
            control: throttle, brake, steer.
            speed: of the vehicle [m/s].
            now: by the steady clock [s].
            stopping: whether the command is a stop, whose brake is applied at once.
        """
        why, limits = self.blocked(now), self._limits
        if not np.isfinite(control).all():
            why = "the command is not finite"
        if why:
            steer = float(control[2]) if np.isfinite(control[2]) else self.steer
            control, stopping = np.array((0.0, self._stop, steer)), True
        throttle, brake, steer = (float(value) for value in control)
        too_fast = not (np.isfinite(speed) and speed <= limits.speed)  # also where it is not known
        throttle = 0.0 if stopping or too_fast else min(max(throttle, 0.0), limits.throttle)
        brake = min(max(brake, 0.0), 1.0 if stopping else limits.brake)
        steer = min(max(steer, -limits.steer), limits.steer)
        before = self._last
        throttle = min(throttle, float(before[0]) + limits.throttle_rate * DT)
        if not stopping:
            turn = limits.brake_rate * DT
            brake = min(max(brake, float(before[1]) - turn), float(before[1]) + turn)
        turn = limits.steer_rate * DT
        steer = min(max(steer, float(before[2]) - turn), float(before[2]) + turn)
        self._last = np.array((throttle, brake, steer))
        return Passed(self._last.copy(), why)
