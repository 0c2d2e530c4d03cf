"""Detection of pose samples that no vehicle can produce: corrupt runs, held positions, and lasting jumps.

The samples are cut into segments at steps that are too fast, or that the velocities before and after do not explain. Of
all chains of segments the one that keeps the most time is chosen. A link between two segments is free if the vehicle
could have driven it, and costs time if it is a jump. A run that returns to its start is therefore dropped; a lasting
shift is kept, as a jump.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import median_filter
from scipy.spatial.transform import Rotation

Between = Callable[[Int[np.ndarray, " m"], Int[np.ndarray, " m"]], Float[np.ndarray, "m k"]]
"""Displacement between samples [m or rad]."""


@dataclass(frozen=True)
class Limits:
    """Limits of a vehicle's motion, and of noise, in metres or in radians."""

    speed: float  # largest speed [m/s]
    acceleration: float  # largest acceleration [m/s^2]
    least: float  # smallest faulty step [m]
    least_time: float  # ... or distance at the median speed in this time, if larger [s]
    noise: float  # limit of the local scatter that is taken for noise [m]
    common: float  # limit of the 99th percentile of steps that is taken for noise [m]
    far: float  # length of a jump that costs one more second [m]
    lost: float  # largest share of time that may be dropped; beyond it the pose itself is in doubt


_POSITION: Final = Limits(120.0, 20.0, 0.1, 0.05, 8.0, 1.0, 5.0, 0.5)
_HEADING: Final = Limits(30.0, 60.0, 0.15, 0.0, np.inf, 0.2, 0.2, 0.1)
"""Headings may be noise at a standstill (courses of GPS): local scatter of any size is taken for noise."""

_JUMP_COST: Final = 0.5
"""Time that a segment must add to be worth a jump [s]."""
_MOST_COST: Final = 30.0
"""Largest additional cost of a long jump [s]."""
_BESIDE: Final = 5
"""Number of steps on either side whose median velocity explains a step."""
_CANDIDATES: Final = 512
"""Number of best chains to which a segment may be linked."""
_HELD: Final = 2.0
"""Largest weight of a repeated sample, in sampling times."""
_LOCAL: Final = 25
"""Number of steps whose median deviation is the local scatter."""
_TYPICAL: Final = 70.0
"""Percentile of the deviations that is the overall scatter; half of them are 0, since short steps are explained."""
_NOISES: Final = 10.0
"""Multiple of the scatter that noise does not exceed."""
_COARSEST: Final = 1.0
"""Largest resolution of coordinates: float32 beyond 8000 km [m]."""
_SAME: Final = 1e-9
"""Largest difference between repeated samples [m or rad]."""
_HANGS, _UNUSUAL = 0.5, 5.0
"""Shortest duration of a held position [s], and its smallest ratios to typical durations and steps."""
_MOVES: Final = 1.5
"""Speed beside a held position above which it is faulty [m/s]: no vehicle stops or starts in an instant."""
_BRAKES: Final = 15.0
"""Largest deceleration [m/s^2]: a position that stops faster, for the rest of the log, is held."""


@dataclass(frozen=True)
class Plausible:
    """Samples that a vehicle can have produced."""

    keep: Bool[np.ndarray, " n"]  # samples to keep
    jumps: tuple[tuple[int, float], ...] = ()  # kept samples after remaining jumps, and the jumps' sizes [m or rad]
    hopeless: bool = False  # nothing was dropped, since too much would have been


def displacements(name: str, values: Float[np.ndarray, "n k"]) -> Between:
    """Return the displacement between samples of a pose's channel: position [m], yaw [rad], or quaternions xyzw."""
    if name == "orientation":
        turned = Rotation.from_quat(values)
        return lambda first, last: (turned[last] * turned[first].inv()).as_rotvec()
    if name == "yaw":
        return lambda first, last: (values[last] - values[first] + np.pi) % (2 * np.pi) - np.pi
    return lambda first, last: values[last] - values[first]


def plausible(name: str, time: Float[np.ndarray, " n"], values: Float[np.ndarray, "n k"]) -> Plausible:
    """Find the plausible samples of a pose's channel (`displacements`); stamps increase strictly [s]."""
    count, between, limits = len(time), displacements(name, values), _POSITION if name == "position" else _HEADING
    index = np.arange(count)
    fresh = np.append(0, np.flatnonzero(_norm(between(index[:-1], index[1:])) > _SAME) + 1)
    if len(fresh) < 2 * _BESIDE:
        return Plausible(np.ones(count, bool))
    resolution = float(_norm(np.array([_resolution(column) for column in values.T]))) if name == "position" else 0.0
    steps = _Steps(time, fresh, between, limits, resolution)
    cuts = np.flatnonzero(steps.fault)
    at_cuts = tuple(zip(fresh[cuts + 1].tolist(), steps.off[cuts].tolist(), strict=True))
    nothing = Plausible(np.ones(count, bool), at_cuts, hopeless=len(cuts) > 0)
    if not nothing.hopeless:
        return nothing
    segments = _Segments(steps)
    if (segments.first == segments.last).sum() > 0.5 * len(fresh):
        return nothing
    chain = best_chain(segments.weight, lambda origins, to: segments.links(origins, to)[0])
    if segments.weight[chain].sum() < (1 - limits.lost) * segments.weight.sum():
        return nothing
    ends = np.append(fresh, count)[np.searchsorted(fresh, segments.last[chain]) + 1]
    keep = np.zeros(count, bool)
    for first, end in zip(segments.first[chain], ends, strict=True):
        keep[first:end] = True
    links = ((int(to), *segments.links(np.array([origin]), int(to))) for origin, to in pairwise(chain))
    jumps = tuple((int(segments.first[to]), float(off[0])) for to, cost, off in links if cost[0] > 0)
    return Plausible(keep, jumps)


