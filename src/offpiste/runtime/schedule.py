"""Schedule of controls: each plan acts once its latency has passed, and replaces the one before it."""

from collections import deque
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.conventions import DT
from offpiste.planning.mppi import shift


@dataclass(frozen=True)
class TimedPlan:
    """A plan and the time at which it acts.

    Attributes:
        start: when its first control is commanded [s].
        made: when it was made [s].
        controls: one for each step of `conventions.DT`.
        gear: in which they are driven: 1 forward, -1 reverse.
    """

    start: float
    made: float
    controls: Float[Tensor, "T 3"]
    gear: float = 1.0


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

    def at(self, time: float) -> TimedPlan | None:
        """The plan that acts at a moment, now or to come [s]; None before the first."""
        return next((p for p in reversed(self._plans) if p.start <= time + 1e-6), None)

    def control(self, time: float) -> Float[np.ndarray, " 3"] | None:
        """Control at a moment [s]; a plan's last control is held."""
        plan = self.at(time)
        return None if plan is None else plan.controls[_step(plan, time)].numpy().astype(np.float64)

    def committed(self, now: float, steps: int, otherwise: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "steps 3"]:
        """Controls of the next steps by the plans made so far.

        Args:
            otherwise: control where no plan acts yet.
        """
        due = (self.control(now + DT * step) for step in range(steps))
        return np.array([otherwise if control is None else control for control in due]).reshape(steps, 3)

    def continued(
        self, start: float, steps: int, rest: Float[np.ndarray, " 3"], gear: float = 1.0
    ) -> Float[Tensor, "steps 3"]:
        """Latest plan from a moment on [s], its last control held: the start of the next plan.

        Args:
            rest: control throughout where there is no plan, or only one in another gear.
            gear: of the next plan.
        """
        if self.latest is None or self.latest.gear != gear:
            return torch.as_tensor(rest, dtype=torch.float32).repeat(steps, 1)
        return continued(self.latest, start)


def continued(plan: TimedPlan, start: float) -> Float[Tensor, "T 3"]:
    """A plan from a moment on [s], its last control held."""
    return shift(plan.controls, max(round((start - plan.start) / DT), 0))


def _step(plan: TimedPlan, time: float) -> int:
    return min(max(int((time - plan.start) / DT + 1e-4), 0), len(plan.controls) - 1)
