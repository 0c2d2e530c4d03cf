"""Segments of a pose between steps that no vehicle makes, and the chain of them that keeps the most time."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

Between = Callable[[Int[np.ndarray, " m"], Int[np.ndarray, " m"]], Float[np.ndarray, "m k"]]
"""The way from some samples to others [m or rad]."""


@dataclass(frozen=True)
class Limits:
    """What a vehicle can do, in metres or in radians.

    Attributes:
        speed: fastest [m/s].
        acceleration: largest change of velocity [m/s^2].
        least: smallest step that is a fault [m] ...
        least_time: ... or the way of this time at the median speed, if that is more [s].
        noise: most of the local scatter that is noise [m].
        common: most of what a hundredth of the steps exceed that is noise [m].
        far: length of a jump that costs one more second [m].
        lost: largest share of the time that may be dropped; where it is more, the pose is another than it seems.
    """

    speed: float
    acceleration: float
    least: float
    least_time: float
    noise: float
    common: float
    far: float
    lost: float


JUMP_COST: Final = 0.5
"""Time that a segment must add to be worth a jump [s]."""
_MOST_COST: Final = 30.0
"""Most that the length of a jump adds [s]."""
BESIDE: Final = 5
"""Steps on either side whose median velocity explains a step."""
_CANDIDATES: Final = 512
"""Segments with the best chains that a link may start from."""
HELD: Final = 2.0
"""A sample that repeats counts for this many sampling times at most."""


@dataclass(frozen=True)
class Segments:
    """Runs of samples without a fault between them; samples that repeat count once.

    Attributes:
        first, last: samples that they begin and end with.
        begin, end: when they begin and end [s]; samples that repeat are cut short.
        weight: time that keeping them adds [s].
        velocity_in, velocity_out: at their beginning and end; NaN for a single sample [m/s].
        span: time that these velocities rest on [s].
        noise: of a step [m].
        entered, left: how far the steps before their beginning and after their end are unexplained [m].
    """

    first: Int[np.ndarray, " s"]
    last: Int[np.ndarray, " s"]
    begin: Float[np.ndarray, " s"]
    end: Float[np.ndarray, " s"]
    weight: Float[np.ndarray, " s"]
    velocity_in: Float[np.ndarray, "s k"]
    velocity_out: Float[np.ndarray, "s k"]
    span: Float[np.ndarray, " s"]
    noise: Float[np.ndarray, " s"]
    entered: Float[np.ndarray, " s"]
    left: Float[np.ndarray, " s"]

    def costs(
        self, origins: Int[np.ndarray, " m"], to: int, between: Between, limits: Limits, least: float, typical: float
    ) -> Float[np.ndarray, " m"]:
        """Cost of links from the ends of some segments to the beginning of a later one [s]; 0 where it can be driven.

        Args:
            least: smallest step that is a fault [m].
            typical: sampling time [s].
        """
        way = between(self.last[origins], np.full(len(origins), self.first[to]))
        seconds = np.maximum(self.begin[to] - self.end[origins], typical)
        before, after = self.velocity_out[origins], np.broadcast_to(self.velocity_in[to], way.shape)
        before, after = np.where(np.isnan(before), after, before), np.where(np.isnan(after), before, after)
        off = deviation(way, seconds, np.nan_to_num(before), np.nan_to_num(after))
        noise = np.maximum(self.noise[origins], self.noise[to])
        error = noise * (1 + seconds / self.span[origins] + seconds / self.span[to])
        excess = np.maximum(
            np.linalg.norm(way, axis=1) - limits.speed * seconds - least - noise,
            off - least - limits.acceleration * seconds**2 - error,
        )
        # What is left out must be further off than what it is left out for: no shift in two steps is an excursion.
        shifted = (origins < to - 1) & (off > 0.5 * np.minimum(self.left[origins], self.entered[to]))
        cost = JUMP_COST + np.minimum(np.maximum(excess, 0.0) / limits.far, _MOST_COST)
        return np.where((excess > 0) | shifted, cost, 0.0)


def best_chain(
    weight: Float[np.ndarray, " s"], costs: Callable[[Int[np.ndarray, " m"], int], Float[np.ndarray, " m"]]
) -> Int[np.ndarray, " c"]:
    """Numbers of the segments that keep the most time, less the costs of the links between neighbours.

    Exact for up to `_CANDIDATES` segments; beyond, links start from those with the best chains so far.

    Args:
        weight: time that each segment adds [s].
        costs: of links from some segments to a later one [s].
    """
    score, previous = weight.astype(float).copy(), np.full(len(weight), -1)
    candidates = np.zeros(0, int)
    for to in range(len(weight)):
        if len(candidates):
            through = score[candidates] - costs(candidates, to)
            best = int(np.argmax(through))
            if through[best] > 0:
                score[to] += through[best]
                previous[to] = candidates[best]
        candidates = np.append(candidates, to)
        if len(candidates) > _CANDIDATES:
            candidates = np.delete(candidates, np.argmin(score[candidates]))
    chain = [int(np.argmax(score))] if len(score) else []
    while chain and previous[chain[-1]] >= 0:
        chain.append(int(previous[chain[-1]]))
    return np.array(chain[::-1], int)


def deviation(
    way: Float[np.ndarray, "m k"],
    seconds: Float[np.ndarray, " m"],
    before: Float[np.ndarray, "m k"],
    after: Float[np.ndarray, "m k"],
) -> Float[np.ndarray, " m"]:
    """Distance of a way from those that the velocity before, the one after, or one between them leads to.

    Shorter ways count as explained: a late stamp makes a way short, and no fault of the pose does that alone.
    """
    ahead, behind = before * seconds[:, None], after * seconds[:, None]
    nothing = np.zeros_like(way)
    sides = [_off_line(way, *ends) for ends in ((nothing, ahead), (nothing, behind), (ahead, behind))]
    return np.asarray(np.min(sides, axis=0))


def _off_line(
    point: Float[np.ndarray, "m k"], start: Float[np.ndarray, "m k"], end: Float[np.ndarray, "m k"]
) -> Float[np.ndarray, " m"]:
    """Distance of points from straight lines between two others."""
    along = end - start
    length = np.einsum("mk,mk->m", along, along)
    share = np.einsum("mk,mk->m", point - start, along) / np.where(length > 0, length, 1.0)
    return np.asarray(np.linalg.norm(point - start - np.clip(share, 0, 1)[:, None] * along, axis=1))


def segments_of(
    fresh: Int[np.ndarray, " f"],
    held: Int[np.ndarray, " f"],
    time: Float[np.ndarray, " n"],
    until: Float[np.ndarray, " f"],
    way: Float[np.ndarray, "s k"],
    seconds: Float[np.ndarray, " s"],
    noise: Float[np.ndarray, " s"],
    off: Float[np.ndarray, " s"],
    fault: Bool[np.ndarray, " s"],
    typical: float,
) -> Segments:
    """Segments between the steps that are faults, from f samples that do not repeat and the s = f - 1 steps between."""
    starts = np.append(0, np.flatnonzero(fault) + 1)
    ends = np.append(np.flatnonzero(fault), len(fresh) - 1)
    path, clock = summed(way), summed(seconds)
    reach = np.minimum(BESIDE, ends - starts)
    inner = np.where(reach > 0, 1.0, np.nan)
    span_in, span_out = clock[starts + reach] - clock[starts], clock[ends] - clock[ends - reach]
    with np.errstate(invalid="ignore", divide="ignore"):
        velocity_in = (path[starts + reach] - path[starts]) / (span_in * inner)[:, None]
        velocity_out = (path[ends] - path[ends - reach]) / (span_out * inner)[:, None]
    return Segments(
        fresh[starts],
        fresh[ends],
        time[fresh[starts]],
        time[held[ends]] - np.minimum(time[held[ends]] - time[fresh[ends]], HELD * typical),
        clock[ends] - clock[starts] + np.maximum(until[ends] - time[fresh[ends]], typical),
        velocity_in,
        velocity_out,
        np.maximum(np.minimum(span_in, span_out), typical),
        np.minimum(noise[np.minimum(starts, len(noise) - 1)], noise[np.maximum(ends - 1, 0)]),
        np.append(np.inf, off[fault]),
        np.append(off[fault], np.inf),
    )


def summed(steps: Float[np.ndarray, "s ..."]) -> Float[np.ndarray, "f ..."]:
    """Sums of the steps until each sample, from nothing."""
    return np.concatenate((np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)))
