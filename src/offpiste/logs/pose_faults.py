"""Faults of a drive's pose: runs of samples that no vehicle makes, which are dropped, and jumps that last."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.logs.channel import Channel
from offpiste.logs.plausibility import held_while_driving, plausible_headings, plausible_positions

POSE: Final = ("position", "orientation", "yaw")
"""Channels whose samples are compared with what a vehicle can do."""
_NAMED: Final = 3
"""Runs that a note names."""


@dataclass(frozen=True)
class DroppedRun:
    """Neighbouring samples of a channel that no vehicle makes, and that were dropped.

    Attributes:
        first, last: their numbers in the log, from 0.
        start, end: their stamps [s].
        after, until: stamps of the samples before and after them that were kept [s]; infinite where there is none.
        since: from the channel's first sample to `start` [s].
        off: how far the worst one lies from where the vehicle was [m or rad]; 0 where that is not known, as of a place
            that is held to the end.
        held: whether they hold one place while the vehicle drives on.
    """

    channel: str
    first: int
    last: int
    start: float
    end: float
    after: float
    until: float
    since: float
    off: float
    held: bool = False


@dataclass(frozen=True)
class PoseJump:
    """A step of the pose that no vehicle makes and that lasts, as where SLAM or GPS corrects it.

    Attributes:
        sample: number in the log of the first sample after it, from 0.
        time: its stamp [s].
        since: from the channel's first sample [s].
    """

    channel: str
    sample: int
    time: float
    since: float


@dataclass(frozen=True)
class PoseFaults:
    """What is implausible about a drive's pose.

    Attributes:
        dropped: runs of samples that were dropped.
        jumps: that remain.
        hopeless: channels of which so much is implausible that nothing was dropped.
    """

    dropped: tuple[DroppedRun, ...] = ()
    jumps: tuple[PoseJump, ...] = ()
    hopeless: tuple[str, ...] = ()

    @property
    def notes(self) -> list[str]:
        """What was dropped, a line for each channel."""
        lines = []
        for name in dict.fromkeys(run.channel for run in self.dropped):
            runs = [run for run in self.dropped if run.channel == name]
            named = ", ".join(_words(run) for run in runs[:_NAMED])
            more = f" and {len(runs) - _NAMED} more runs" if len(runs) > _NAMED else ""
            lines.append(f"{name}: {named}{more} off the path of any vehicle; dropped")
        for name in self.hopeless:
            lines.append(f"{name}: moves as no vehicle does for most of the drive; nothing was dropped")
        return lines

    def touched(self, at: Float[np.ndarray, " N"], memory: float) -> Bool[np.ndarray, " N"]:
        """Moments at which someone who remembers the last `memory` seconds would have read a dropped sample."""
        result = np.zeros(len(at), bool)
        for run in self.dropped:
            result |= (at >= run.start) & (at < run.until + memory)
        return result

    def unknown(self) -> Float[np.ndarray, "u 2"]:
        """Last kept sample before and first after each dropped run: between them the pose is not known [s]."""
        return np.array([(run.after, run.until) for run in self.dropped]).reshape(-1, 2)


def without_faults(
    channels: Mapping[str, Channel], numbers: Mapping[str, Int[np.ndarray, " n"]]
) -> tuple[dict[str, Channel], PoseFaults]:
    """Channels without the samples of the pose that no vehicle makes, and what was found.

    The whole drive is used: which samples are corrupt is known after the fact only. What must not depend on the future
    reads `PoseFaults.touched`.

    Args:
        numbers: of each channel's samples in the log.
    """
    result, dropped, jumps, hopeless = dict(channels), [], [], []
    for name in POSE:
        if name not in channels:
            continue
        channel = channels[name]
        is_place = name == "position"
        plausible = plausible_positions if is_place else plausible_headings
        held = held_while_driving(channel.time, channel.values) if is_place else np.zeros(len(channel.time), bool)
        fresh = np.flatnonzero(~held)
        found = plausible(channel.time[fresh], channel.values[fresh])
        hopeless += [name] * found.hopeless
        kept = fresh[found.keep]
        if len(kept) < len(held):
            result[name] = replace(channel, time=channel.time[kept], values=channel.values[kept])
            dropped += _runs(channel, numbers[name], kept, held)
        origin = float(channel.time[0])
        for at in fresh[found.jumps]:
            time = float(channel.time[at])
            jumps.append(PoseJump(name, int(numbers[name][at]), time, time - origin))
    return result, PoseFaults(tuple(dropped), tuple(jumps), tuple(hopeless))


def _runs(
    channel: Channel, numbers: Int[np.ndarray, " n"], kept: Int[np.ndarray, " k"], held: Bool[np.ndarray, " n"]
) -> list[DroppedRun]:
    dropped = np.ones(len(held), bool)
    dropped[kept] = False
    edges = np.flatnonzero(np.diff(np.concatenate(([False], dropped, [False])).astype(int)))
    time, runs = np.concatenate(([-np.inf], channel.time, [np.inf])), []
    for first, end in edges.reshape(-1, 2).tolist():
        holds = bool(held[first:end].all())
        run = DroppedRun(
            channel.name,
            int(numbers[first]),
            int(numbers[end - 1]),
            float(channel.time[first]),
            float(channel.time[end - 1]),
            float(time[first]),
            float(time[end + 1]),
            float(channel.time[first] - channel.time[0]),
            _off(channel, first, end, beside=(end,) if holds else (first - 1, end)),
            holds,
        )
        runs.append(run)
    return runs


def _off(channel: Channel, first: int, end: int, beside: Sequence[int]) -> float:
    """Largest distance of a run from the nearer of the samples beside it."""
    away = []
    for sample in beside:
        if 0 <= sample < len(channel.values):
            apart = channel.values[first:end] - channel.values[sample]
            if channel.name == "yaw":
                apart = (apart + np.pi) % (2 * np.pi) - np.pi
            elif channel.name == "orientation":
                cosine = np.abs(channel.values[first:end] @ channel.values[sample])
                apart = 2 * np.arccos(np.clip(cosine, 0, 1))[:, None]
            away.append(np.linalg.norm(apart, axis=1))
    return float(np.min(away, axis=0).max()) if away else 0.0


def _words(run: DroppedRun) -> str:
    unit = "m" if run.channel == "position" else "rad"
    end = run.since + run.end - run.start
    if run.held and not np.isfinite(run.until):
        return f"samples {run.first} to {run.last} ({run.since:.2f} to {end:.2f} s) hold one place to the end,"
    if run.held:
        return f"samples {run.first} to {run.last} ({run.since:.2f} to {end:.2f} s) hold one place, {run.off:.3g} m"
    if run.first == run.last:
        return f"sample {run.first} ({run.since:.2f} s) lies {run.off:.3g} {unit}"
    return f"samples {run.first} to {run.last} ({run.since:.2f} to {end:.2f} s) lie {run.off:.3g} {unit}"
