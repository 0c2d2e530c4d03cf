"""Check of channels that are constant while the vehicle moves, e.g. of a stuck sensor or driver."""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from offpiste.core.conventions import SIGMA_PER_MEDIAN
from offpiste.inspection.course import course_minus_heading, straight_rows
from offpiste.inspection.driven_path import MOVING, STEP, DrivenPath
from offpiste.inspection.findings import Finding, of_runs
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.rig.rig import Rig

_HEADINGS: Final = ("orientation", "yaw")
"""Measured headings never stay constant while driving, unlike controls; a constant position is no motion."""
_STEERINGS: Final = ("steer", "steer_angle")
_STRAIGHT, _TURNED = 0.15, 0.7
"""Standard deviation of the yaw rate in a run over its RMS in the drive: maximum for steering held by the driver, and
minimum for weaving."""
_SETTLES: Final = 1.0
"""Response time of the turning after the steering becomes constant [s]."""
_NO_TURN, _SCATTER = np.radians(1.0), 4.0
"""Maximum course change that counts as none while the heading is constant [rad], and in units of its scatter."""
_CONTROLS: Final = ("steer", "throttle", "brake")
"""Controls that drivers hold for some seconds occasionally."""
_LEAST, _LEAST_OF_HEADINGS, _LEAST_OF_CONTROLS = 3.0, 0.4, 4.7
"""Minimum reported duration of a run [s]."""
_UNUSUAL: Final = 20.0
"""Minimum ratio of a reported run to the 99th percentile of the channel's runs ..."""
_ALONE: Final = 3.0
"""... and to the third longest run, as repeated runs are normal driving ..."""
_SAMPLES: Final = 10
"""... and minimum number of samples."""


