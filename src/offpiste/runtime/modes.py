"""Driving mode as a function of the ages of the inputs."""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from jaxtyping import Float

from offpiste.rig.outputs import Timeouts

Mode = Literal["driving", "degraded", "stopping", "stopped"]


@dataclass(frozen=True)
class Ages:
    """Ages of the inputs [s]; infinite before the first, and -infinite for images that a model does not read."""

    state: float
    scan: float
    image: float
    plan: float

    def at_least(self, others: "Ages") -> "Ages":
        """Return the greater of the ages by two clocks, one of which may have stopped."""
        return Ages(*map(max, vars(self).values(), vars(others).values()))


NO_AGES: Final = Ages(-np.inf, -np.inf, -np.inf, -np.inf)


@dataclass(frozen=True)
class ModeDecision:
    """Mode and its reason, which is empty in normal driving."""

    mode: Mode
    why: str = ""
    slow: bool = False  # whether the speed is limited


@dataclass(frozen=True)
class Event:
    """A change of mode or of its reason; time in s."""

    time: float
    mode: Mode
    why: str


@dataclass(frozen=True)
class Controls:
    """Command to the vehicle for the next `conventions.DT`."""

    time: float  # start time [s]
    command: Float[np.ndarray, " 3"]  # throttle [0..1], brake [0..1], steer [-1..1, + left]
    mode: Mode
    why: str = ""  # reason for the mode; empty in normal driving
    gear: float = 1.0  # 1 forward, -1 reverse

    @property
    def drives(self) -> bool:
        """Whether a plan is followed."""
        return self.mode in ("driving", "degraded")


def decide_mode(
    ages: Ages, timeouts: Timeouts, *, map_empty: bool, finished: bool, stuck: bool = False
) -> ModeDecision:
    """Return the mode for the most severe fault.

    Args:
        map_empty: whether no ground is within reach of a plan.
        finished: whether the end of the course is reached.
        stuck: whether backing out was given up.
    """
    faults: tuple[tuple[bool, ModeDecision], ...] = (
        (ages.state > timeouts.state, ModeDecision("stopping", "no state of the vehicle")),
        (finished, ModeDecision("stopping", "end of the course")),
        (ages.scan > timeouts.scan_limit, ModeDecision("stopping", "no scan")),
        (stuck, ModeDecision("stopping", "stuck")),
        (map_empty, ModeDecision("stopping", "empty map")),
        (ages.plan > timeouts.plan, ModeDecision("stopping", "no plan")),
        (ages.scan > timeouts.scan, ModeDecision("degraded", "late scan", slow=True)),
        (ages.image > timeouts.image, ModeDecision("degraded", "no image")),
    )
    return next((decision for present, decision in faults if present), ModeDecision("driving"))
