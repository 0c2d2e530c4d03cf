"""The last thing a command passes: limits of size and rate, the dead man's switch, and others who command."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from offpiste.core.conventions import DT
from offpiste.rig.outputs import CommandLimits, Enable

OTHERS_FOR = 1.0
"""How long another's command keeps ours at a stop [s]."""


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
        self._pressed_at, self._other_at = -np.inf, -np.inf
        self._last = np.array((0.0, stop, 0.0)) if last is None else np.asarray(last, np.float64)

    @property
    def steer(self) -> float:
        """Steering that was sent last [-1..1]."""
        return float(self._last[2])

    def enabled(self, pressed: bool | None, now: float) -> None:
        """The switch was heard.

        Args:
            pressed: None where its message has no such field.
            now: by the computer's steady clock [s], which no message sets; in lockstep, by its steps.
        """
        self._pressed, self._pressed_at = pressed, now

    def other(self, now: float) -> None:
        """A command of another publisher was heard."""
        self._other_at = now

    def restart(self, now: float) -> None:
        """The clock went back: the switch has to be heard again, and another who commands counts from now on."""
        self._pressed, self._pressed_at = False, -np.inf
        self._other_at = min(self._other_at, now)

    def blocked(self, now: float) -> str:
        """Why nothing but a stop may be sent; empty for nothing."""
        if now - self._other_at < OTHERS_FOR:
            return "another publisher commands the vehicle"
        if self._enable is None:
            return ""
        if now - self._pressed_at > self._enable.timeout:
            return "the enable topic is not heard"
        if self._pressed is None:
            return f"the messages of the enable topic have no number '{self._enable.field}'"
        return "" if self._pressed else "not enabled"

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