def check_frozen(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding for each usually varying channel that is constant for a while although the vehicle moves."""
    findings = []
    for name, channel in drive.channels.items():
        if name == "position":
            continue
        begin, _, lasts, turns = _frozen(channel, path, drive.rig)
        if not len(begin):
            continue
        longest = int(lasts.argmax())
        run = f"the longest for {lasts[longest]:.1f} s from {begin[longest] - channel.time[0]:.2f} s on; "
        usual = f"99 % of its other values last {1 / _UNUSUAL:.0%} of that or less"
        run += "the vehicle turns to and fro meanwhile" if turns[longest] else usual
        findings.append(of_runs(name, "holds one value while the vehicle moves", lasts, run, path.driving))
    return findings


def while_held(channel: Channel, path: DrivenPath, rig: Rig, *, beside: float) -> Bool[np.ndarray, " n"]:
    """Return the path rows in which a channel is frozen, with a margin.

    Args:
        beside: margin before and after [s].
    """
    begin, end, *_ = _frozen(channel, path, rig)
    rows = np.zeros(len(path.time), bool)
    for first, last in zip(begin, end, strict=True):
        rows |= (path.time > first - beside) & (path.time < last + beside)
    return rows


def _frozen(
    channel: Channel, path: DrivenPath, rig: Rig
) -> tuple[Float[np.ndarray, " r"], Float[np.ndarray, " r"], Float[np.ndarray, " r"], Bool[np.ndarray, " r"]]:
    """Return start, end and duration in motion [s] of unusually long constant runs, and a mask of runs with turning.

    Heading runs count even if repeated, but only if the course turns.
    """
    changes_alone = channel.name in rig.channels and rig.channels[channel.name].interpolation == "on change"
    again, nothing = channel.name in _HEADINGS, (np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0, bool))
    least = _LEAST_OF_HEADINGS if again else _LEAST_OF_CONTROLS if channel.name in _CONTROLS else _LEAST
    if changes_alone or len(channel.time) < 100:
        return nothing
    changes = np.flatnonzero((np.diff(channel.values, axis=0) != 0).any(axis=1)) + 1
    first, last = np.append(0, changes), np.append(changes, len(channel.time)) - 1
    begin, end = channel.time[first], channel.time[last]
    # For other channels turning is irrelevant: NaN is neither straight nor turning.
    turned = np.full(len(begin), np.nan)
    if channel.name in _STEERINGS:
        turned = _turned(path, np.minimum(begin + _SETTLES, end), end)
    straight, turns = turned <= _STRAIGHT, turned > _TURNED
    # A steering held through a stop stays turned at the standstill, too.
    lasts = _time_in_motion(path, end) - _time_in_motion(path, begin)
    in_motion = _moving(path, begin) | _moving(path, end) | (lasts > least)
    moves = (~_rests(channel)[first] | turns) & in_motion
    if moves.sum() < 50:
        return nothing
    usual = np.sort(lasts[moves])
    alone = max(least, 0.0 if again else _ALONE * float(usual[-3]))
    unusual = np.where(turns, 0.0, _UNUSUAL * float(np.percentile(usual, 99)))
    long = moves & ~straight & (lasts > np.maximum(alone, unusual)) & (last - first >= _SAMPLES)
    if again:
        long[long] = _course_turns(path, begin[long], end[long])
    return begin[long], end[long], lasts[long], turns[long]


def _rests(channel: Channel) -> Bool[np.ndarray, " n"]:
    """Return samples at values where a control rests naturally: zero or an end of its range."""
    if channel.values.shape[1] > 1:
        return np.zeros(len(channel.values), bool)
    values = channel.values[:, 0]
    return np.asarray((values == 0) | (values == values.min()) | (values == values.max()))


def _turned(path: DrivenPath, begin: Float[np.ndarray, " r"], end: Float[np.ndarray, " r"]) -> Float[np.ndarray, " r"]:
    """Return the yaw rate's variation within runs, over its RMS in the drive; it is small for constant steering."""
    rate = np.nan_to_num(path.yaw_rate)
    first, last = np.searchsorted(path.time, begin), np.searchsorted(path.time, end)
    sums = [np.cumsum(np.append(0.0, rate**power)) for power in (1, 2)]
    mean, square = ((total[last] - total[first]) / np.maximum(last - first, 1) for total in sums)
    spread = np.sqrt(np.maximum(square - mean**2, 0.0))
    return np.asarray(spread / max(float(np.sqrt(np.mean(rate**2))), 1e-9))


def _course_turns(
    path: DrivenPath, begin: Float[np.ndarray, " r"], end: Float[np.ndarray, " r"]
) -> Bool[np.ndarray, " r"]:
    """Return True for runs whose course turns by more than noise and slip; straight runs may have constant headings."""
    away, known = course_minus_heading(path), np.isfinite(path.velocity).all(axis=1) & (path.speed > MOVING)
    straight = away[straight_rows(path)]
    scatter = SIGMA_PER_MEDIAN * float(np.median(np.abs(straight - np.median(straight)))) if len(straight) else 0.0
    course = np.unwrap(np.arctan2(path.velocity[known, 1], path.velocity[known, 0]))
    # Velocities at the ends of a run include samples beyond it.
    inside = np.minimum(path.window / 2, (end - begin) / 4)
    first, last = (np.searchsorted(path.time[known], ends) for ends in (begin + inside, end - inside))
    turned = [np.ptp(course[slice(*run)]) if run[1] > run[0] else 0.0 for run in zip(first, last, strict=True)]
    return np.array(turned) > max(_NO_TURN, _SCATTER * scatter)


def _moving(path: DrivenPath, at: Float[np.ndarray, " r"]) -> Bool[np.ndarray, " r"]:
    return np.asarray(np.interp(at, path.time, np.nan_to_num(path.speed)) > MOVING)


def _time_in_motion(path: DrivenPath, until: Float[np.ndarray, " r"]) -> Float[np.ndarray, " r"]:
    """Return the time in motion since the start of the path [s]."""
    return np.asarray(np.interp(until, path.time, np.cumsum(np.nan_to_num(path.speed) > MOVING) * STEP))
