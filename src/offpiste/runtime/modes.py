"""Driving mode as a function of the ages of the inputs."""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from jaxtyping import Float

from offpiste.rig.outputs import Timeouts

Mode = Literal["driving", "degraded", "stopping", "stopped"]


@dataclass(frozen=True)
class Ages:
    """Ages of the inputs [s]; infinite before the first.

    Attributes:
        image: -infinite for models without visual features.
    """

    state: float
    scan: float
    image: float
    plan: float

    def at_least(self, others: "Ages") -> "Ages":
        """Return the greater of the ages by two clocks, one of which may have stopped."""
        return Ages(*(max(one, getattr(others, name)) for name, one in vars(self).items()))


NO_AGES: Final = Ages(-np.inf, -np.inf, -np.inf, -np.inf)


@dataclass(frozen=True)
class ModeDecision:
    """Mode and its reason.

    Attributes:
        why: reason; empty in normal driving.
        slow: whether the speed is limited.
    """

    mode: Mode
    why: str = ""
    slow: bool = False


@dataclass(frozen=True)
class Event:
    """A change of mode or of its reason; time in s."""

    time: float
    mode: Mode
    why: str


@dataclass(frozen=True)
class Controls:
    """Command to the vehicle for the next `conventions.DT`.

    Attributes:
        time: start time [s].
        command: throttle [0..1], brake [0..1], steer [-1..1, + left].
        why: reason for the mode; empty in normal driving.
        gear: 1 forward, -1 reverse.
    """

    time: float
    command: Float[np.ndarray, " 3"]
    mode: Mode
    why: str = ""
    gear: float = 1.0


def decide_mode(
    ages: Ages, timeouts: Timeouts, *, map_empty: bool, finished: bool, stuck: bool = False
) -> ModeDecision:
    """Return the mode for the most severe fault.

    Args:
        map_empty: whether no ground is within reach of a plan.
        finished: whether the end of the course is reached.
        stuck: whether backing out was given up.
    """
    if ages.state > timeouts.state:
        return ModeDecision("stopping", "no state of the vehicle")
    if finished:
        return ModeDecision("stopping", "end of the course")
    if ages.scan > timeouts.scan_limit:
        return ModeDecision("stopping", "no scan")
    if stuck:
        return ModeDecision("stopping", "stuck")
    if map_empty:
        return ModeDecision("stopping", "empty map")
    if ages.plan > timeouts.plan:
        return ModeDecision("stopping", "no plan")
    if ages.scan > timeouts.scan:
        return ModeDecision("degraded", "late scan", slow=True)
    if ages.image > timeouts.image:
        return ModeDecision("degraded", "no image")
    return ModeDecision("driving")
