"""Clocks that drift against the poses', compared by the speed of the wheels or by arrival times.

Buses and bridges stamp messages when they arrive. In the TartanDrive 2 drives the stamps of the vehicle's bus are
between 0.3 s early and 1.5 s late and change within seconds, which no constant delay corrects: the lag is estimated
from the speed of the wheels. Cameras and LiDARs do not measure the speed; their clocks are compared by arrival times.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from offpiste.core.errors import LogError
from offpiste.core.geometry import local_polynomial
from offpiste.logs.channel import Channel, read_channel, refuse_long
from offpiste.logs.log import Log, SetBack
from offpiste.rig.channels import Alignment
from offpiste.rig.rig import Rig

_BIN: Final = 0.1
"""Time step of the lag [s]."""
_LAG_STEP: Final = 0.05
"""Step between candidate lags [s]."""
_BLOCKS: Final = 12
"""Number of time blocks; only the smallest delay of each is used, since messages can only be late."""
DRIFT_LIMIT: Final = 0.2
"""Drift above which images and scans are refused [s]."""
_STEP: Final = 0.1
"""Smallest backward step of all clocks [s]."""
_BESIDE: Final = 5
"""Number of samples on either side of a step that must increase."""

ALIGNED: Final = "clock of"
"""Beginning of the note on an aligned clock."""


@dataclass(frozen=True)
class ClockLag:
    """Lag of a clock: stamp minus true time."""

    time: Float[np.ndarray, " n"]  # times by the poses' clock [s]
    lag: Float[np.ndarray, " n"]  # stamp minus time [s]; `time + lag` never decreases

    def happened(self, stamps: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the true times of samples with given stamps [s]."""
        stamped = self.time + self.lag
        inside = np.interp(stamps, stamped, self.time)
        before = np.minimum(stamps - stamped[0], 0.0)
        after = np.maximum(stamps - stamped[-1], 0.0)
        return inside + before + after


def align_clock(
    log: Log, rig: Rig, alignment: Alignment, channels: dict[str, Channel]
) -> tuple[dict[str, Channel], list[str]]:
    """Align the channels of a drifting clock to the poses' clock; return the channels and a note on the lag.

    The whole drive is used, which a planner on the vehicle cannot do.
    """
    wheels, _, _ = read_channel(log, rig, "wheel_speed", alignment.speed)
    speed = Channel("wheel_speed", wheels.unit, wheels.time, wheels.values.mean(axis=1, keepdims=True))
    reference = pose_speed(channels)
    if len(reference.time) < 2:
        how = "remove [alignment], or use a pose with more samples"
        raise LogError("its poses show no speed to align a clock with", where=log.path, how=how)
    refuse_long(reference.time[0], reference.time[-1], log.path)
    lag = estimate_lag(reference, speed, max_lag=alignment.max_lag)
    aligned = dict(channels)
    for name, source in rig.channels.items():
        if source.topic in alignment.topics:
            aligned[name] = replace(channels[name], time=lag.happened(channels[name].time))
    low, middle, high = np.percentile(lag.lag, (5, 50, 95))
    return aligned, [
        f"{ALIGNED} {', '.join(alignment.topics)}: {middle:.2f} s late (5 to 95 %: {low:.2f} to {high:.2f} s); aligned"
    ]


def pose_speed(channels: dict[str, Channel]) -> Channel:
    """Return the speed by the poses' clock [m/s]: the norm of the logged velocity, or of the derivative of position."""
    velocity = channels.get("linear_velocity")
    if velocity is not None:
        return replace(velocity, name="speed", values=np.linalg.norm(velocity.values, axis=1, keepdims=True))
    place = channels["position"]
    window = max(0.3, 6 * float(np.median(np.diff(place.time))))  # six samples of slow poses
    _, rate = local_polynomial(place.time, place.values[:, :2], place.time, window=window, causal=False)
    known = np.isfinite(rate).all(axis=1)
    speed = np.linalg.norm(rate[known], axis=1, keepdims=True)
    return Channel("speed", "m/s", place.time[known], speed)


def estimate_lag(reference: Channel, recorded: Channel, *, max_lag: float, stiffness: float = 2.0) -> ClockLag:
    """Estimate the piecewise constant lag of `recorded` behind `reference` by dynamic programming.

    Minimises the sum over bins of |recorded(t + lag) - reference(t)| + stiffness |change of lag|, so that the lag
    jumps only where the speeds demand it: dynamic time warping (Sakoe and Chiba 1978) with an L1 prior.

    Args:
        reference, recorded: speed by the poses' clock and by the other clock [m/s].
        max_lag: lags from -max_lag/2 to max_lag are tried [s].
        stiffness: cost of a change of lag by 1 s, in m/s for one second.
    """
    time = np.arange(reference.time[0], reference.time[-1], _BIN)
    lags = np.arange(-max_lag / 2, max_lag + _LAG_STEP / 2, _LAG_STEP)
    known = np.interp(time, reference.time, reference.values[:, 0])
    misfit = np.stack([np.interp(time + lag, recorded.time, recorded.values[:, 0]) - known for lag in lags], axis=1)

    change = lags[None, :] - lags[:, None]
    cost = stiffness / _BIN * np.abs(change)
    # True times must increase with stamps: the lag cannot fall faster than time passes.
    cost[change < -_BIN + 1e-9] = np.inf
    return ClockLag(time, lags[_cheapest_path(np.abs(misfit), cost)])


