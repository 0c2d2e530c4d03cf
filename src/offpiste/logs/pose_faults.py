"""Faults of a drive's pose: implausible runs of samples, which are dropped, and lasting jumps."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.logs.channel import Channel
from offpiste.logs.plausibility import displacements, held_while_driving, plausible
from offpiste.rig.channels import POSE

_NAMED: Final = 3
"""Largest number of runs in a note."""
_BREAK: Final = 1.2
"""Smallest jump of the position that no map and no window may span [m]: six cells. GPS has many shorter ones."""
_TURN: Final = np.deg2rad(20.0)
"""Smallest such jump of the heading [rad]."""


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
        several, unit = self.first != self.last, "m" if self.channel == "position" else "rad"
        which, when = f"sample {self.first}", f"{self.since:.2f}"
        if several:
            which, when = f"samples {self.first} to {self.last}", f"{when} to {self.since + self.end - self.start:.2f}"
        where = f"lie{'s' * (not several)} {self.off:.3g} {unit}"
        if self.held:
            until = f", {self.off:.3g} m" if np.isfinite(self.until) else " to the end,"
            where = f"hold{'s' * (not several)} one place{until}"
        return f"{which} ({when} s) {where}"


@dataclass(frozen=True)
class PoseJump:
    """Lasting step of the pose that no vehicle can make, as where SLAM or GPS corrects it."""

    channel: str
    before: float  # before, time: stamps of the samples before and after the step [s]
    time: float
    since: float  # time from the channel's first sample [s]
    size: float  # distance from the vehicle's motion [m or rad]


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

    def breaks(self) -> Float[np.ndarray, "j 2"]:
        """Return the stamps before and after each jump that no map and no window may span, sorted [s]."""
        large = [jump for jump in self.jumps if jump.size > (_BREAK if jump.channel == "position" else _TURN)]
        return np.array(sorted((jump.before, jump.time) for jump in large)).reshape(-1, 2)


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
        channel, time = channels[name], channels[name].time
        is_place = name == "position"
        held = held_while_driving(time, channel.values) if is_place else np.zeros(len(time), bool)
        fresh = np.flatnonzero(~held)
        found = plausible(name, time[fresh], channel.values[fresh])
        hopeless += [name] * found.hopeless
        kept = fresh[found.keep]
        if len(kept) < len(time):
            result[name] = replace(channel, time=time[kept], values=channel.values[kept])
            dropped += _runs(channel, numbers[name], kept, held)
        for number, size in found.jumps:
            at = fresh[number]
            before = time[kept[np.searchsorted(kept, at) - 1]]
            jumps.append(PoseJump(name, float(before), float(time[at]), float(time[at] - time[0]), size))
    return result, PoseFaults(tuple(dropped), tuple(jumps), tuple(hopeless))


def _runs(
    channel: Channel, numbers: Int[np.ndarray, " n"], kept: Int[np.ndarray, " k"], held: Bool[np.ndarray, " n"]
) -> list[DroppedRun]:
    dropped = np.ones(len(held), bool)
    dropped[kept] = False
    edges = np.flatnonzero(np.diff(np.concatenate(([False], dropped, [False])).astype(int)))
    time, between, runs = channel.time, displacements(channel.name, channel.values), []
    padded = np.concatenate(([-np.inf], time, [np.inf]))
    for first, end in edges.reshape(-1, 2).tolist():
        holds, samples = bool(held[first:end].all()), np.arange(first, end)
        beside = [each for each in ((end,) if holds else (first - 1, end)) if 0 <= each < len(time)]
        away = [np.linalg.norm(between(np.full(len(samples), each), samples), axis=1) for each in beside]
        run = DroppedRun(
            channel.name,
            int(numbers[first]),
            int(numbers[end - 1]),
            start=float(time[first]),
            end=float(time[end - 1]),
            after=float(padded[first]),
            until=float(padded[end + 1]),
            since=float(time[first] - time[0]),
            off=float(np.min(away, axis=0).max()) if away else 0.0,
            held=holds,
        )
        runs.append(run)
    return runs
