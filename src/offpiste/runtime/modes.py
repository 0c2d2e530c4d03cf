"""In which mode the vehicle is driven, from how old its inputs are: what is done when one is late or missing."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

Mode = Literal["driving", "degraded", "stopping", "stopped"]


@dataclass(frozen=True)
class Patience:
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
class Judgement:
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


def judge(ages: Ages, patience: Patience, *, map_empty: bool, finished: bool) -> Judgement:
    """The worst of all troubles decides.

    Args:
        map_empty: whether nothing is known of the ground around the vehicle.
        finished: whether the course is driven.
    """
    if ages.state > patience.state:
        return Judgement("stopping", "no state of the vehicle")
    if finished:
        return Judgement("stopping", "end of the course")
    if ages.scan > patience.scan_limit:
        return Judgement("stopping", "no scan")
    if map_empty:
        return Judgement("stopping", "empty map")
    if ages.plan > patience.plan:
        return Judgement("stopping", "no plan")
    if ages.scan > patience.scan:
        return Judgement("degraded", "late scan", slow=True)
    if ages.image > patience.image:
        return Judgement("degraded", "no image")
    return Judgement("driving")
