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
from scipy.ndimage import binary_opening, median_filter
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
_LONG: Final = 0.2
"""Time over which the speed of a noisy pose is known [s]."""
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
    jumps: Int[np.ndarray, " j"]  # kept samples that follow a remaining jump
    hopeless: bool = False  # nothing was dropped, since too much would have been


def plausible_positions(
    time: Float[np.ndarray, " n"], position: Float[np.ndarray, "n d"], limits: Limits = _POSITION
) -> Plausible:
    """Find plausible positions in two or three dimensions [m]; stamps increase strictly [s]."""
    resolution = float(np.linalg.norm([_resolution(column) for column in position.T]))
    return _plausible(time, lambda first, last: position[last] - position[first], limits, resolution)


def plausible_headings(
    time: Float[np.ndarray, " n"], heading: Float[np.ndarray, "n q"], limits: Limits = _HEADING
) -> Plausible:
    """Find plausible headings: yaw [rad], wrapped or not, or quaternions xyzw; stamps increase strictly [s]."""
    if heading.shape[1] == 1:
        return _plausible(
            time, lambda first, last: (heading[last] - heading[first] + np.pi) % (2 * np.pi) - np.pi, limits
        )
    turned = Rotation.from_quat(heading)
    return _plausible(time, lambda first, last: (turned[last] * turned[first].inv()).as_rotvec(), limits)


def held_while_driving(time: Float[np.ndarray, " n"], position: Float[np.ndarray, "n d"]) -> Bool[np.ndarray, " n"]:
    """Mark samples that repeat a position [m] while the vehicle drives on, except for the first of each run.

    A position held to the end of a log is faulty if the vehicle would have had to stop in an instant.
    """
    steps = np.linalg.norm(np.diff(position, axis=0), axis=1)
    first = np.append(0, np.flatnonzero(steps > _SAME) + 1)
    held = np.zeros(len(time), bool)
    if len(first) < 2 * _BESIDE:
        return held
    lasts, way = np.diff(time[first]), np.linalg.norm(np.diff(position[first], axis=0), axis=1)
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


def _plausible(time: Float[np.ndarray, " n"], between: Between, limits: Limits, resolution: float = 0.0) -> Plausible:
    count = len(time)
    everything = Plausible(np.ones(count, bool), np.zeros(0, int))
    index = np.arange(count)
    fresh = np.append(0, np.flatnonzero(np.linalg.norm(between(index[:-1], index[1:]), axis=1) > _SAME) + 1)
    if len(fresh) < 2 * _BESIDE:
        return everything
    held = np.append(fresh[1:], count) - 1
    typical = float(np.median(np.diff(time[fresh])))
    until = np.minimum(time[held], time[fresh] + _HELD * typical)
    way, seconds = between(fresh[:-1], fresh[1:]), _durations(time, fresh, held, typical)
    velocity = way / seconds[:, None]
    off = deviation(way, seconds, *_beside(velocity))
    usual = min(float(np.median(np.linalg.norm(velocity, axis=1))), 0.25 * limits.speed)
    least = max(limits.least, limits.least_time * usual) + resolution
    scatter = np.maximum(median_filter(off, _LOCAL, mode="nearest"), np.percentile(off, _TYPICAL))
    noise = np.minimum(_NOISES * scatter, limits.noise)
    noise += min(3.0 * float(np.percentile(off, 99)), limits.common)
    fault = off > least + noise + limits.acceleration * seconds**2
    fault |= np.linalg.norm(way, axis=1) > least + noise + limits.speed * seconds
    fast = _too_fast_for_long(way, seconds, noise, limits.speed, typical)
    fault |= fast
    if not fault.any():
        return everything
    segments = _segments(fresh, held, time, until, way, seconds, noise, off, fault, typical)
    hopeless = Plausible(everything.keep, everything.jumps, hopeless=True)
    single = segments.first == segments.last
    if single.sum() > 0.5 * len(fresh):
        return hopeless

    def costs(origins: np.ndarray, to: int) -> np.ndarray:
        return segments.costs(origins, to, between, limits, least, typical)

    on_its_way = single & np.append(fast, fast[-1])[np.searchsorted(fresh, segments.first)]
    others = np.flatnonzero(~on_its_way)
    chain = others[best_chain(segments.weight[others], lambda origins, to: costs(others[origins], int(others[to])))]
    if segments.weight[chain].sum() < (1 - limits.lost) * segments.weight.sum():
        return hopeless
    ends = np.append(fresh, count)[np.searchsorted(fresh, segments.last[chain]) + 1]
    keep = np.zeros(count, bool)
    for first, end in zip(segments.first[chain], ends, strict=True):
        keep[first:end] = True
    links = pairwise(chain.tolist())
    jumps = [segments.first[to] for origin, to in links if costs(np.array([origin]), to)[0] > 0]
    return Plausible(keep, np.array(jumps, int))


