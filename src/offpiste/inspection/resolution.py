"""Check for channels whose resolution is too coarse to represent the motion."""

from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.inspection.driven_path import DrivenPath
from offpiste.inspection.findings import Finding
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive

_EVEN: Final = 0.01
"""Maximum deviation of value differences from multiples of the step, as a share of the step."""
_ONE_BY_ONE: Final = 0.8
"""Minimum share of changes by one step; keys and switches cause larger changes."""
_LEVELS: Final = (4, 12)
"""Range of the number of levels of a coarse steering; fewer levels indicate a switch."""
_COARSE_PLACE: Final = (0.05, 0.03)
"""Maximum acceptable position step [m], and as a share of the distance driven in a second."""
_COARSE_VELOCITY: Final = (0.05, 0.1)
"""Maximum acceptable velocity step [m/s], and as a share of the cruising speed."""


def check_resolution(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding for each channel with a too coarse resolution."""
    findings = []
    for name in ("position", "linear_velocity"):
        least, share = _COARSE_PLACE if name == "position" else _COARSE_VELOCITY
        step = _step(drive.channels[name].values[:, :2]) if name in drive.channels else 0.0
        if step > max(least, share * path.cruise):
            findings.append(_finding(name, step, f"all its values are multiples of {step:.3g}"))
    for name in ("steer", "steer_angle"):
        if name not in drive.channels:
            continue
        levels = _levels(drive.channels[name])
        if _LEVELS[0] <= len(levels) <= _LEVELS[1]:
            step = float(levels[1] - levels[0])
            findings.append(_finding(name, step, f"it takes {len(levels)} values, {step:.3g} apart, one by one"))
    return findings


def _finding(name: str, step: float, evidence: str) -> Finding:
    how = "no rig line fixes it: record it with more digits (as float64, or in smaller units), or take another field"
    return Finding("warning", name, "is recorded in coarse steps", evidence, how, 0.6)


def _step(values: Float[np.ndarray, "n k"]) -> float:
    """Return the largest step of which all values of a column are multiples, up to an offset; 0 if none exists."""
    columns = [np.diff(_distinct(column)) for column in values[np.isfinite(values).all(axis=1)].T]
    return max((float(apart.min()) for apart in columns if len(apart) > 1 and _multiples(apart)), default=0.0)


def _levels(channel: Channel) -> Float[np.ndarray, " s"]:
    """Return the evenly spaced levels of a channel that changes mostly by one level; empty otherwise."""
    values = channel.values[np.isfinite(channel.values[:, 0]), 0]
    levels = _distinct(values)
    apart = np.diff(levels)
    if not _LEVELS[0] <= len(levels) <= _LEVELS[1] or not _multiples(apart):
        return np.zeros(0)
    at = np.rint((values - levels[0]) / apart.min())
    changes = np.abs(np.diff(at))
    changes = changes[changes > 0]
    one_by_one = len(changes) > 2 * len(levels) and np.mean(changes == 1) > _ONE_BY_ONE
    return levels if one_by_one else np.zeros(0)


def _distinct(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " s"]:
    """Return the sorted distinct values; values that differ only by rounding count once."""
    ordered = np.unique(values)
    if len(ordered) < 2:
        return ordered
    rounding = 1e-9 * max(float(np.abs(ordered).max()), float(ordered[-1] - ordered[0]))
    return np.asarray(ordered[np.diff(ordered, prepend=-np.inf) > rounding])


def _multiples(apart: Float[np.ndarray, " s"]) -> bool:
    """Return whether distances are multiples of the smallest."""
    shares = apart / apart.min()
    return bool((np.abs(shares - np.rint(shares)) < _EVEN * np.maximum(shares, 1.0)).all())
