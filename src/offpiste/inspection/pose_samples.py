"""Checks of the pose's samples: vertical axis, sample-and-hold, low rate and implausible samples."""

from collections.abc import Collection, Iterator, Sequence
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import median_filter

from offpiste.inspection.driven_path import MOVING, DrivenPath
from offpiste.inspection.findings import Cure, Finding, found, times
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.logs.pose_faults import DroppedRun
from offpiste.rig.channels import POSE
from offpiste.rig.edits import Edit
from offpiste.rig.labels import named_axis
from offpiste.rig.rig import Rig

_LEVEL: Final = 0.2
"""Maximum span of the vertical axis, as a share of the smaller of the others."""
_Y_UP: Final = ((2, 0, 1), (0, 2, 1))
"""Axis orders that turn a right-handed and a left-handed frame with y up into one with z up."""
_STRIDE: Final = 5.0
"""Distance between the samples of the path's steepness [m]; positions are noisy vertically."""
_ENOUGH: Final = 3.9
"""Minimum `motion.window`, in sample intervals: four samples are fitted (`geometry.local_polynomial`)."""
_HELD, _EVENLY_HELD, _FEW = 0.6, 0.25, 200
"""Minimum shares of repeated samples of a held channel, in general and if held evenly; minimum number of samples."""
_EVEN: Final = 0.9
"""Minimum share of values held for the typical number of samples, plus or minus one."""
_QUANTA: Final = 3.0
"""Minimum ratio of the median step to the smallest one in a held channel; it is lower for rounded values."""


def check_level(place: Channel, rig: Rig, beside: Collection[str]) -> list[Finding]:
    """Return a finding if the spans of the positions and the path's steepness contradict z as the vertical axis.

    Args:
        beside: fields of the positions' topic.
    """
    if place.values.shape[1] < 3:
        return []
    fields = rig.channels["position"].fields
    if [named_axis(field) for field in fields] == ["z", "x", "y"]:
        other = Edit("channels.position.fields", [fields[1], fields[0], fields[2]])
        return [found("mirrored", "position", {"x": fields[0], "y": fields[1], "other": other})]
    smooth = np.stack([median_filter(c, 11, mode="nearest") for c in place.values.T], axis=1)
    spread = np.ptp(smooth, axis=0)
    y_up = bool(spread[1] < _LEVEL * min(spread[0], spread[2])) and _climbs(smooth, 2) and not _climbs(smooth, 1)
    if not y_up and (spread[2] < 0.7 * np.hypot(*spread[:2]) or spread[2] < 1):
        return []
    cures: tuple[Cure, ...] = ()
    if y_up or spread[1] < _LEVEL * min(spread[0], spread[2]):
        cures = tuple(tuple(_with_y_up(rig, order, beside)) for order in _Y_UP)
    values = {"x": spread[0], "y": spread[1], "z": spread[2], "left": cures[1][0] if cures else ""}
    return [found("tipped", "position", values, *cures, severity="fatal" if cures else "warning")]


def _with_y_up(rig: Rig, order: Sequence[int], beside: Collection[str]) -> Iterator[Edit]:
    """Yield edits that reorder the axes of positions, their velocity and a heading about z."""
    for name in ("position", "linear_velocity"):
        source = rig.channels.get(name)
        if source is not None and len(source.fields) == len(order) and source.frame != "body":
            yield Edit(f"channels.{name}.fields", [source.fields[axis] for axis in order])
    yaw = rig.channels.get("yaw")
    if yaw is not None and yaw.fields[0].endswith("z") and (about_y := yaw.fields[0][:-1] + "y") in beside:
        yield Edit("channels.yaw.fields", [about_y])


