"""Which control is due when: plans that act once their latency has passed, the later one instead of the earlier."""

from collections import deque
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
