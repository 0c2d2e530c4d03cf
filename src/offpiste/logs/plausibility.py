"""Samples of a pose that no vehicle makes: corrupt runs to drop, places held while it drives on, and jumps that stay.

The samples are cut into segments at steps that are too fast, or that the velocity before and after does not explain.
Of all chains of segments the one that keeps the most time is chosen: a link from one segment to a later one is free
where the vehicle could have driven it, and costs time where it is a jump. A run that returns to where it left is
therefore dropped; a shift that lasts is kept, as a jump.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_opening, median_filter
from scipy.spatial.transform import Rotation

from offpiste.logs.pose_segments import BESIDE, HELD, Between, Limits, best_chain, deviation, segments_of, summed

POSITION: Final = Limits(120.0, 20.0, 0.1, 0.05, 8.0, 1.0, 5.0, 0.5)
HEADING: Final = Limits(30.0, 60.0, 0.15, 0.0, np.inf, 0.2, 0.2, 0.1)
"""Headings may be noise at a standstill (courses of GPS), so that local scatter of any size is taken for noise."""

_LOCAL: Final = 25
"""Steps whose median deviation is the local scatter."""
_USUAL: Final = 70.0
"""Percentile of the deviations that is the scatter everywhere; half of them are 0, as short ways are explained."""
_NOISES: Final = 10.0
"""Multiple of the scatter that no noise reaches."""
_LONG: Final = 0.2
"""Time over which the speed of a noisy pose is known [s]."""
_COARSEST: Final = 1.0
"""Largest resolution of coordinates: float32 beyond 8000 km [m]."""
_SAME: Final = 1e-9
"""Samples that differ by less are one that repeats [m or rad]."""
_HANGS, _UNUSUAL = 0.5, 5.0
"""A place is held by a sensor that hangs from this time on [s], if it is so many times as long as others are held, and
the next step leads so many times as far as others."""
_MOVES: Final = 1.5
"""Speed just before or after such a time [m/s]: nobody stops or starts in an instant."""
_BRAKES: Final = 15.0
"""No vehicle slows down by more [m/s^2]: one whose place does so, and then stays the same to the end, drove on."""


@dataclass(frozen=True)
class Plausible:
    """Which samples a vehicle can have made.

    Attributes:
        keep: samples that stay.
        jumps: kept samples before which a jump remains.
        hopeless: nothing was dropped, as too much would have been.
    """

    keep: Bool[np.ndarray, " n"]
    jumps: Int[np.ndarray, " j"]
    hopeless: bool = False


def plausible_positions(
    time: Float[np.ndarray, " n"], position: Float[np.ndarray, "n d"], limits: Limits = POSITION
) -> Plausible:
    """Positions that a vehicle can have been at, in two or three dimensions [m].

    Args:
        time: stamps, strictly increasing [s].
    """
    resolution = float(np.linalg.norm([_resolution(column) for column in position.T]))
    return _plausible(time, lambda first, last: position[last] - position[first], limits, resolution)


def held_while_driving(time: Float[np.ndarray, " n"], position: Float[np.ndarray, "n d"]) -> Bool[np.ndarray, " n"]:
    """Samples that repeat a place while the vehicle drives on, as of a sensor that hangs; the first of each is none.

    To the end of a log it hangs where the vehicle would have had to stop in an instant.

    Args:
        time: stamps, strictly increasing [s].
        position: [m].
    """
    steps = np.linalg.norm(np.diff(position, axis=0), axis=1)
    first = np.append(0, np.flatnonzero(steps > _SAME) + 1)
    held = np.zeros(len(time), bool)
    if len(first) < 2 * BESIDE:
        return held
    lasts, way = np.diff(time[first]), np.linalg.norm(np.diff(position[first], axis=0), axis=1)
    speed = way / lasts
    moves = speed > _MOVES
    usual, stride = (float(np.median(each[moves])) if moves.any() else np.inf for each in (lasts, way))
    steady = way < _UNUSUAL * stride
    driven = np.where(steady & (lasts < 2 * usual), speed, 0.0)
    fastest = np.maximum(np.append(0.0, driven[:-1]), np.append(driven[1:], 0.0))
    hangs = (lasts > max(_HANGS, _UNUSUAL * usual)) & (fastest > _MOVES) & (way > _UNUSUAL * usual * fastest)
    hangs &= np.append(True, steady[:-1])  # a place that it jumped to is another fault
    for number in np.flatnonzero(hangs):
        held[first[number] + 1 : first[number + 1]] = True
    fast = min(driven[-1], driven[-2])
    if time[-1] - time[first[-1]] > max(_HANGS, _UNUSUAL * usual) and fast > max(_MOVES, _BRAKES * usual):
        held[first[-1] + 1 :] = True
    return held


def plausible_headings(
    time: Float[np.ndarray, " n"], heading: Float[np.ndarray, "n q"], limits: Limits = HEADING
) -> Plausible:
    """Headings that a vehicle can have had.

    Args:
        time: stamps, strictly increasing [s].
        heading: yaw [rad], wrapped or not, or quaternions xyzw.
    """
    if heading.shape[1] == 1:
        return _plausible(
            time, lambda first, last: (heading[last] - heading[first] + np.pi) % (2 * np.pi) - np.pi, limits
        )
    turned = Rotation.from_quat(heading)
    return _plausible(time, lambda first, last: (turned[last] * turned[first].inv()).as_rotvec(), limits)


def _plausible(time: Float[np.ndarray, " n"], between: Between, limits: Limits, resolution: float = 0.0) -> Plausible:
    count = len(time)
    everything = Plausible(np.ones(count, bool), np.zeros(0, int))
    index = np.arange(count)
    fresh = np.append(0, np.flatnonzero(np.linalg.norm(between(index[:-1], index[1:]), axis=1) > _SAME) + 1)
    if len(fresh) < 2 * BESIDE:
        return everything
    held = np.append(fresh[1:], count) - 1
    typical = float(np.median(np.diff(time[fresh])))
    until = np.minimum(time[held], time[fresh] + HELD * typical)
    way, seconds = between(fresh[:-1], fresh[1:]), _durations(time, fresh, held, typical)
    velocity = way / seconds[:, None]
    before, after = _beside(velocity)
    off = deviation(way, seconds, before, after)
    usual = min(float(np.median(np.linalg.norm(velocity, axis=1))), 0.25 * limits.speed)
    least = max(limits.least, limits.least_time * usual) + resolution
    scatter = np.maximum(median_filter(off, _LOCAL, mode="nearest"), np.percentile(off, _USUAL))
    noise = np.minimum(_NOISES * scatter, limits.noise)
    noise += min(3.0 * float(np.percentile(off, 99)), limits.common)
    fault = off > least + noise + limits.acceleration * seconds**2
    fault |= np.linalg.norm(way, axis=1) > least + noise + limits.speed * seconds
    fast = _too_fast_for_long(way, seconds, noise, limits.speed, typical)
    fault |= fast
    if not fault.any():
        return everything
    segments = segments_of(fresh, held, time, until, way, seconds, noise, off, fault, typical)
    if np.mean(segments.first == segments.last) * len(segments.first) > 0.5 * len(fresh):
        return Plausible(everything.keep, everything.jumps, hopeless=True)

    def costs(origins: np.ndarray, to: int) -> np.ndarray:
        return segments.costs(origins, to, between, limits, least, typical)

    on_its_way = (segments.first == segments.last) & np.append(fast, fast[-1])[np.searchsorted(fresh, segments.first)]
    others = np.flatnonzero(~on_its_way)
    chain = others[best_chain(segments.weight[others], lambda origins, to: costs(others[origins], int(others[to])))]
    if segments.weight[chain].sum() < (1 - limits.lost) * segments.weight.sum():
        return Plausible(everything.keep, everything.jumps, hopeless=True)
    ends = np.append(fresh, count)[np.searchsorted(fresh, segments.last[chain]) + 1]
    keep = np.zeros(count, bool)
    for first, end in zip(segments.first[chain], ends, strict=True):
        keep[first:end] = True
    links = list(pairwise(chain.tolist()))
    jumps = [segments.first[to] for origin, to in links if costs(np.array([origin]), to)[0] > 0]
    return Plausible(keep, np.array(jumps, int))


def _durations(
    time: Float[np.ndarray, " n"], fresh: Int[np.ndarray, " f"], held: Int[np.ndarray, " f"], typical: float
) -> Float[np.ndarray, " s"]:
    """Times that steps took [s]: a sample may be held until the next one, and stamps of a burst are too close."""
    hold = np.minimum(time[held[:-1]] - time[fresh[:-1]], HELD * typical)
    return np.maximum(time[fresh[1:]] - time[held[:-1]] + hold, typical)


def _too_fast_for_long(
    way: Float[np.ndarray, "s k"],
    seconds: Float[np.ndarray, " s"],
    noise: Float[np.ndarray, " s"],
    speed: float,
    typical: float,
) -> Bool[np.ndarray, " s"]:
    """Runs of steps at more than a speed, as the path just before or after them was: noise cannot hide that."""
    count = min(max(BESIDE, int(np.ceil(_LONG / typical))), len(way))
    path, clock = summed(way), summed(seconds)
    over = np.linalg.norm(path[count:] - path[:-count], axis=1) / (clock[count:] - clock[:-count])
    until = np.append(np.full(count - 1, -np.inf), over)
    since = np.append(over, np.full(count - 1, -np.inf))
    fast = np.maximum(until, since) > speed + noise / (count * typical)
    fast &= np.linalg.norm(way, axis=1) > speed * seconds
    return np.asarray(binary_opening(fast, np.ones(BESIDE)))


def _beside(velocity: Float[np.ndarray, "s k"]) -> tuple[Float[np.ndarray, "s k"], Float[np.ndarray, "s k"]]:
    """Median velocities of the steps before and after each step, mirrored at the ends; the step itself is left out."""
    padded = np.pad(velocity, ((BESIDE, BESIDE), (0, 0)), mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, BESIDE, axis=0)
    median = np.median(windows, axis=-1)
    return median[: len(velocity)], median[BESIDE + 1 :]


def _resolution(values: Float[np.ndarray, " n"]) -> float:
    """Smallest difference between neighbours: coordinates in float32 may be half a metre apart [m]."""
    steps = np.abs(np.diff(values))
    steps = steps[steps > _SAME]
    return min(float(steps.min()), _COARSEST) if len(steps) > 0.01 * len(values) else 0.0
