"""A channel: samples of one quantity in SI units at their native stamps, cleaned and converted from a log."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from msgspec.structs import replace

from offpiste.errors import LogError, RigError
from offpiste.logs.log import Log, Samples
from offpiste.rig.channels import ChannelSource, known_channels, unit_factor
from offpiste.rig.rig import Rig

_FARTHEST: Final = 1.5e7
"""Largest coordinate that is a measurement and no fault [m]; northings of UTM reach 1e7 m."""
_LARGEST: Final = 1e9
"""The same of all other channels, in their units."""
_LONGEST: Final = 86400.0
"""Longest recording [s]: stamps that span more are of another unit, or damaged."""


@dataclass(frozen=True)
class Channel:
    """Samples of one quantity, strictly increasing in time, all finite.

    Attributes:
        unit: SI unit of the values (`offpiste.rig.channels.known_channels`).
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
        """Last value stamped at or before each time, e.g. of a command; NaN as in `linear`."""
        index = np.searchsorted(self.time, at, side="right") - 1
        values = self.values[np.maximum(index, 0)].copy()
        values[~self._covered(at, max_gap)] = np.nan
        return values

    def latest(self, at: Float[np.ndarray, " N"], *, max_gap: float) -> Float[np.ndarray, "N k"]:
        """Last value known at each time, stamped at or before it; NaN where it is older than `max_gap` [s].

        Unlike `hold` it does not look whether, or when, another sample follows.
        """
        index = np.searchsorted(self.time, at, side="right") - 1
        values = self.values[np.maximum(index, 0)].copy()
        values[(index < 0) | (at - self.time[np.maximum(index, 0)] > max_gap)] = np.nan
        return values

    def _covered(self, at: Float[np.ndarray, " N"], max_gap: float) -> Bool[np.ndarray, " N"]:
        after = np.clip(np.searchsorted(self.time, at, side="right"), 1, len(self.time) - 1)
        inside = (at >= self.time[0]) & (at <= self.time[-1])
        return inside & (self.time[after] - self.time[after - 1] <= max_gap)


def refuse_long(start: float, end: float, path: str | Path) -> None:
    """Raise if a grid of time from `start` to `end` [s] would be longer than any recording.

    Raises:
        LogError: it is longer than a day.
    """
    if end - start > _LONGEST:
        raise LogError(
            f"stamps span {(end - start) / 3600:.0f} hours",
            where=path,
            how="fix clock.unit, or cut away the stamps that are far off",
        )


def read_channel(log: Log, rig: Rig, name: str, source: ChannelSource) -> tuple[Channel, list[str]]:
    """One channel, cleaned and converted, and the samples dropped, in words.

    Raises:
        LogError: the log lacks the topic or field, or its clock is broken.
        RigError: no usable sample.
    """
    samples = log.read(source.topic, source.fields, stamps=rig.clock.stamps)
    return _clean(name, source, samples, log.path)


def _clean(name: str, source: ChannelSource, samples: Samples, path: Path) -> tuple[Channel, list[str]]:
    # Clipped last: an infinite or invalid value is a fault to drop, not a value at the limit.
    values = convert(name, replace(source, clip=None), samples.values)
    time = samples.time - source.delay
    notes = []

    unit = known_channels()[name][0]
    with np.errstate(invalid="ignore"):
        bad = ~((np.abs(values) <= (_FARTHEST if unit == "m" else _LARGEST)).all(axis=1) & np.isfinite(time))
    if source.valid is not None:
        with np.errstate(invalid="ignore"):
            bad |= ((values < source.valid[0]) | (values > source.valid[1])).any(axis=1)
    if name == "orientation":
        bad |= ~(np.abs(np.linalg.norm(values, axis=1) - 1) < 0.05)
    if bad.any():
        notes.append(f"{name}: {bad.sum()} of {len(bad)} samples are not finite or not valid and were dropped")
    time, values = time[~bad], values[~bad]
    if source.clip is not None:
        values = np.clip(values, *source.clip)

    forward = _increasing(time)
    if not forward.all():
        notes.append(
            f"{name}: {(~forward).sum()} of {len(forward)} stamps repeat or go back; those samples were dropped"
        )
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
            how="fix its entry in the rig, or declare it absent",
        )
    return Channel(name, unit, time, values), notes


def convert(name: str, source: ChannelSource, raw: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
    """Raw numbers of a log in the channel's unit and sign, as its `ChannelSource` gives them."""
    values = raw
    if source.wrap is not None:
        values = np.where(values > source.wrap.above, values - source.wrap.period, values)
    with np.errstate(over="ignore", invalid="ignore"):  # faults, which are dropped
        values = source.sign * (values * source.scale + source.offset) * unit_factor(name, source.unit)
    return values if source.clip is None else np.clip(values, *source.clip)


def _increasing(time: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Rows to keep so that stamps increase: those later than all before, or earlier than all after if that keeps more.

    A single stamp far in the future would drop every row after it by the first rule, only itself by the second.
    """
    if not len(time):
        return np.zeros(0, dtype=bool)
    later = np.append(True, time[1:] > np.maximum.accumulate(time)[:-1])
    earlier = np.append(time[:-1] < np.minimum.accumulate(time[::-1])[::-1][1:], True)
    return later if later.sum() >= earlier.sum() else earlier