def _climbs(place: Float[np.ndarray, "n 3"], axis: int) -> bool:
    """Return whether over a tenth of the path is steeper than 45 degrees along an axis, which is implausible."""
    way = np.cumsum(np.linalg.norm(np.diff(place, axis=0, prepend=place[:1]), axis=1))
    step = np.diff(place[np.flatnonzero(np.diff(way // _STRIDE, prepend=-1))], axis=0)
    across = np.linalg.norm(np.delete(step, axis, axis=1), axis=1)
    return len(step) > 10 and bool(np.mean(np.abs(step[:, axis]) > across) > 0.1)


def check_repeats(drive: Drive, path: DrivenPath) -> list[Finding]:
    """Return a finding if positions repeat while the vehicle moves, as with a slower sensor."""
    old = {name: share for name in (*POSE, "linear_velocity") if (share := _repeats(drive, path, name)) > 0}
    if "position" not in old:
        return []
    recorded, window = float(np.median(np.diff(drive.channels["position"].time))), drive.rig.motion.window
    between = recorded / (1 - old["position"])
    cure = tuple(Edit(f"channels.{name}.repeats", "drop") for name in old)
    if window < _ENOUGH * between:
        cure += (Edit("motion.window", round(5 * between, 2)),)
    values = {"share": old["position"], "measured": 1 / between, "recorded": 1 / recorded}
    return [found("repeats", "position", values, cure)]


def _repeats(drive: Drive, path: DrivenPath, name: str) -> float:
    """Return the share of repeated samples while the vehicle moves; 0 for a channel that is not held."""
    if name not in drive.channels:
        return 0.0
    channel = drive.channels[name]
    moving = np.interp(channel.time[1:], path.time, np.nan_to_num(path.speed)) > max(MOVING, 0.3 * path.cruise)
    steps = np.diff(channel.values, axis=0)
    same = (steps == 0).all(axis=1)
    share = float(same[moving].mean()) if moving.sum() > _FEW else 0.0
    held = share > _HELD or (share > _EVENLY_HELD and _are_held_evenly(steps[moving & ~same], same, moving))
    return share if held else 0.0


def _are_held_evenly(
    steps: Float[np.ndarray, "m k"], same: Bool[np.ndarray, " n"], moving: Bool[np.ndarray, " n"]
) -> bool:
    """Return whether values change at the even rate of a slower sensor and by more than rounding.

    Args:
        steps: changes between distinct values while the vehicle moves.
        same, moving: whether each sample repeats the previous one, and whether the vehicle moves.
    """
    changes = np.flatnonzero(~same)
    lengths = np.diff(changes)[moving[changes[:-1]]]
    usual = np.median(lengths)
    sizes = np.abs(steps)
    quantum = np.array([column[column > 0].min(initial=np.inf) for column in sizes.T])
    coarse = (np.median(sizes, axis=0) < _QUANTA * quantum).all()
    return bool(np.mean(np.abs(lengths - usual) <= 1) > _EVEN and (lengths > 1).mean() > 0.5 and not coarse)


def check_seldom(drive: Drive) -> list[Finding]:
    """Return a finding if positions or headings are too infrequent for the differentiation window."""
    velocity, channels = drive.rig.channels.get("linear_velocity"), drive.rig.channels
    differentiated = [] if velocity is not None and velocity.frame != "unknown" else ["position"]
    if not {"yaw_rate", "angular_velocity"} & set(channels):
        differentiated.append("yaw" if "yaw" in channels else "orientation")
    window = drive.rig.motion.window
    steps = {name: float(np.median(np.diff(drive.channels[name].time))) for name in differentiated}
    name = max(steps, key=lambda name: steps[name], default="")
    if not name or window >= _ENOUGH * steps[name]:
        return []
    edit = Edit("motion.window", round(5 * steps[name], 2))
    return [found("seldom", name, {"rate": 1 / steps[name], "window": window}, (edit,))]


def check_faults(drive: Drive) -> list[Finding]:
    """Return findings on implausible samples of the pose and on jumps of the heading."""
    length = max(float(np.ptp(drive.channels["position"].time)), 1e-9)
    findings = _held([run for run in drive.faults.dropped if run.held], length)
    dropped = [run for run in drive.faults.dropped if not run.held]
    places = {(run.start, run.end) for run in dropped if run.channel == "position"}
    for name in dict.fromkeys(run.channel for run in dropped):
        runs = [run for run in dropped if run.channel == name]
        if name != "position" and {(run.start, run.end) for run in runs} <= places:
            continue  # already reported for the position
        worst, lasts = max(runs, key=lambda run: run.off), np.array([run.until - run.after for run in runs])
        remedy = "short" if lasts.max() < drive.rig.clock.max_gap else "remedy"
        share = min(float(lasts[np.isfinite(lasts)].sum()) / length, 1.0)
        values = {"count": sum(run.last - run.first + 1 for run in runs), "runs": len(runs), "off": worst.off}
        values |= {"first": worst.first, "last": worst.last, "since": worst.since}
        unit = "m" if name == "position" else "rad"
        findings.append(found("implausible", name, {"unit": unit, **values}, score=share, remedy=remedy))
    turns = [jump for jump in drive.faults.jumps if jump.channel != "position"]
    if turns:
        when = ", ".join(f"{jump.since:.2f} s" for jump in turns[:5]) + (", ..." if len(turns) > 5 else "")
        score = min(5 * len(turns) / length, 1.0)
        findings.append(found("jumps", turns[0].channel, {"times": times(len(turns)), "when": when}, score=score))
    return findings


def _held(runs: Sequence[DroppedRun], length: float) -> list[Finding]:
    """Return a finding if the position is constant while the vehicle drives.

    Args:
        length: duration of the drive [s].
    """
    if not runs:
        return []
    seconds = np.array([min(run.until, run.end) - run.after for run in runs])
    worst = runs[int(seconds.argmax())]
    then = f", after which it jumps by {worst.off:.3g} m" if np.isfinite(worst.until) else ", to the end of the log"
    values = {"times": times(len(runs)), "longest": seconds.max(), "since": worst.since, "then": then}
    return [found("held_place", "position", values, score=min(float(seconds.sum()) / length, 1.0))]
