"""Checks of channels that hold one value while the vehicle moves: a stuck sensor or driver, or a lost connection."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.core.conventions import SIGMA_PER_MEDIAN
from offpiste.inspection.course import course_minus_heading, straight_rows
from offpiste.inspection.driven_path import MOVING, STEP, DrivenPath, on_path
from offpiste.inspection.findings import Finding, found, times
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


@dataclass(frozen=True)
class _Run:
    """Consecutive equal samples of a channel.

    Attributes:
        first, last: numbers of its samples.
        begin, end: their stamps [s].
        lasts: duration [s], without standstills if the channel is frozen.
        turns: True if the vehicle turns to and fro meanwhile.
    """

    first: int
    last: int
    begin: float
    end: float
    lasts: float
    turns: bool = False


def check_frozen(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding for each usually varying channel that is constant for a while although the vehicle moves."""
    findings = []
    for name, channel in drive.channels.items():
        runs = [] if name == "position" else _frozen(channel, path, drive.rig)
        if runs:
            code = "frozen_in_turns" if max(runs, key=lambda run: run.lasts).turns else "frozen"
            findings.append(_of_runs(code, channel, runs, path))
    return findings


def check_dropouts(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding for each channel that temporarily drops to a constant value while the vehicle moves.

    Dropouts shared with the pose, e.g. of a motion capture, are reported for the pose only.
    """
    findings, unknown = [], drive.faults.unknown()
    for name in _FALLING:
        channel = drive.channels.get(name)
        if channel is None or len(channel.time) < 100:
            continue
        runs = [run for run in _falls(channel) if _is_moving(path, run.begin)]
        runs = [run for run in runs if not any(after <= run.begin and run.end <= until for after, until in unknown)]
        if name in _RESPONSES and not drive.rig.channels[name].turns:
            runs = [run for run in runs if not _is_followed(channel, run, path, _RESPONSES[name])]
        if runs:
            findings.append(_of_runs("dropouts", channel, runs, path))
    return findings


def _of_runs(code: str, channel: Channel, runs: Sequence[_Run], path: DrivenPath) -> Finding:
    """Return a finding on some runs of a channel."""
    seconds, longest = sum(run.lasts for run in runs), max(runs, key=lambda run: run.lasts)
    about = {
        "times": times(len(runs)) + (f", {seconds:.1f} s in all" if len(runs) > 1 else ""),
        "to": ", ".join(f"{value:.3g}" for value in channel.values[longest.first]),
        "longest": longest.lasts,
        "since": longest.begin - channel.time[0],
        "usual": 1 / _UNUSUAL,
    }
    return found(code, channel.name, about, score=min(seconds / max(path.driving, 1.0), 1.0))


def while_held(channel: Channel, path: DrivenPath, rig: Rig, *, beside: float) -> Bool[np.ndarray, " n"]:
    """Return the path rows in which a channel is frozen, with a margin.

    Args:
        beside: margin before and after [s].
    """
    rows = np.zeros(len(path.time), bool)
    for run in _frozen(channel, path, rig):
        rows |= (path.time > run.begin - beside) & (path.time < run.end + beside)
    return rows


def _constant_runs(values: Float[np.ndarray, "n k"]) -> Int[np.ndarray, "r 2"]:
    """Return the first and the last sample of each run of equal samples."""
    changes = np.flatnonzero((np.diff(values, axis=0) != 0).any(axis=1)) + 1
    return np.stack((np.append(0, changes), np.append(changes, len(values)) - 1), axis=1)


def _frozen(channel: Channel, path: DrivenPath, rig: Rig) -> list[_Run]:
    """Return unusually long runs of equal samples while the vehicle moves.

    Runs of a heading count even if repeated, but only if the course turns.
    """
    heading, least = channel.name in _HEADINGS, _LEAST.get(channel.name, 3.0)
    first, last = _constant_runs(channel.values).T
    begin, end = channel.time[first], channel.time[last]
    driven = np.cumsum(np.nan_to_num(path.speed) > MOVING) * STEP
    lasts = np.interp(end, path.time, driven) - np.interp(begin, path.time, driven)
    # A steering held through a stop stays turned at the standstill, too.
    moves = _is_moving(path, begin) | _is_moving(path, end) | (lasts > least)
    rests = _rests(channel)[first]
    usual = np.sort(lasts[moves & ~rests])
    on_change = channel.name in rig.channels and rig.channels[channel.name].interpolation == "on change"
    if len(channel.time) < 100 or len(usual) < 50 or on_change:
        return []
    least = max(least, 0.0 if heading else _ALONE * float(usual[-3]))
    unusual = _UNUSUAL * float(np.percentile(usual, 99))
    result = []
    for k in np.flatnonzero(moves & (last - first >= _SAMPLES) & (lasts > least)):
        run = _Run(int(first[k]), int(last[k]), float(begin[k]), float(end[k]), float(lasts[k]))
        turned = _turned(path, run) if channel.name in _RESPONSES else None
        straight, turns = (False, False) if turned is None else (turned <= _STRAIGHT, turned > _TURNED)
        strange = turns or (not straight and not rests[k] and lasts[k] > unusual)
        if strange and (not heading or _course_turns(path, run)):
            result.append(replace(run, turns=turns))
    return result


def _rests(channel: Channel) -> Bool[np.ndarray, " n"]:
    """Return samples at values where a control rests naturally: zero or an end of its range."""
    if channel.values.shape[1] > 1:
        return np.zeros(len(channel.values), bool)
    values = channel.values[:, 0]
    return np.asarray((values == 0) | (values == values.min()) | (values == values.max()))


def _turned(path: DrivenPath, run: _Run) -> float:
    """Return the yaw rate's variation within a run, over its RMS in the drive; it is small for constant steering."""
    rate = np.nan_to_num(path.yaw_rate)
    inside = rate[(path.time >= min(run.begin + _SETTLES, run.end)) & (path.time < run.end)]
    return float(inside.std() / max(np.sqrt(np.mean(rate**2)), 1e-9)) if len(inside) else 0.0


def _course_turns(path: DrivenPath, run: _Run) -> bool:
    """Return True if the course turns by more than noise and slip; straight runs may have constant headings."""
    away, known = course_minus_heading(path), np.isfinite(path.velocity).all(axis=1) & (path.speed > MOVING)
    straight = away[straight_rows(path)]
    scatter = SIGMA_PER_MEDIAN * float(np.median(np.abs(straight - np.median(straight)))) if len(straight) else 0.0
    # Velocities at the ends of a run include samples beyond it.
    aside = min(path.window / 2, (run.end - run.begin) / 4)
    inside = known & (path.time >= run.begin + aside) & (path.time < run.end - aside)
    course = np.unwrap(np.arctan2(path.velocity[inside, 1], path.velocity[inside, 0]))
    return len(course) > 0 and bool(np.ptp(course) > max(_NO_TURN, _SCATTER * scatter))


def _is_moving(path: DrivenPath, at: float | Float[np.ndarray, " r"]) -> Bool[np.ndarray, "*r"]:
    return np.asarray(np.interp(np.asarray(at), path.time, np.nan_to_num(path.speed)) > MOVING)


def _falls(channel: Channel) -> list[_Run]:
    """Return constant runs with unusually large steps before and after them."""
    runs, steps = _constant_runs(channel.values), np.abs(np.diff(channel.values, axis=0)).max(axis=1)
    if len(runs) < 2:
        return []
    span = float(np.ptp(channel.values, axis=0).max())
    first, last = runs.T
    ends = np.minimum(np.append(0.0, steps)[first], np.append(steps, 0.0)[last])
    large = ends > max(_LARGER * float(np.percentile(steps[steps > 0], 99)), _SHARE * span)
    falls = large & (last - first + 1 >= _EQUAL)
    others = np.ones(len(steps), bool)
    others[first[falls] - 1] = others[last[falls]] = False
    if ends[falls].min(initial=np.inf) < _LARGEST * steps[others].max(initial=0.0):
        return []
    time = channel.time
    return [_Run(a, b, float(time[a]), float(time[b]), float(time[b] - time[a])) for a, b in runs[falls].tolist()]


def _is_followed(channel: Channel, run: _Run, path: DrivenPath, response: float) -> bool:
    """Return whether the vehicle followed a dropout of the steering, i.e. the wheel was really turned."""
    late, number = channel.time + response, np.arange(len(channel.time))
    fallen = (number >= run.first) & (number <= run.last)
    bridged = np.interp(channel.time, channel.time[~fallen], channel.values[~fallen, 0])
    during = (path.time >= late[run.first]) & (path.time <= late[run.last] + _AFTER)
    errors = []
    for values in (channel.values[:, 0], bridged):
        turn = path.forward * on_path(path, replace(channel, time=late, values=values[:, None]))[:, 0]
        known = np.isfinite(path.yaw_rate + turn)
        others, inside = known & ~during, known & during
        gain = (turn[others] @ path.yaw_rate[others]) / max(float(turn[others] @ turn[others]), 1e-12)
        errors.append(float(np.sum((path.yaw_rate[inside] - gain * turn[inside]) ** 2)))
    return errors[0] < _EXPLAINED * errors[1]
