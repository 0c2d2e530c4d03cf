"""Faults of a drive's pose: implausible runs of samples, which are dropped, and lasting jumps."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.logs.channel import Channel
from offpiste.logs.plausibility import held_while_driving, plausible_headings, plausible_positions
from offpiste.rig.channels import POSE

_NAMED: Final = 3
"""Largest number of runs in a note."""


@dataclass(frozen=True)
class DroppedRun:
    """Consecutive samples of a channel that were dropped, since no vehicle can have produced them."""

    channel: str
    first: int  # first, last: numbers in the log, from 0
    last: int
    start: float  # start, end: stamps [s]
    end: float
    after: float  # after, until: stamps of the kept samples before and after the run; infinite if there are none [s]
    until: float
    since: float  # time from the channel's first sample to `start` [s]
    off: float  # largest distance from the vehicle [m or rad]; 0 if unknown, as for a position held to the end
    held: bool = False  # the samples hold one position while the vehicle drives on

    def __str__(self) -> str:
        unit = "m" if self.channel == "position" else "rad"
        several = self.first != self.last
        when = f"{self.since:.2f} to {self.since + self.end - self.start:.2f}" if several else f"{self.since:.2f}"
        which = f"samples {self.first} to {self.last}" if several else f"sample {self.first}"
        if self.held:
            how = "hold" if several else "holds"
            where = f"one place, {self.off:.3g} m" if np.isfinite(self.until) else "one place to the end,"
        else:
            how, where = "lie" if several else "lies", f"{self.off:.3g} {unit}"
        return f"{which} ({when} s) {how} {where}"


@dataclass(frozen=True)
class PoseJump:
    """Lasting step of the pose that no vehicle can make, as where SLAM or GPS corrects it."""

    channel: str
    sample: int  # number in the log of the first sample after the step, from 0
    time: float  # stamp of that sample [s]
    since: float  # time from the channel's first sample [s]


@dataclass(frozen=True)
class PoseFaults:
    """Implausible samples of a drive's pose."""

    dropped: tuple[DroppedRun, ...] = ()  # dropped runs of samples
    jumps: tuple[PoseJump, ...] = ()  # remaining jumps
    hopeless: tuple[str, ...] = ()  # channels of which so much is implausible that nothing was dropped

    @property
    def notes(self) -> list[str]:
        """Notes on dropped samples, one per channel."""
        lines = []
        for name in dict.fromkeys(run.channel for run in self.dropped):
            runs = [run for run in self.dropped if run.channel == name]
            named = ", ".join(map(str, runs[:_NAMED]))
            more = f" and {len(runs) - _NAMED} more runs" if len(runs) > _NAMED else ""
            lines.append(f"{name}: {named}{more} off the path of any vehicle; dropped")
        for name in self.hopeless:
            lines.append(f"{name}: moves as no vehicle does for most of the drive; nothing was dropped")
        return lines

    def touched(self, at: Float[np.ndarray, " N"], memory: float) -> Bool[np.ndarray, " N"]:
        """Mark times whose look-back window of `memory` seconds contains a dropped sample."""
        result = np.zeros(len(at), bool)
        for run in self.dropped:
            result |= (at >= run.start) & (at < run.until + memory)
        return result

    def unknown(self) -> Float[np.ndarray, "u 2"]:
        """Return the stamps of the kept samples before and after each dropped run [s]."""
        return np.array([(run.after, run.until) for run in self.dropped]).reshape(-1, 2)


def without_faults(
    channels: Mapping[str, Channel], numbers: Mapping[str, Int[np.ndarray, " n"]]
) -> tuple[dict[str, Channel], PoseFaults]:
    """Drop the samples of the pose that no vehicle can have produced, and return the faults.

    Faults are judged by the whole drive; causal estimates exclude them by `PoseFaults.touched`.

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
            start=float(channel.time[first]),
            end=float(channel.time[end - 1]),
            after=float(time[first]),
            until=float(time[end + 1]),
            since=float(channel.time[first] - channel.time[0]),
            off=_off(channel, first, end, beside=(end,) if holds else (first - 1, end)),
            held=holds,
        )
        runs.append(run)
    return runs


def _off(channel: Channel, first: int, end: int, beside: Sequence[int]) -> float:
    """Return the largest distance of a run from the nearer of the samples beside it."""
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
