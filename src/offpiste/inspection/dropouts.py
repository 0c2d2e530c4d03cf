"""Check of channels that temporarily drop to a constant value, as after a lost connection."""

from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.core.channels import control_of
from offpiste.inspection.driven_path import MOVING, DrivenPath, on_path
from offpiste.inspection.findings import Finding, of_runs
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive

_CHECKED: Final = ("steer", "steer_angle", "linear_velocity", "angular_velocity", "yaw_rate", "wheel_speed")
"""Channels that change continuously, unlike pedals, which may be released instantly."""
_LEAST: Final = 4
"""Minimum number of equal samples in a dropout; fewer are spikes."""
_USUAL: Final = 99.0
"""Percentile of the channel's non-zero steps."""
_LARGER: Final = 4.0
"""Minimum ratio of the steps into and out of a dropout to that percentile ..."""
_LARGEST: Final = 1.5
"""... and to the largest of all other steps, as a driver may turn the wheel abruptly ..."""
_SHARE: Final = 0.05
"""... and minimum share of the channel's range."""
_RESPONSES: Final = {"steer": 0.1, "steer_angle": 0.0}
"""Usual response times of the yaw rate to the steering [s]."""
_AFTER: Final = 0.3
"""Time after a dropout in which its steering still acts [s]."""
_EXPLAINED: Final = 0.5
"""Maximum remaining share of the yaw rate's squared error if the vehicle follows the dropout."""


def check_dropouts(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding for each channel that temporarily drops to a constant value while the vehicle moves.

    Dropouts shared with the pose, e.g. of a motion capture, are reported for the pose only.
    """
    findings = []
    for name in _CHECKED:
        if name not in drive.channels or len(drive.channels[name].time) < 100:
            continue
        channel = drive.channels[name]
        runs = _falls(channel.values)
        if len(runs) == 1 and _at_its_end(name, channel.values[runs[0, 0]]):
            continue  # full lock in an emergency
        if name in _RESPONSES and not drive.rig.channels[name].turns:
            runs = runs[~_followed(channel, runs, path, _RESPONSES[name])]
        begin, end = channel.time[runs[:, 0]], channel.time[runs[:, 1]]
        moving = np.interp(begin, path.time, np.nan_to_num(path.speed)) > MOVING
        for after, until in drive.faults.unknown():
            moving &= (begin < after) | (end > until)
        if not moving.any():
            continue
        begin, lasts = begin[moving], (end - begin)[moving]
        longest = int(lasts.argmax())
        to = ", ".join(f"{value:.3g}" for value in channel.values[runs[moving][longest, 0]])
        run = f"to {to} for {lasts[longest]:.1f} s from {begin[longest] - channel.time[0]:.2f} s on"
        run += "; the steps there and back are no other's size"
        findings.append(of_runs(name, "falls to one value and comes back", lasts, run, path.driving))
    return findings


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


def _falls(values: Float[np.ndarray, "n k"]) -> Int[np.ndarray, "r 2"]:
    """Return the first and last samples of constant runs with unusually large steps before and after them."""
    steps = np.abs(np.diff(values, axis=0)).max(axis=1)
    if not (steps > 0).any():
        return np.zeros((0, 2), int)
    least = max(_LARGER * float(np.percentile(steps[steps > 0], _USUAL)), _SHARE * float(np.ptp(values, axis=0).max()))
    changes = np.flatnonzero(steps > 0) + 1
    first, last = np.append(0, changes), np.append(changes, len(values)) - 1
    into, out = np.append(0.0, steps), np.append(steps, 0.0)
    falls = (into[first] > least) & (out[last] > least) & (last - first + 1 >= _LEAST)
    others = np.ones(len(steps), bool)
    others[first[falls] - 1] = others[last[falls]] = False
    if np.minimum(into[first], out[last])[falls].min(initial=np.inf) < _LARGEST * steps[others].max(initial=0.0):
        return np.zeros((0, 2), int)
    return np.stack((first, last), axis=1)[falls]