def _durations(
    time: Float[np.ndarray, " n"], fresh: Int[np.ndarray, " f"], held: Int[np.ndarray, " f"], typical: float
) -> Float[np.ndarray, " s"]:
    """Return the durations of steps [s], from the last repetition of a sample, and never shorter than typical."""
    hold = np.minimum(time[held[:-1]] - time[fresh[:-1]], _HELD * typical)
    return np.maximum(time[fresh[1:]] - time[held[:-1]] + hold, typical)


def _too_fast_for_long(
    way: Float[np.ndarray, "s k"],
    seconds: Float[np.ndarray, " s"],
    noise: Float[np.ndarray, " s"],
    speed: float,
    typical: float,
) -> Bool[np.ndarray, " s"]:
    """Mark runs of steps above a speed, which is also exceeded over the time before or after them."""
    count = min(max(_BESIDE, int(np.ceil(_LONG / typical))), len(way))
    path, clock = _summed(way), _summed(seconds)
    over = np.linalg.norm(path[count:] - path[:-count], axis=1) / (clock[count:] - clock[:-count])
    padding = np.full(count - 1, -np.inf)
    fast = np.maximum(np.append(padding, over), np.append(over, padding)) > speed + noise / (count * typical)
    fast &= np.linalg.norm(way, axis=1) > speed * seconds
    return np.asarray(binary_opening(fast, np.ones(_BESIDE)))


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


@dataclass(frozen=True)
class _Segments:
    """Runs of samples without a fault between them; repeated samples count once."""

    first: Int[np.ndarray, " s"]  # first, last: first and last samples
    last: Int[np.ndarray, " s"]
    begin: Float[np.ndarray, " s"]  # begin, end: times of these samples [s]; repetitions are cut short
    end: Float[np.ndarray, " s"]
    weight: Float[np.ndarray, " s"]  # time that keeping a segment adds [s]
    velocity_in: Float[np.ndarray, "s k"]  # velocity_in, velocity_out: NaN for a single sample [m/s]
    velocity_out: Float[np.ndarray, "s k"]
    span: Float[np.ndarray, " s"]  # time over which these velocities are estimated [s]
    noise: Float[np.ndarray, " s"]  # noise of a step [m]
    entered: Float[np.ndarray, " s"]  # entered, left: unexplained distance of the steps before and after a segment [m]
    left: Float[np.ndarray, " s"]

    def costs(
        self, origins: Int[np.ndarray, " m"], to: int, between: Between, limits: Limits, least: float, typical: float
    ) -> Float[np.ndarray, " m"]:
        """Return the costs of links from some segments to a later one [s]; 0 if the vehicle can have driven them.

        Args:
            least: smallest faulty step [m].
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
        # Skipped segments must be further off than the segments they are skipped for: a shift in two steps is kept.
        shifted = (origins < to - 1) & (off > 0.5 * np.minimum(self.left[origins], self.entered[to]))
        cost = _JUMP_COST + np.minimum(np.maximum(excess, 0.0) / limits.far, _MOST_COST)
        return np.where((excess > 0) | shifted, cost, 0.0)


def _segments(
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
) -> _Segments:
    """Return the segments between faulty steps, from f samples without repetitions and the s = f - 1 steps between."""
    starts = np.append(0, np.flatnonzero(fault) + 1)
    ends = np.append(np.flatnonzero(fault), len(fresh) - 1)
    path, clock = _summed(way), _summed(seconds)
    reach = np.minimum(_BESIDE, ends - starts)
    inner = np.where(reach > 0, 1.0, np.nan)
    span_in, span_out = clock[starts + reach] - clock[starts], clock[ends] - clock[ends - reach]
    with np.errstate(invalid="ignore", divide="ignore"):
        velocity_in = (path[starts + reach] - path[starts]) / (span_in * inner)[:, None]
        velocity_out = (path[ends] - path[ends - reach]) / (span_out * inner)[:, None]
    return _Segments(
        fresh[starts],
        fresh[ends],
        time[fresh[starts]],
        time[held[ends]] - np.minimum(time[held[ends]] - time[fresh[ends]], _HELD * typical),
        clock[ends] - clock[starts] + np.maximum(until[ends] - time[fresh[ends]], typical),
        velocity_in,
        velocity_out,
        np.maximum(np.minimum(span_in, span_out), typical),
        np.minimum(noise[np.minimum(starts, len(noise) - 1)], noise[np.maximum(ends - 1, 0)]),
        np.append(np.inf, off[fault]),
        np.append(off[fault], np.inf),
    )


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
    return np.asarray(np.linalg.norm(point - start - np.clip(share, 0, 1)[:, None] * along, axis=1))


def _summed(steps: Float[np.ndarray, "s ..."]) -> Float[np.ndarray, "f ..."]:
    """Return the cumulative sums of steps, from zero."""
    return np.concatenate((np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)))
