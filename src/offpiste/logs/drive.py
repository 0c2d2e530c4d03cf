"""Drive: the channels of one recording, read from a log through a rig."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from offpiste.core.errors import LogError
from offpiste.core.geometry import same_sign
from offpiste.logs.channel import KEPT_UP, Channel, read_channel, refuse_long
from offpiste.logs.clock_drift import align_clock
from offpiste.logs.log import Log, open_log
from offpiste.logs.pose_faults import PoseFaults, without_faults
from offpiste.rig.rig import Rig

_PAUSE: Final = 3600.0
"""Shortest gap without samples that may be refused [s]."""
_EMPTY: Final = 20.0
"""Smallest ratio of such a gap to the recorded time."""


@dataclass(frozen=True)
class Drive:
    """Channels of one vehicle in one recording."""

    name: str  # name of the log, without folder and extension
    rig: Rig
    channels: dict[str, Channel]  # by name, without those that the rig declares absent
    notes: tuple[str, ...] = ()  # samples dropped or repaired on reading, in words
    faults: PoseFaults = field(default_factory=PoseFaults)  # of the pose; `channels` lack the samples dropped for them


def read_drive(path: str | Path, rig: Rig) -> Drive:
    """Read the channels of a rig from a log.

    Raises:
        LogError: the log cannot be read, or lacks a topic or field that the rig names.
        RigError: a channel has no usable sample.
    """
    log = open_log(path, clock=rig.clock)
    return drive_from_log(log, rig)


def drive_from_log(log: Log, rig: Rig) -> Drive:
    """Read the channels of a rig from an open log (see `read_drive`)."""
    channels, numbers = {}, {}
    notes: list[str] = list(log.warnings)
    for name, source in rig.channels.items():
        channels[name], numbers[name], added = read_channel(log, rig, name, source)
        notes += added
    channels, faults = without_faults(channels, numbers)
    notes += faults.notes
    if "orientation" in channels:  # after dropping faults: a corrupt sample may have either sign
        given = channels["orientation"]
        channels["orientation"] = replace(given, values=same_sign(given.values))
    if rig.alignment is not None:
        channels, added = align_clock(log, rig, rig.alignment, channels)
        notes += added
    return Drive(drive_name(log.path), rig, _kept_up(channels, rig, log.path), tuple(notes), faults)


def _kept_up(channels: dict[str, Channel], rig: Rig, path: Path) -> dict[str, Channel]:
    """Repeat samples of on-change channels up to the last pose; other channels are unchanged."""
    until, result = float(channels["position"].time[-1]), dict(channels)
    every = min(0.9 * rig.clock.max_gap, rig.motion.window / KEPT_UP)
    for name, channel in channels.items():
        if rig.channels[name].interpolation == "on change":
            refuse_long(channel.time[0], until, path)
            result[name] = channel.kept_up(until, every=every)
    return result


def drive_name(path: str | Path) -> str:
    """Return the name of a drive: the log's file name without extension, or its folder's name."""
    path = Path(path).resolve()
    return path.name if path.is_dir() else path.stem


def common_span(channels: Sequence[Channel], path: str | Path) -> tuple[float, float]:
    """Return the first and the last time [s] covered by all channels; refuse spans without or with hardly any data."""
    start = max(channel.time[0] for channel in channels)
    end = min(channel.time[-1] for channel in channels)
    if not end > start:
        late = max(channels, key=lambda channel: channel.time[0])
        early = min(channels, key=lambda channel: channel.time[-1])
        what = f"'{early.name}' ends at {early.time[-1]:.3f} s, before '{late.name}' begins at {late.time[0]:.3f} s"
        how = 'their clocks differ: use clock.stamps = "receive", fix a delay, or drop the channel'
        raise LogError(what, where=path, how=how)
    refuse_long(start, end, path)
    if end - start >= _PAUSE:
        _refuse_gap(start, end, channels, path)
    return start, end


def _refuse_gap(start: float, end: float, channels: Sequence[Channel], path: str | Path) -> None:
    """Refuse a span that is nearly all one gap common to all channels, as after a clock was set."""
    time = np.sort(np.concatenate([channel.time for channel in channels]))
    time = time[(time >= start) & (time <= end)]
    gaps = np.diff(time, append=time[-1:])
    longest = int(gaps.argmax())
    recorded = end - start - gaps[longest]
    if gaps[longest] > max(_PAUSE, _EMPTY * recorded):
        gap = f"a gap of {gaps[longest] / 3600:.1f} hours after {time[longest]:.3f} s"
        what = f"{gap}, in a log with {recorded:.0f} s of samples"
        how = "the clock was set there, or two recordings were joined: cut the log there"
        raise LogError(what, where=path, how=how)
