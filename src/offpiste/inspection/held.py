"""Checks of channels that hold one value while the vehicle moves: a stuck sensor or driver, or a lost connection."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.core.channels import control_of
from offpiste.core.conventions import SIGMA_PER_MEDIAN
from offpiste.inspection.course import course_minus_heading, straight_rows
from offpiste.inspection.driven_path import MOVING, STEP, DrivenPath, on_path
from offpiste.inspection.findings import Finding, found
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.rig.rig import Rig

_RESPONSES: Final = {"steer": 0.1, "steer_angle": 0.0}
"""Steerings, with the usual response times of the yaw rate [s]."""
_HEADINGS: Final = ("orientation", "yaw")
"""Measured headings never stay constant while driving, unlike controls; a constant position is no motion."""
_STRAIGHT, _TURNED = 0.15, 0.7
"""Standard deviation of the yaw rate in a run over its RMS in the drive: maximum for steering held by the driver, and
minimum for weaving."""
_SETTLES: Final = 1.0
"""Response time of the turning after the steering becomes constant [s]."""
_NO_TURN, _SCATTER = np.radians(1.0), 4.0
"""Maximum course change that counts as none while the heading is constant [rad], and in units of its scatter."""
_LEAST: Final = {"orientation": 0.4, "yaw": 0.4, "steer": 4.7, "throttle": 4.7, "brake": 4.7}
"""Minimum reported duration of a run [s], 3 s for other channels; drivers hold controls for some seconds."""
_UNUSUAL: Final = 20.0
"""Minimum ratio of a reported run to the 99th percentile of the channel's runs ..."""
_ALONE: Final = 3.0
"""... and to the third longest run, as repeated runs are normal driving ..."""
_SAMPLES: Final = 10
"""... and minimum number of samples."""
_FALLING: Final = (*_RESPONSES, "linear_velocity", "angular_velocity", "yaw_rate", "wheel_speed")
"""Channels that change continuously, unlike pedals, which may be released instantly."""
_EQUAL: Final = 4
"""Minimum number of equal samples in a dropout; fewer are spikes."""
_LARGER: Final = 4.0
"""Minimum ratio of the steps into and out of a dropout to the 99th percentile of the channel's steps ..."""
_LARGEST: Final = 1.5
"""... and to the largest of all other steps, as a driver may turn the wheel abruptly ..."""
_SHARE: Final = 0.05
"""... and minimum share of the channel's range."""
_AFTER: Final = 0.3
"""Time after a dropout in which its steering still acts [s]."""
_EXPLAINED: Final = 0.5
"""Maximum remaining share of the yaw rate's squared error if the vehicle follows the dropout."""


