"""Checks for late copies of the steering command and for poses computed from the steering."""

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.core.geometry import local_polynomial, planar_body_from_world
from offpiste.inspection.channel_guesses import labels
from offpiste.inspection.controls_by_numbers import is_measured_topic
from offpiste.inspection.driven_path import TURNING, DrivenPath
from offpiste.inspection.field_groups import field_groups
from offpiste.inspection.findings import Finding
from offpiste.inspection.lags import fit_lags, sampled
from offpiste.inspection.recorded_log import Recorded
from offpiste.inspection.samples import field_in_words
from offpiste.inspection.steering_fit import moving_rows
from offpiste.logs.drive import Drive
from offpiste.logs.motion import heading

_LAGS = np.arange(-2.0, 2.01, 0.1)
"""Candidate lags of a copy [s]."""
_COPY_WINDOW = 8.0
"""Length of a segment [s]."""
_ALIKE = 0.95
"""Minimum correlation of a copy within a segment."""
_MOST = 0.6
"""Minimum share of segments with a copy."""
_LATE = 0.3
"""Minimum 90th percentile of the lag of a reported copy [s]."""
_AT_ONCE: Final = np.arange(-0.03, 0.0301, 0.005)
"""Candidate ages of the steering from which a pose may be computed [s]."""
_COMPUTED: Final = 0.01
"""Maximum relative RMS deviation of a computed pose from the formula."""
_BOTH_WAYS: Final = 0.1
"""Minimum share of the moving time for turning in each direction."""


def check_copies(drive: Drive, recorded: dict[str, Recorded]) -> list[Finding]:
    """Return notes on unread fields that are late copies of the steering, except in measured topics."""
    source = drive.rig.channels.get("steer")
    if source is None or source.topic not in recorded:
        return []
    steer = drive.channels["steer"]
    read = {(one.topic, field) for one in drive.rig.channels.values() for field in one.fields}
    findings = []
    for topic, r in recorded.items():
        if topic == source.topic or len(r.time) < 200 or is_measured_topic(r.topic):
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
            name, what = field_in_words(topic, field), "is a late copy of the steering, not its command"
            findings.append(Finding("note", name, what, evidence, "do not feed channels.steer from it", 0.3))
    return findings


def _copy_window_lags(
    time: Float[np.ndarray, " n"],
    values: Float[np.ndarray, " n"],
    other_time: Float[np.ndarray, " m"],
    other: Float[np.ndarray, " m"],
) -> tuple[Float[np.ndarray, " w"], int]:
    """Return the lags of `other` in segments with matching steering [s], and the number of segments with steering."""
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


def check_computed_pose(drive: Drive, path: DrivenPath, recorded: Mapping[str, Recorded]) -> list[Finding]:
    """Return a warning if the yaw rate equals the speed times the tangent of the steering, without delay or sideslip.

    No vehicle follows its steering this exactly: the turning was not measured, and a model would learn a formula.
    """
    moving = moving_rows(path)
    turning = path.yaw_rate[moving]
    if np.nanstd(turning) < TURNING or min(np.mean(turning > TURNING), np.mean(turning < -TURNING)) < _BOTH_WAYS:
        return []
    position, yaw = drive.channels["position"], heading(drive)
    facing = np.interp(position.time, yaw.time, yaw.values[:, 0])
    steps = np.diff(position.values[:, :2], axis=0)
    # The heading may be taken at the start, the end or the middle of a step.
    ways = [planar_body_from_world(steps, at) for at in (facing[:-1], facing[1:], (facing[:-1] + facing[1:]) / 2)]
    ahead, aside = min(ways, key=lambda way: float(np.abs(way[:, 1]).sum())).T
    if np.sqrt(np.mean(aside**2)) > _COMPUTED * np.sqrt(np.mean(ahead**2)):
        return []
    name, misfit = min(_misfits(drive, path, ahead), key=lambda one: one[1], default=("", 1.0))
    if misfit > _COMPUTED:
        return []
    evidence = f"yaw rate = speed * tan({name}) / wheelbase, to {misfit:.1%} and without delay; it never slips aside"
    how = "read a pose that is measured: a model would learn this formula, not the vehicle"
    own = drive.rig.channels["position"].topic
    others = [topic for topic in recorded if topic != own and _is_pose(recorded[topic])]
    how += f". Here {' and '.join(others)} may be one" if others else ""
    where = "yaw" if "yaw" in drive.channels else "orientation"
    return [Finding("warning", where, f"is computed from channel {name}", evidence, how, 0.9)]


def _misfits(drive: Drive, path: DrivenPath, ahead: Float[np.ndarray, " n"]) -> Iterator[tuple[str, float]]:
    """Yield the steering channels with the relative RMS deviation of the yaw rate from a bicycle model.

    Args:
        ahead: longitudinal distance between successive positions [m].
    """
    time, rig = drive.channels["position"].time, drive.rig
    for name in ("steer", "steer_angle"):
        if name not in drive.channels:
            continue
        angles = (rig.vehicle.max_steer if name == "steer" else 1.0) * np.stack(
            [sampled(drive.channels[name], time[1:] - lag, rig) for lag in _AT_ONCE]
        )
        turned = np.cumsum(np.nan_to_num(ahead * np.tan(np.clip(angles, -1.4, 1.4))), axis=1)
        ways = np.vstack((turned, np.cumsum(ahead))).T
        _, rates = local_polynomial(time[1:], ways, path.time, window=path.window, causal=False)
        fit = fit_lags(path.yaw_rate, rates[:, -1:], rates[:, :-1].T, _AT_ONCE, moving_rows(path))
        if fit is not None:
            yield name, float(np.sqrt(max(1 - fit.strength**2, 0.0)))


def _is_pose(recorded: Recorded) -> bool:
    """Return whether a topic contains position and orientation by name, and the position changes."""
    named = {channel: fields for channel, fields, *_ in field_groups(recorded.topic, labels(recorded.topic))}
    if not {"position", "orientation"} <= set(named) or not set(named["position"][:2]) <= set(recorded.fields):
        return False
    columns = [recorded.fields.index(field) for field in named["position"][:2]]
    return bool((np.ptp(recorded.values[:, columns], axis=0) > 0).all())
