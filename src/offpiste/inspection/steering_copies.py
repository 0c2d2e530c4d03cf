"""Fields that repeat the steering later: copies of a measurement that pass for commands."""

import numpy as np
from jaxtyping import Float

from offpiste.inspection.controls_by_numbers import is_measured
from offpiste.inspection.findings import Finding
from offpiste.inspection.recorded_log import Recorded
from offpiste.inspection.signals import place
from offpiste.logs.drive import Drive

_LAGS = np.arange(-2.0, 2.01, 0.1)
"""Lags of a copy that are tried [s]."""
_COPY_WINDOW = 8.0
"""Length of a stretch [s]."""
_ALIKE = 0.95
"""Correlation within a stretch above which it holds a copy."""
_MOST = 0.6
"""Share of the stretches that must hold one."""
_LATE = 0.3
"""A copy that is later than this in a tenth of the stretches is reported [s]."""


def check_copies(drive: Drive, recorded: dict[str, Recorded]) -> list[Finding]:
    """Notes on fields that repeat the steering late, and that no channel reads: what is measured follows it rightly.

    So does what is measured of the motion, as by an IMU.
    """
    source = drive.rig.channels.get("steer")
    if source is None or source.topic not in recorded:
        return []
    steer = drive.channels["steer"]
    read = {(one.topic, field) for one in drive.rig.channels.values() for field in one.fields}
    findings = []
    for topic, r in recorded.items():
        if topic == source.topic or len(r.time) < 200 or is_measured(r.topic):
            continue
        keep = np.append(True, r.time[1:] > r.time[:-1]) & np.isfinite(r.time)
        for field, values in zip(r.fields, r.values[keep].T, strict=True):
            if (topic, field) in read:
                continue
            lags, windows = _copy_window_lags(steer.time, steer.values[:, 0], r.time[keep], values)
            if len(lags) < max(5, _MOST * windows) or np.percentile(lags, 10) < -0.15:
                continue
            low, high = np.percentile(lags, (10, 90))
            if high < _LATE:
                continue
            evidence = (
                f"in {len(lags)} of {windows} stretches of {_COPY_WINDOW:.0f} s it is the steering, {low:.1f} to "
            )
            evidence += f"{high:.1f} s later (10 to 90 %)"
            name, what = place(topic, field), "is a late copy of the steering, not its command"
            findings.append(Finding("note", name, what, evidence, "do not feed channels.steer from it", 0.3))
    return findings


def _copy_window_lags(
    time: Float[np.ndarray, " n"],
    values: Float[np.ndarray, " n"],
    other_time: Float[np.ndarray, " m"],
    other: Float[np.ndarray, " m"],
) -> tuple[Float[np.ndarray, " w"], int]:
    """Lags of `other` in the stretches in which `values` moves and both agree [s], and how many stretches move."""
    if not np.isfinite(other).all() or np.ptp(other) == 0:
        return np.zeros(0), 1
    at = np.arange(time[0] + 2, time[-1] - 2, 0.1)
    x = np.interp(at, time, values)
    shifted = np.stack([np.interp(at + lag, other_time, other) for lag in _LAGS])
    result, moving = [], 0
    size = int(_COPY_WINDOW / 0.1)
    for begin in range(0, len(at) - size, size):
        part, moved = x[begin : begin + size], shifted[:, begin : begin + size]
        if part.std() < 0.5 * x.std():
            continue
        moving += 1
        part, moved = part - part.mean(), moved - moved.mean(axis=1, keepdims=True)
        power = np.sqrt((moved**2).sum(axis=1) * (part**2).sum())
        correlation = np.abs(moved @ part) / np.maximum(power, 1e-12)
        if correlation.max() > _ALIKE:
            result.append(_LAGS[correlation.argmax()])
    return np.array(result), max(moving, 1)
