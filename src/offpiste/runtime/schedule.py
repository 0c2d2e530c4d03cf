"""Which control is due when: plans that act once their latency has passed, the later one instead of the earlier.

Driving off: more throttle than was planned, while the vehicle hardly moves though it was to drive.

Models learn from windows that start above `conventions.MIN_EVALUATION_SPEED`, and expect a standing vehicle to follow
any throttle. A torque that does not overcome the resistance of soft ground moves nothing, however often it is planned
anew.
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
    """A plan and when it acts.

    Attributes:
        start: its first control is commanded then [s].
        made: when the data were taken that it comes from [s].
        controls: one a step of `conventions.DT`.
    """

    start: float
    made: float
    controls: Float[Tensor, "T 3"]


class Schedule:
    """Plans that were made, in the order of their starts."""

    def __init__(self) -> None:
        self._plans: deque[TimedPlan] = deque()

    @property
    def latest(self) -> TimedPlan | None:
        """The plan that was made last."""
        return self._plans[-1] if self._plans else None

    def add(self, plan: TimedPlan) -> None:
        """A new plan; it must not start before those that are there."""
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
        """What is commanded at a moment [s]; a plan's last control is held."""
        plan = next((p for p in reversed(self._plans) if p.start <= time + 1e-6), None)
        return None if plan is None else plan.controls[_step(plan, time)].numpy().astype(np.float64)

    def committed(self, now: float, steps: int, otherwise: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "steps 3"]:
        """What will be commanded in the next steps, whatever is planned now.

        Args:
            otherwise: where no plan says.
        """
        due = (self.control(now + DT * step) for step in range(steps))
        return np.array([otherwise if control is None else control for control in due]).reshape(steps, 3)

    def continued(self, start: float, steps: int, rest: Float[np.ndarray, " 3"]) -> Float[Tensor, "steps 3"]:
        """The latest plan as it would go on from a moment: what the next one begins with."""
        if self.latest is None:
            return torch.as_tensor(rest, dtype=torch.float32).repeat(steps, 1)
        return shift(self.latest.controls, max(round((start - self.latest.start) / DT), 0))


def _step(plan: TimedPlan, time: float) -> int:
    return min(max(int((time - plan.start) / DT + 1e-4), 0), len(plan.controls) - 1)


@dataclass(frozen=True)
class LaunchSettings:
    """When and how fast.

    Attributes:
        below: the vehicle hardly moves [m/s].
        rate: the throttle rises above the planned one, and comes back to it [1/s].
        wanted: the least planned throttle that is meant to drive.
    """

    below: float = 1.0
    rate: float = 0.3
    wanted: float = 0.05


class Launch:
    """Remembers how much more throttle is given than was planned."""

    def __init__(self, settings: LaunchSettings | None = None) -> None:
        self._settings = settings or LaunchSettings()
        self._more = 0.0

    def throttle(self, planned: float, speed: float) -> float:
        """What is given for the next `conventions.DT`; never less than was planned.

        Args:
            planned: [0..1].
            speed: over the ground [m/s].
        """
        settings = self._settings
        if planned < settings.wanted:
            self.reset()
            return planned
        rise = settings.rate * DT * (1 if speed < settings.below else -1)
        self._more = min(max(self._more + rise, 0.0), 1.0 - planned)
        return planned + self._more

    def ahead(self, planned: Float[np.ndarray, " N"], speed: float) -> Float[np.ndarray, " N"]:
        """What will be given for steps to come, while the speed stays on its side of `LaunchSettings.below`."""
        later = copy(self)
        return np.array([later.throttle(float(throttle), speed) for throttle in planned])

    def reset(self) -> None:
        """Give what is planned: it begins anew."""
        self._more = 0.0
