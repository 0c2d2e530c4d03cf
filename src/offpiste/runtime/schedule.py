"""Schedule of controls: each plan acts once its latency has passed, and replaces the one before it.

`Launch` adds throttle to the plan where the vehicle is meant to drive and hardly moves. Models learn from windows that
start above `conventions.MIN_EVALUATION_SPEED`, and expect a vehicle at a standstill to follow any throttle. A torque
that does not overcome the resistance of soft ground moves nothing, however often it is planned again.
"""

from collections import deque
from copy import copy
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.conventions import DT
from offpiste.planning.mppi import shift


@dataclass(frozen=True)
class TimedPlan:
    """A plan and the time at which it acts.

    Attributes:
        start: when its first control is commanded [s].
        made: when it was made [s].
        controls: one for each step of `conventions.DT`.
    """

    start: float
    made: float
    controls: Float[Tensor, "T 3"]


class Schedule:
    """Plans in the order of their starts."""

    def __init__(self) -> None:
        self._plans: deque[TimedPlan] = deque()

    @property
    def latest(self) -> TimedPlan | None:
        """The plan that was made last; None before the first."""
        return self._plans[-1] if self._plans else None

    def add(self, plan: TimedPlan) -> None:
        """Add a plan; it must not start before the plans in the schedule."""
        self._plans.append(plan)

    def clear(self) -> None:
        """Forget all plans."""
        self._plans.clear()

    def acting(self, time: float) -> TimedPlan | None:
        """The plan that is followed at a moment [s]; None before the first."""
        while len(self._plans) > 1 and self._plans[1].start <= time + 1e-6:
            self._plans.popleft()
        return self._plans[0] if self._plans and self._plans[0].start <= time + 1e-6 else None

    def control(self, time: float) -> Float[np.ndarray, " 3"] | None:
        """Control at a moment [s]; a plan's last control is held."""
        plan = next((p for p in reversed(self._plans) if p.start <= time + 1e-6), None)
        return None if plan is None else plan.controls[_step(plan, time)].numpy().astype(np.float64)

    def committed(self, now: float, steps: int, otherwise: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "steps 3"]:
        """Controls of the next steps by the plans made so far.

        Args:
            otherwise: control where no plan acts yet.
        """
        due = (self.control(now + DT * step) for step in range(steps))
        return np.array([otherwise if control is None else control for control in due]).reshape(steps, 3)

    def continued(self, start: float, steps: int, rest: Float[np.ndarray, " 3"]) -> Float[Tensor, "steps 3"]:
        """Latest plan from a moment on [s], its last control held: the start of the next plan."""
        if self.latest is None:
            return torch.as_tensor(rest, dtype=torch.float32).repeat(steps, 1)
        return shift(self.latest.controls, max(round((start - self.latest.start) / DT), 0))


def _step(plan: TimedPlan, time: float) -> int:
    return min(max(int((time - plan.start) / DT + 1e-4), 0), len(plan.controls) - 1)


@dataclass(frozen=True)
class LaunchSettings:
    """Settings of `Launch`.

    Attributes:
        below: speed below which throttle is added [m/s].
        rate: rate at which the added throttle rises and falls [1/s].
        wanted: smallest planned throttle that is meant to drive.
    """

    below: float = 1.0
    rate: float = 0.3
    wanted: float = 0.05


class Launch:
    """Throttle added to the planned one while the vehicle hardly moves.

    Attributes:
        more: throttle that is added.
    """

    def __init__(self, settings: LaunchSettings | None = None) -> None:
        self._settings = settings or LaunchSettings()
        self.more = 0.0

    def throttle(self, planned: float, speed: float) -> float:
        """Throttle for the next `conventions.DT`; never less than planned.

        Args:
            planned: [0..1].
            speed: over the ground [m/s].
        """
        settings = self._settings
        if planned < settings.wanted:
            self.reset()
            return planned
        rise = settings.rate * DT * (1 if speed < settings.below else -1)
        self.more = min(max(self.more + rise, 0.0), 1.0 - planned)
        return planned + self.more

    def ahead(self, planned: Float[np.ndarray, " N"], speed: float) -> Float[np.ndarray, " N"]:
        """Throttle of the steps to come, if the speed stays on its side of `LaunchSettings.below`."""
        later = copy(self)
        return np.array([later.throttle(float(throttle), speed) for throttle in planned])

    def reset(self) -> None:
        """Remove the added throttle."""
        self.more = 0.0
