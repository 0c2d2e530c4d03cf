"""Checks of channels that are cut off at a limit, or recorded in coarse steps.

The peaks of a driver's presses differ, and the largest occurs once. At a limit, many samples or presses end at exactly
the same value after passing values in between (switches jump, and levers have few steps). Such a limit is a fault if
the vehicle turns further there than the other samples predict, or if a control ends well within its range.
"""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from offpiste.core.channels import CONTROLS
from offpiste.inspection.driven_path import TURNING, DrivenPath
from offpiste.inspection.findings import Finding, Severity, found
from offpiste.inspection.lags import LAGS, SURE, fit_lags, lagged
from offpiste.inspection.response import moving_rows
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.rig.edits import rescaled
from offpiste.rig.rig import Rig

_PILED: Final = 0.04
"""Minimum share of samples exactly at one of the two ends."""
_ROUNDING: Final = 1e-6
_NEAR: Final = 0.98
"""Minimum share of the maximum for a sample at the end."""
_FURTHER, _FURTHER_AT_LOCK = 0.1, 0.5
"""Minimum excess of turning at the ends over the prediction, and for a command that ends at 1: at full lock, slip
reduces the turning, and slow actuators turn furthest while it is held there."""
_WHOLE: Final = 0.9
"""Minimum share of its range that a fault-free control reaches; stops and trims may be slightly below 1."""
_ENDS: Final = 5
"""Minimum number of presses that end at the limit."""
_CROWDED: Final = 3.0
"""Minimum ratio of the presses that end at the limit to the mean per value between `_BELOW` and the limit."""
_BELOW, _BETWEEN = 0.8, 0.3
"""Minimum shares of the limit of a value just below it, and of one on the way to it; switches jump from below."""
_LEVELS: Final = 12
"""Minimum number of values below the limit; levers with fewer steps and keys repeat the same peak."""
_EVEN: Final = 0.01
"""Maximum deviation of value differences from multiples of the step, as a share of the step."""
_ONE_BY_ONE: Final = 0.8
"""Minimum share of changes by one step; keys and switches cause larger changes."""
_COARSE_LEVELS: Final = (4, 12)
"""Range of the number of levels of a coarse steering; fewer levels indicate a switch."""
_COARSE: Final = {"position": (0.05, 0.03), "linear_velocity": (0.05, 0.1)}
"""Maximum acceptable step [m, m/s], and as a share of the cruising speed (of the distance driven in a second)."""