def held_while_driving(time: Float[np.ndarray, " n"], position: Float[np.ndarray, "n d"]) -> Bool[np.ndarray, " n"]:
    """Mark samples that repeat a position [m] while the vehicle drives on, except for the first of each run.

    A position held to the end of a log is faulty if the vehicle would have had to stop in an instant.
    """
    first = np.append(0, np.flatnonzero(_norm(np.diff(position, axis=0)) > _SAME) + 1)
    held = np.zeros(len(time), bool)
    if len(first) < 2 * _BESIDE:
        return held
    lasts, way = np.diff(time[first]), _norm(np.diff(position[first], axis=0))
    speed = way / lasts
    moves = speed > _MOVES
    usual, stride = (float(np.median(each[moves])) if moves.any() else np.inf for each in (lasts, way))
    steady = way < _UNUSUAL * stride
    driven = np.where(steady & (lasts < 2 * usual), speed, 0.0)
    fastest = np.maximum(np.append(0.0, driven[:-1]), np.append(driven[1:], 0.0))
    hangs = (lasts > max(_HANGS, _UNUSUAL * usual)) & (fastest > _MOVES) & (way > _UNUSUAL * usual * fastest)
    hangs &= np.append(True, steady[:-1])  # a position after a jump is another fault
    for number in np.flatnonzero(hangs):
        held[first[number] + 1 : first[number + 1]] = True
    fast = min(driven[-1], driven[-2])
    if time[-1] - time[first[-1]] > max(_HANGS, _UNUSUAL * usual) and fast > max(_MOVES, _BRAKES * usual):
        held[first[-1] + 1 :] = True
    return held


class _Steps:
    """The s steps between f fresh samples, each the first of a run of equal ones."""

    def __init__(
        self,
        time: Float[np.ndarray, " n"],
        fresh: Int[np.ndarray, " f"],
        between: Between,
        limits: Limits,
        resolution: float,
    ) -> None:
        self.time, self.fresh, self.between, self.limits = time, fresh, between, limits
        self.held = held = np.append(fresh[1:], len(time)) - 1  # last of each run of equal samples
        self.typical = float(np.median(np.diff(time[fresh])))  # sampling time [s]
        self.way = between(fresh[:-1], fresh[1:])  # displacements [s, k] [m]
        self.hold = np.minimum(time[held] - time[fresh], _HELD * self.typical)  # time of repetitions that counts [s]
        self.seconds = np.maximum(time[fresh[1:]] - (time[held] - self.hold)[:-1], self.typical)  # of the steps [s]
        velocity, length = self.way / self.seconds[:, None], _norm(self.way)
        self.off = deviation(self.way, self.seconds, *_beside(velocity))  # distances from the motion beside a step [m]
        usual = min(float(np.median(_norm(velocity))), 0.25 * limits.speed)
        self.least = max(limits.least, limits.least_time * usual) + resolution  # smallest faulty distance [m]
        scatter = np.maximum(median_filter(self.off, _LOCAL, mode="nearest"), np.percentile(self.off, _TYPICAL))
        common = min(3.0 * float(np.percentile(self.off, 99)), limits.common)
        self.noise = np.minimum(_NOISES * scatter, limits.noise) + common  # distances that noise explains [m]
        self.fault = self.off > self.least + self.noise + limits.acceleration * self.seconds**2  # no vehicle makes them
        self.fault |= length > self.least + self.noise + limits.speed * self.seconds


