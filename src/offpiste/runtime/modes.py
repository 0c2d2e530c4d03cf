"""In which mode the vehicle is driven, from how old its inputs are: what is done when one is late or missing."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

Mode = Literal["driving", "degraded", "stopping", "stopped"]


@dataclass(frozen=True)
class Timeouts:
    """How old inputs may be [s].

    Attributes:
        state: readings of the vehicle; older: controlled stop.
        scan: older scans than this: slow down.
        scan_limit: older than this: controlled stop.
        image: older images: the vehicle goes on without looking, on what the map holds, and says so.
        plan: data that the plan which is followed was made from, beyond its latency; older: controlled stop.
        ahead: stamps further ahead of the clock are not believed.
    """

    state: float = 0.1
    scan: float = 0.3
    scan_limit: float = 1.0
    image: float = 1.5
    plan: float = 0.5
    ahead: float = 0.1


@dataclass(frozen=True)
class Ages:
    """How old things are [s]; infinite where there never was one.

    Attributes:
        image: -infinite for models that look at none.
    """

    state: float
    scan: float
    image: float
    plan: float


@dataclass(frozen=True)
class ModeDecision:
    """What is to be done.

    Attributes:
        slow: whether to go slowly.
        why: empty while all is well.
    """

    mode: Mode
    why: str = ""
    slow: bool = False


@dataclass(frozen=True)
class Event:
    """A change of mode, or of what it is for.

    Attributes:
        time: [s].
    """

    time: float
    mode: Mode
    why: str


@dataclass(frozen=True)
class Controls:
    """What the vehicle is told for the next `conventions.DT`.

    Attributes:
        time: from when on [s].
        command: throttle [0..1], brake [0..1], steer [-1..1, + left].
        why: of the mode; empty while all is well.
    """

    time: float
    command: Float[np.ndarray, " 3"]
    mode: Mode
    why: str = ""


def decide_mode(ages: Ages, timeouts: Timeouts, *, map_empty: bool, finished: bool) -> ModeDecision:
    """The worst of all troubles decides.

    Args:
        map_empty: whether nothing is known of the ground around the vehicle.
        finished: whether the course is driven.
    """
    if ages.state > timeouts.state:
        return ModeDecision("stopping", "no state of the vehicle")
    if finished:
        return ModeDecision("stopping", "end of the course")
    if ages.scan > timeouts.scan_limit:
        return ModeDecision("stopping", "no scan")
    if map_empty:
        return ModeDecision("stopping", "empty map")
    if ages.plan > timeouts.plan:
        return ModeDecision("stopping", "no plan")
    if ages.scan > timeouts.scan:
        return ModeDecision("degraded", "late scan", slow=True)
    if ages.image > timeouts.image:
        return ModeDecision("degraded", "no image")
    return ModeDecision("driving")