def check_cut_off(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding for each clipped channel among `steer`, `steer_angle` and `yaw_rate`."""
    if np.nanstd(path.yaw_rate) < TURNING:
        return []
    findings = []
    for name in ("steer", "steer_angle", "yaw_rate"):
        channel = drive.channels.get(name)
        if channel is None or drive.rig.channels[name].turns:  # turning on the spot exceeds any steering lock
            continue
        size = np.abs(channel.values[:, 0])
        piled = float(np.mean(size >= size.max() * (1 - _ROUNDING)))
        if piled < _PILED or size.max() == 0:
            continue
        further, sigma = _further(channel, path, drive.rig)
        at_lock = name == "steer" and np.isclose(size.max(), 1.0, rtol=1e-3)
        if further < (_FURTHER_AT_LOCK if at_lock else _FURTHER) + SURE * sigma:
            continue
        about = {"piled": piled, "largest": size.max(), "further": 1 + further, "sigma": sigma}
        findings.append(found("cut_off", name, about, score=min(piled, 1.0)))
    return findings


def _further(channel: Channel, path: DrivenPath, rig: Rig) -> tuple[float, float]:
    """Return the relative excess of turning at the ends over the prediction, and its standard deviation.

    For steering, understeer has its own term. Returns (0, inf) if the data do not show the excess.
    """
    value, rows, forward = lagged(channel, path.time, rig), moving_rows(path), path.forward
    if channel.name == "yaw_rate":
        base, turning = np.ones((len(path.time), 1)), value
    else:
        wheel = np.tan(np.clip(value, -1.4, 1.4)) if channel.name == "steer_angle" else value
        base, turning = forward[:, None], forward * wheel
    best = fit_lags(path.yaw_rate, base, turning, LAGS, rows)
    if best is None:
        return 0.0, np.inf
    at: Float[np.ndarray, " n"] = turning[best.best()]
    with np.errstate(invalid="ignore"):
        ends = np.abs(value[best.best()]) >= _NEAR * np.abs(channel.values[:, 0]).max()
    slower = [] if channel.name == "yaw_rate" else [forward**2 * at]
    inside = fit_lags(path.yaw_rate, base, at[None], np.zeros(1), rows & ~ends)
    more = fit_lags(path.yaw_rate, np.column_stack((base, at, *slower)), (ends * at)[None], np.zeros(1), rows)
    if inside is None or more is None:
        return 0.0, np.inf
    usual = float(inside.gain[0])
    return float(more.gain[0]) / usual, more.gain_sigma(0) / abs(usual)


def check_range_ends(drive: Drive) -> list[Finding]:
    """Return a finding for each control that repeatedly ends at the same value well within its range."""
    findings = []
    for control in CONTROLS:
        if control.name not in drive.channels:
            continue
        values = drive.channels[control.name].values[:, 0]
        sides = [values, -values] if control.low < 0 else [values]
        limits = [limit for side in sides if (limit := _limit(side)) is not None]
        if not limits or max(float(side.max()) for side in sides) >= _WHOLE * control.high:
            continue
        ends, presses = zip(*limits, strict=True)
        edits = rescaled(control.name, drive.rig.channels[control.name], 1 / max(ends))
        about = {
            "presses": sum(presses),
            "ends": " and ".join(f"{end:.3g}" for end in ends),
            "edits": ", ".join(map(str, edits)),
        }
        # Automation holds a brake at a constant value.
        severity: Severity = "note" if control.name == "brake" else "warning"
        findings.append(found("short_range", control.name, about, severity=severity))
    return findings


def _limit(values: Float[np.ndarray, " n"]) -> tuple[float, int] | None:
    """Return the maximum and the number of presses that end there; None for a few presses or a switch."""
    values = values[np.isfinite(values)]
    level = values[np.append(0, np.flatnonzero(np.diff(values)) + 1)]  # one per run of equal values
    top = float(level.max(initial=0.0))
    if len(np.unique(level[(level > 0) & (level < top)])) < _LEVELS:
        return None
    before, ends, after = level[:-2], level[1:-1], level[2:]
    peak = (ends > before) & (ends > after)
    at: Bool[np.ndarray, " r"] = peak & (ends >= top * (1 - _ROUNDING))
    below = ends[peak & ~at & (ends >= _BELOW * top)]
    usual = len(below) / max(len(np.unique(below)), 1)
    count = int((at & (np.maximum(before, after) > _BETWEEN * top)).sum())
    return (top, count) if count >= _ENDS and at.sum() > _CROWDED * usual else None


def check_resolution(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding for each channel whose steps are too coarse to represent the motion."""
    findings = []
    for name in (name for name in _COARSE if name in drive.channels):
        least, share = _COARSE[name]
        values = drive.channels[name].values[:, :2]
        step = max(_step(column) for column in values[np.isfinite(values).all(axis=1)].T)
        if step > max(least, share * path.cruise):
            findings.append(found("coarse_values", name, {"step": step}))
    for name in (name for name in ("steer", "steer_angle") if name in drive.channels):
        values = drive.channels[name].values[np.isfinite(drive.channels[name].values[:, 0]), 0]
        levels, step = len(_distinct(values)), _step(values)
        if _COARSE_LEVELS[0] <= levels <= _COARSE_LEVELS[1] and step > 0:
            changes = np.rint(np.abs(np.diff(values)) / step)
            changes = changes[changes > 0]
            if len(changes) > 2 * levels and np.mean(changes == 1) > _ONE_BY_ONE:
                findings.append(found("coarse_levels", name, {"levels": levels, "step": step}))
    return findings


def _step(values: Float[np.ndarray, " n"]) -> float:
    """Return the largest step of which all values are multiples, up to an offset; 0 if there is none."""
    apart = np.diff(_distinct(values))
    if len(apart) < 2:
        return 0.0
    shares = apart / apart.min()
    even = (np.abs(shares - np.rint(shares)) < _EVEN * np.maximum(shares, 1.0)).all()
    return float(apart.min()) if even else 0.0


def _distinct(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " s"]:
    """Return the sorted distinct values; values that differ only by rounding count once."""
    ordered = np.unique(values)
    if len(ordered) < 2:
        return ordered
    rounding = 1e-9 * max(float(np.abs(ordered).max()), float(ordered[-1] - ordered[0]))
    return np.asarray(ordered[np.diff(ordered, prepend=-np.inf) > rounding])