class _Segments:
    """Runs of samples between faulty steps."""

    def __init__(self, steps: _Steps) -> None:
        self.steps, time, fresh, held = steps, steps.time, steps.fresh, steps.held
        cuts = np.flatnonzero(steps.fault)
        starts, ends = np.append(0, cuts + 1), np.append(cuts, len(fresh) - 1)
        path, clock = _summed(steps.way), _summed(steps.seconds)
        reach = np.minimum(_BESIDE, ends - starts)
        span_in, span_out = clock[starts + reach] - clock[starts], clock[ends] - clock[ends - reach]
        with np.errstate(invalid="ignore", divide="ignore"):  # velocities at the ends [m/s]; NaN for a single sample
            self.velocity_in = (path[starts + reach] - path[starts]) / span_in[:, None]
            self.velocity_out = (path[ends] - path[ends - reach]) / span_out[:, None]
        self.first, self.last = fresh[starts], fresh[ends]  # samples
        self.begin = time[fresh[starts]]  # begin, end: times, with repetitions cut short [s]
        self.end = (time[held] - steps.hold)[ends]
        # Time that keeping a segment adds [s].
        self.weight = clock[ends] - clock[starts] + np.maximum(steps.hold[ends], steps.typical)
        last = len(steps.noise) - 1
        self.noise = np.minimum(steps.noise[np.minimum(starts, last)], steps.noise[np.maximum(ends - 1, 0)])
        # Unexplained distances of the steps before and after [m].
        self.entered, self.left = np.append(np.inf, steps.off[cuts]), np.append(steps.off[cuts], np.inf)

    def links(self, origins: Int[np.ndarray, " m"], to: int) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """Return the costs of links from some segments to a later one [s], and their unexplained distances [m].

        A link costs nothing if the vehicle can have driven it.
        """
        limits, least = self.steps.limits, self.steps.least
        way = self.steps.between(self.last[origins], np.full(len(origins), self.first[to]))
        seconds = np.maximum(self.begin[to] - self.end[origins], self.steps.typical)
        before, after = self.velocity_out[origins], np.broadcast_to(self.velocity_in[to], way.shape)
        before, after = np.where(np.isnan(before), after, before), np.where(np.isnan(after), before, after)
        off = deviation(way, seconds, np.nan_to_num(before), np.nan_to_num(after))
        noise = np.maximum(self.noise[origins], self.noise[to])
        excess = np.maximum(
            _norm(way) - limits.speed * seconds - least - noise,
            off - least - limits.acceleration * seconds**2 - noise,
        )
        # Skipped segments must be further off than the segments they are skipped for: a shift in two steps is kept.
        shifted = (origins < to - 1) & (off > 0.5 * np.minimum(self.left[origins], self.entered[to]))
        cost = _JUMP_COST + np.minimum(np.maximum(excess, 0.0) / limits.far, _MOST_COST)
        return np.where((excess > 0) | shifted, cost, 0.0), off


def _beside(velocity: Float[np.ndarray, "s k"]) -> tuple[Float[np.ndarray, "s k"], Float[np.ndarray, "s k"]]:
    """Return the median velocities of the steps before and after each step, mirrored at the ends."""
    padded = np.pad(velocity, ((_BESIDE, _BESIDE), (0, 0)), mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, _BESIDE, axis=0)
    median = np.median(windows, axis=-1)
    return median[: len(velocity)], median[_BESIDE + 1 :]


def _resolution(values: Float[np.ndarray, " n"]) -> float:
    """Return the smallest difference between neighbours [m]: float32 coordinates may be half a metre apart."""
    steps = np.abs(np.diff(values))
    steps = steps[steps > _SAME]
    return min(float(steps.min()), _COARSEST) if len(steps) > 0.01 * len(values) else 0.0


def best_chain(
    weight: Float[np.ndarray, " s"], costs: Callable[[Int[np.ndarray, " m"], int], Float[np.ndarray, " m"]]
) -> Int[np.ndarray, " c"]:
    """Return the chain of segments with the largest total weight less the costs of its links [s].

    Exact for up to `_CANDIDATES` segments; beyond, links start from the best chains so far.
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
    """Return the distance of a step from steps at the velocity before, after, or between the two.

    Shorter steps count as explained, since a late stamp alone makes a step short.
    """
    ahead, behind = before * seconds[:, None], after * seconds[:, None]
    nothing = np.zeros_like(way)
    sides = [_off_line(way, *ends) for ends in ((nothing, ahead), (nothing, behind), (ahead, behind))]
    return np.asarray(np.min(sides, axis=0))


def _off_line(
    point: Float[np.ndarray, "m k"], start: Float[np.ndarray, "m k"], end: Float[np.ndarray, "m k"]
) -> Float[np.ndarray, " m"]:
    """Return the distance of points from line segments."""
    along = end - start
    length = np.einsum("mk,mk->m", along, along)
    share = np.einsum("mk,mk->m", point - start, along) / np.where(length > 0, length, 1.0)
    return _norm(point - start - np.clip(share, 0, 1)[:, None] * along)


def _summed(steps: Float[np.ndarray, "s ..."]) -> Float[np.ndarray, "f ..."]:
    """Return the cumulative sums of steps, from zero."""
    return np.concatenate((np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)))


def _norm(vectors: Float[np.ndarray, "*n k"]) -> Float[np.ndarray, "*n"]:
    return np.asarray(np.linalg.norm(vectors, axis=-1))