def check_frozen(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding for each usually varying channel that is constant for a while although the vehicle moves."""
    findings = []
    for name, channel in drive.channels.items():
        begin, _, lasts, turns = _frozen(channel, path, drive.rig)
        if name == "position" or not len(begin):
            continue
        code = "frozen_in_turns" if turns[lasts.argmax()] else "frozen"
        findings.append(_of_runs(code, channel, begin, lasts, path, {"usual": 1 / _UNUSUAL}))
    return findings


def check_dropouts(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding for each channel that temporarily drops to a constant value while the vehicle moves.

    Dropouts shared with the pose, e.g. of a motion capture, are reported for the pose only.
    """
    findings = []
    for name in _FALLING:
        channel = drive.channels.get(name)
        if channel is None or len(channel.time) < 100:
            continue
        runs = _falls(channel.values)
        if len(runs) == 1 and _at_its_end(name, channel.values[runs[0, 0]]):
            continue  # full lock in an emergency
        if name in _RESPONSES and not drive.rig.channels[name].turns:
            runs = runs[~_followed(channel, runs, path, _RESPONSES[name])]
        begin, end = channel.time[runs].T
        unknown = [(begin >= after) & (end <= until) for after, until in drive.faults.unknown()]
        shown = _moving(path, begin) & ~np.any(unknown, axis=0)
        if not shown.any():
            continue
        runs, begin, lasts = runs[shown], begin[shown], (end - begin)[shown]
        to = ", ".join(f"{value:.3g}" for value in channel.values[runs[lasts.argmax(), 0]])
        findings.append(_of_runs("dropouts", channel, begin, lasts, path, {"to": to}))
    return findings


def _of_runs(
    code: str,
    channel: Channel,
    begin: Float[np.ndarray, " r"],
    lasts: Float[np.ndarray, " r"],
    path: DrivenPath,
    about: Mapping[str, Any],
) -> Finding:
    """Return a finding on runs of samples, by their starts and durations [s]."""
    times = "once" if len(lasts) == 1 else f"{len(lasts)} times, {lasts.sum():.1f} s in all"
    share, since = min(float(lasts.sum()) / max(path.driving, 1.0), 1.0), begin[lasts.argmax()] - channel.time[0]
    return found(code, channel.name, {"times": times, "longest": lasts.max(), "since": since, **about}, score=share)


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


def _constant_runs(values: Float[np.ndarray, "n k"]) -> Int[np.ndarray, "r 2"]:
    """Return the first and the last sample of each run of equal samples."""
    changes = np.flatnonzero((np.diff(values, axis=0) != 0).any(axis=1)) + 1
    return np.stack((np.append(0, changes), np.append(changes, len(values)) - 1), axis=1)


def _frozen(
    channel: Channel, path: DrivenPath, rig: Rig
) -> tuple[Float[np.ndarray, " r"], Float[np.ndarray, " r"], Float[np.ndarray, " r"], Bool[np.ndarray, " r"]]:
    """Return start, end and duration in motion [s] of unusually long constant runs, and a mask of runs with turning.

    Heading runs count even if repeated, but only if the course turns.
    """
    heading, least = channel.name in _HEADINGS, _LEAST.get(channel.name, 3.0)
    first, last = _constant_runs(channel.values).T
    begin, end = channel.time[first], channel.time[last]
    # For other channels turning is irrelevant: NaN is neither straight nor turning.
    turned = np.full(len(begin), np.nan)
    if channel.name in _RESPONSES:
        turned = _turned(path, np.minimum(begin + _SETTLES, end), end)
    turns = turned > _TURNED
    # A steering held through a stop stays turned at the standstill, too.
    lasts = _time_in_motion(path, end) - _time_in_motion(path, begin)
    in_motion = _moving(path, begin) | _moving(path, end) | (lasts > least)
    moves = (~_rests(channel)[first] | turns) & in_motion
    long = np.zeros(len(begin), bool)
    on_change = channel.name in rig.channels and rig.channels[channel.name].interpolation == "on change"
    if len(channel.time) >= 100 and moves.sum() >= 50 and not on_change:
        usual = np.sort(lasts[moves])
        alone = 0.0 if heading else _ALONE * float(usual[-3])
        unusual = np.where(turns, 0.0, _UNUSUAL * float(np.percentile(usual, 99)))
        long = moves & ~(turned <= _STRAIGHT) & (last - first >= _SAMPLES)
        long &= lasts > np.maximum(unusual, max(least, alone))
    if heading:
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


def _falls(values: Float[np.ndarray, "n k"]) -> Int[np.ndarray, "r 2"]:
    """Return the first and last samples of constant runs with unusually large steps before and after them."""
    runs, steps = _constant_runs(values), np.abs(np.diff(values, axis=0)).max(axis=1)
    if len(runs) < 2:
        return runs[:0]
    least = max(_LARGER * float(np.percentile(steps[steps > 0], 99)), _SHARE * float(np.ptp(values, axis=0).max()))
    first, last = runs.T
    ends = np.minimum(np.append(0.0, steps)[first], np.append(steps, 0.0)[last])
    falls = (ends > least) & (last - first + 1 >= _EQUAL)
    others = np.ones(len(steps), bool)
    others[first[falls] - 1] = others[last[falls]] = False
    usual = ends[falls].min(initial=np.inf) < _LARGEST * steps[others].max(initial=0.0)
    return runs[:0] if usual else runs[falls]


def _followed(
    channel: Channel, runs: Int[np.ndarray, "r 2"], path: DrivenPath, response: float
) -> Bool[np.ndarray, " r"]:
    """Return for each steering dropout whether the vehicle followed it, i.e. the wheel was really turned."""
    fallen = np.zeros(len(channel.time), bool)
    for first, last in runs:
        fallen[first : last + 1] = True
    bridged = np.interp(channel.time, channel.time[~fallen], channel.values[~fallen, 0])[:, None]
    late = channel.time + response
    both = (replace(channel, time=late, values=values) for values in (channel.values, bridged))
    turns = [path.forward * on_path(path, steering)[:, 0] for steering in both]
    known = np.isfinite(np.stack((path.yaw_rate, *turns))).all(axis=0)
    result = []
    for first, last in runs:
        during = known & (path.time >= late[first]) & (path.time <= late[last] + _AFTER)
        others = known & ~during
        errors = []
        for turn in turns:
            gain = (turn[others] @ path.yaw_rate[others]) / max(float(turn[others] @ turn[others]), 1e-12)
            errors.append(float(np.sum((path.yaw_rate[during] - gain * turn[during]) ** 2)))
        result.append(errors[0] < _EXPLAINED * errors[1])
    return np.array(result, bool)


def _at_its_end(name: str, value: Float[np.ndarray, " k"]) -> bool:
    """Return True if a control is at an end of its range."""
    control = control_of(name)
    return control is not None and bool((np.isclose(value, control.low) | np.isclose(value, control.high)).all())
