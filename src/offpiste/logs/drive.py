"""A drive: named channels in SI units at their native stamps, read from a log through a rig."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from offpiste.errors import LogError, RigError
from offpiste.logs.log import Log, Samples
from offpiste.logs.open import open_log
from offpiste.rig import CHANNELS, ChannelSource, Rig, unit_factor


@dataclass(frozen=True)
class Channel:
    """Samples of one quantity, strictly increasing in time, all finite.

    Attributes:
        unit: SI unit of the values (`offpiste.rig.CHANNELS`).
        time: native stamps, the rig's delay removed [s].
        values: one column a component.
    """

    name: str
    unit: str
    time: Float[np.ndarray, " n"]
    values: Float[np.ndarray, "n k"]

    def linear(self, at: Float[np.ndarray, " N"], *, max_gap: float) -> Float[np.ndarray, "N k"]:
        """Interpolated values; NaN outside the record and between samples further apart than `max_gap` [s]."""
        values = np.stack([np.interp(at, self.time, column) for column in self.values.T], axis=1)
        values[~self._covered(at, max_gap)] = np.nan
        return values

    def hold(self, at: Float[np.ndarray, " N"], *, max_gap: float) -> Float[np.ndarray, "N k"]:
        """The last value stamped at or before each time: what a command was; NaN as in `linear`."""
        index = np.searchsorted(self.time, at, side="right") - 1
        values = self.values[np.maximum(index, 0)].copy()
        values[~self._covered(at, max_gap)] = np.nan
        return values

    def _covered(self, at: Float[np.ndarray, " N"], max_gap: float) -> Bool[np.ndarray, " N"]:
        after = np.clip(np.searchsorted(self.time, at, side="right"), 1, len(self.time) - 1)
        inside = (at >= self.time[0]) & (at <= self.time[-1])
        return inside & (self.time[after] - self.time[after - 1] <= max_gap)


@dataclass(frozen=True)
class Drive:
    """What one recording says of one vehicle.

    Attributes:
        name: of the log, without its folder and ending.
        channels: by name; channels that the rig declares absent are not in it.
        notes: what was dropped or repaired on reading, in words.
    """

    name: str
    rig: Rig
    channels: dict[str, Channel]
    notes: tuple[str, ...] = ()


def read_drive(path: str | Path, rig: Rig) -> Drive:
    """Read the channels that a rig names from a log.

    Raises:
        LogError: the log cannot be read, or lacks a topic or field that the rig names.
        RigError: a channel has no usable sample.
    """
    log = open_log(path, clock_column=rig.clock.column, clock_unit=rig.clock.unit)
    return drive_from_log(log, rig)


def drive_from_log(log: Log, rig: Rig) -> Drive:
    """The same for a log that is open already (see `read_drive`)."""
    channels: dict[str, Channel] = {}
    notes: list[str] = list(log.warnings)
    for name, source in rig.channels.items():
        samples = log.read(source.topic, source.fields, stamps=rig.clock.stamps)
        channels[name], said = _channel(name, source, samples, log.path)
        notes += said
    return Drive(log.path.resolve().name.split(".")[0], rig, channels, tuple(notes))


def _channel(name: str, source: ChannelSource, samples: Samples, path: Path) -> tuple[Channel, list[str]]:
    values = convert(name, source, samples.values)
    time = samples.time - source.delay
    notes = []

    bad = ~(np.isfinite(values).all(axis=1) & np.isfinite(time))
    if source.valid is not None:
        with np.errstate(invalid="ignore"):
            bad |= ((values < source.valid[0]) | (values > source.valid[1])).any(axis=1)
    if name == "orientation":
        bad |= ~(np.abs(np.linalg.norm(values, axis=1) - 1) < 0.05)
    if bad.any():
        notes.append(f"{name}: {bad.sum()} of {len(bad)} samples are not finite or not valid and were dropped")
    time, values = time[~bad], values[~bad]

    forward = _increasing(time)
    if not forward.all():
        notes.append(f"{name}: {(~forward).sum()} of {len(forward)} stamps repeat or go back; those samples were dropped")
    time, values = time[forward], values[forward]

    if len(time) < 0.5 * len(forward):
        raise LogError(
            f"{name}: {len(forward) - len(time)} of {len(forward)} stamps repeat or go back",
            where=path,
            how='the clock is broken; try clock.stamps = "receive", or cut the log',
        )
    if len(time) < 2:
        raise RigError(
            f"channel '{name}' (topic '{source.topic}') has no usable samples",
            where=path,
            how="mend its entry in the rig, or declare it absent",
        )
    return Channel(name, CHANNELS[name][0], time, values), notes


def convert(name: str, source: ChannelSource, raw: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
    """Raw numbers of a log -> the channel's unit and sign, as `ChannelSource` says."""
    values = raw
    if source.wrap is not None:
        values = np.where(values > source.wrap.above, values - source.wrap.period, values)
    values = source.sign * (values * source.scale + source.offset) * unit_factor(name, source.unit)
    return values if source.clip is None else np.clip(values, *source.clip)


def _increasing(time: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Rows to keep so that stamps increase: those later than all before, or earlier than all after, if that keeps more.

    One stamp far ahead of its time would by the first rule cost every row after it, by the second only itself.
    """
    if not len(time):
        return np.zeros(0, dtype=bool)
    later = np.append(True, time[1:] > np.maximum.accumulate(time)[:-1])
    earlier = np.append(time[:-1] < np.minimum.accumulate(time[::-1])[::-1][1:], True)
    return later if later.sum() >= earlier.sum() else earlier


def common_span(channels: Sequence[Channel], path: str | Path) -> tuple[float, float]:
    """First and last moment [s] that all of these channels cover.

    Raises:
        LogError: there is no such moment.
    """
    start = max(channel.time[0] for channel in channels)
    end = min(channel.time[-1] for channel in channels)
    if not end > start:
        late = max(channels, key=lambda channel: channel.time[0])
        early = min(channels, key=lambda channel: channel.time[-1])
        raise LogError(
            f"'{early.name}' ends at {early.time[-1]:.3f} s, before '{late.name}' begins at {late.time[0]:.3f} s",
            where=path,
            how="their clocks differ: use clock.stamps = \"receive\", mend a delay, or drop the channel",
        )
    return start, end