def _cheapest_path(misfit: Float[np.ndarray, "n L"], cost: Float[np.ndarray, "L L"]) -> Int[np.ndarray, " n"]:
    """Return the sequence of columns with the least misfit plus cost[from, to] of its changes (Viterbi)."""
    total = misfit[0].copy()
    came_from = np.zeros(misfit.shape, dtype=np.int64)
    for row in range(1, len(misfit)):
        arrival = total[:, None] + cost
        came_from[row] = arrival.argmin(axis=0)
        total = arrival[came_from[row], np.arange(len(total))] + misfit[row]
    path = np.empty(len(misfit), dtype=np.int64)
    path[-1] = total.argmin()
    for row in range(len(misfit) - 1, 0, -1):
        path[row - 1] = came_from[row, path[row]]
    return path


class ClockDifference(NamedTuple):
    """Difference between the poses' clock and a sensor's."""

    offset: float  # delay of the sensor's clock in the middle of the drive [s]
    drift: float  # increase of that delay from the start of the drive to its end [s]


def clock_difference(
    stamps: Float[np.ndarray, " n"],
    arrivals: Float[np.ndarray, " n"],
    pose_stamps: Float[np.ndarray, " m"],
    pose_arrivals: Float[np.ndarray, " m"],
) -> ClockDifference | None:
    """Estimate the difference between a sensor's clock and the poses' from arrivals; None for too few messages.

    All messages arrive by the recorder's clock, so that the difference is a line through the smallest delays of each
    block of time.
    """
    if not (len(stamps) and len(pose_stamps)):
        return None
    start, end = max(arrivals.min(), pose_arrivals.min()), min(arrivals.max(), pose_arrivals.max())
    if not end > start:
        return None
    edges = np.linspace(start, end, _BLOCKS + 1)
    own, poses = (least_delays(a, a - s, edges) for s, a in ((stamps, arrivals), (pose_stamps, pose_arrivals)))
    apart, middle = own - poses, (edges[1:] + edges[:-1]) / 2 - (start + end) / 2
    known = np.isfinite(apart)
    if known.sum() < _BLOCKS // 2:
        return None
    slope, offset = np.polyfit(middle[known], apart[known], 1)
    return ClockDifference(float(offset), float(slope * (end - start)))


def least_delays(
    arrivals: Float[np.ndarray, " n"], delay: Float[np.ndarray, " n"], edges: Float[np.ndarray, " e"]
) -> Float[np.ndarray, " b"]:
    """Return the smallest delay in each block of time; NaN without messages."""
    block = np.clip(np.searchsorted(edges, arrivals, side="right") - 1, 0, len(edges) - 2)
    inside = (arrivals >= edges[0]) & (arrivals <= edges[-1])
    least = np.full(len(edges) - 1, np.inf)
    np.minimum.at(least, block[inside], delay[inside])
    return np.where(np.isfinite(least), least, np.nan)


def common_step(topics: Iterable[Float[np.ndarray, " _"]]) -> SetBack | None:
    """Return the backward step shared by all of two or more topics that go on beyond it, from stamps in file order."""
    stamps = sorted((time for time in topics if len(time) > 4 * _BESIDE), key=len, reverse=True)
    for step in _steps_back(stamps[0]) if stamps else []:
        near = step.by / 2
        beyond = [time for time in stamps if time[0] < step.time - step.by and time[-1] > step.time]
        own = [[s for s in _steps_back(t) if abs(s.time - step.time) < near > abs(s.by - step.by)] for t in beyond]
        if len(own) > 1 and all(own):
            return step
    return None


def _steps_back(time: Float[np.ndarray, " n"]) -> list[SetBack]:
    """Return the backward steps of a clock, from stamps in file order; single late samples are not steps."""
    time = time[np.isfinite(time)]
    result = []
    for at in np.flatnonzero(np.diff(time) < -_STEP):
        before, after = time[max(at + 1 - _BESIDE, 0) : at + 1], time[at + 1 : at + 1 + _BESIDE]
        rising = (np.diff(before) >= 0).all() and (np.diff(after) >= 0).all()
        if rising and len(before) == len(after) == _BESIDE and after[0] < before[-1] - _STEP:
            result.append(SetBack(float(time[at]), float(time[at] - time[at + 1] + np.median(np.diff(before)))))
    return result
