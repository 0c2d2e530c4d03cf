"""A clock that drifts against the pose's, found by a signal that both know: the speed of the wheels.

Buses and bridges stamp messages when they arrive. In the TartanDrive 2 drives the vehicle's bus arrives between 0.3 s
early and 1.5 s late, changing within seconds: a constant delay cannot mend that.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from offpiste.geometry import local_polynomial
from offpiste.logs.channel import Channel, read_channel
from offpiste.logs.log import Log
from offpiste.rig.rig import Alignment, Rig

_BIN = 0.1
"""Time step of the lag [s]."""


@dataclass(frozen=True)
class ClockLag:
    """How much later than it happened a sample is stamped.

    Attributes:
        time: when it happened, by the pose's clock [s].
        lag: stamp minus time [s]; `time + lag` never decreases.
    """

    time: Float[np.ndarray, " n"]
    lag: Float[np.ndarray, " n"]

    def happened(self, stamps: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """When samples with these stamps happened [s]."""
        stamped = self.time + self.lag
        inside = np.interp(stamps, stamped, self.time)
        before = np.minimum(stamps - stamped[0], 0.0)
        after = np.maximum(stamps - stamped[-1], 0.0)
        return inside + before + after


def align_clock(
    log: Log, rig: Rig, alignment: Alignment, channels: dict[str, Channel]
) -> tuple[dict[str, Channel], list[str]]:
    """Move the channels of a drifting clock to the pose's clock; also says by how much, in words.

    The whole drive is used, as in any synchronisation after the fact: a planner on the vehicle has no such lag.
    """
    # Wheels are read like a velocity of two components, one a field; their mean is the speed.
    wheels, _ = read_channel(log, rig, "wheel_speed", alignment.speed)
    speed = Channel("wheel_speed", wheels.unit, wheels.time, wheels.values.mean(axis=1, keepdims=True))
    lag = estimate_lag(pose_speed(channels), speed, max_lag=alignment.max_lag)
    aligned = dict(channels)
    for name, source in rig.channels.items():
        if source.topic in alignment.topics:
            aligned[name] = replace(channels[name], time=lag.happened(channels[name].time))
    low, middle, high = np.percentile(lag.lag, (5, 50, 95))
    return aligned, [
        f"clock of {', '.join(alignment.topics)}: {middle:.2f} s late (5 to 95 %: {low:.2f} to {high:.2f} s); aligned"
    ]


def pose_speed(channels: dict[str, Channel]) -> Channel:
    """Speed by the pose's clock [m/s]: the length of the log's velocity, which no frame changes, or of the pose's."""
    velocity = channels.get("linear_velocity")
    if velocity is not None:
        return replace(velocity, name="speed", values=np.linalg.norm(velocity.values, axis=1, keepdims=True))
    place = channels["position"]
    _, rate = local_polynomial(place.time, place.values[:, :2], place.time, window=0.3, causal=False)
    known = np.isfinite(rate).all(axis=1)
    speed = np.linalg.norm(rate[known], axis=1, keepdims=True)
    return Channel("speed", "m/s", place.time[known], speed)


def estimate_lag(
    reference: Channel, recorded: Channel, *, max_lag: float, step: float = 0.05, stiffness: float = 2.0
) -> ClockLag:
    """The lag of `recorded` behind `reference`, piecewise constant, by dynamic programming.

    Minimises the sum over bins of |recorded(t + lag) - reference(t)| + stiffness |change of lag|, so that the lag
    jumps only where the speeds demand it. It is a dynamic time warping (Sakoe and Chiba 1978) with an L1 prior.

    Args:
        reference: speed by the pose's clock [m/s].
        recorded: the same speed by the other clock [m/s].
        max_lag: lags from -max_lag/2 to max_lag are tried [s].
        step: between tried lags [s].
        stiffness: what a change by 1 s costs, in m/s lasting one second.
    """
    time = np.arange(reference.time[0], reference.time[-1], _BIN)
    lags = np.arange(-max_lag / 2, max_lag + step / 2, step)
    known = np.interp(time, reference.time, reference.values[:, 0])
    misfit = np.stack([np.interp(time + lag, recorded.time, recorded.values[:, 0]) - known for lag in lags], axis=1)

    change = lags[None, :] - lags[:, None]
    price = stiffness / _BIN * np.abs(change)
    # A later sample must not have happened earlier: the lag cannot fall faster than time passes.
    price[change < -_BIN + 1e-9] = np.inf
    return ClockLag(time, lags[_cheapest_path(np.abs(misfit), price)])


def _cheapest_path(misfit: Float[np.ndarray, "n L"], price: Float[np.ndarray, "L L"]) -> Int[np.ndarray, " n"]:
    """Viterbi: the sequence of columns with the least misfit plus price[from, to] of its changes."""
    total = misfit[0].copy()
    came_from = np.zeros(misfit.shape, dtype=np.int64)
    for row in range(1, len(misfit)):
        arrival = total[:, None] + price
        came_from[row] = arrival.argmin(axis=0)
        total = arrival[came_from[row], np.arange(len(total))] + misfit[row]
    path = np.empty(len(misfit), dtype=np.int64)
    path[-1] = total.argmin()
    for row in range(len(misfit) - 1, 0, -1):
        path[row - 1] = came_from[row, path[row]]
    return path
