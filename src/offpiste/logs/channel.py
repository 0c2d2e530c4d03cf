"""A channel: samples of one quantity in SI units at their native stamps, cleaned and converted from a log."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.core.channels import control_of
from offpiste.core.errors import LogError, RigError
from offpiste.core.geometry import LARGEST_DEGREES, bicycle_angle, local_from_geographic
from offpiste.logs.axes import to_z_up
from offpiste.logs.kept_rows import between_samples, brought_together, increasing
from offpiste.logs.log import Log, Samples
from offpiste.rig.channels import (
    GEOGRAPHIC,
    REPEATED,
    ChannelSource,
    Wrap,
    known_channels,
    topic_in_words,
    unit_factor,
)
from offpiste.rig.rig import Rig, Vehicle

_FARTHEST: Final = 1.5e7
"""Largest coordinate that is a measurement and no fault [m]; northings of UTM reach 1e7 m."""
LARGEST: Final = 1e9
"""The same of all other channels, in their units."""
FAR: Final = 1e5
"""Distance from the origin at which places on a plane are percents off [m]."""
KEPT_UP: Final = 6
"""Samples in `motion.window` of a channel that is published only when it changes: its rate is fitted to four."""
LEAST_KEPT: Final = 0.5
"""Share of the samples, copies left aside, whose stamps have to increase."""
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
        values[~self.covered(at, max_gap)] = np.nan
        return values

    def hold(self, at: Float[np.ndarray, " N"], *, max_gap: float) -> Float[np.ndarray, "N k"]:
        """Last value stamped at or before each time, e.g. of a command; NaN as in `linear`."""
        index = np.searchsorted(self.time, at, side="right") - 1
        values = self.values[np.maximum(index, 0)].copy()
        values[~self.covered(at, max_gap)] = np.nan
        return values

    def latest(self, at: Float[np.ndarray, " N"], *, max_gap: float) -> Float[np.ndarray, "N k"]:
        """Last value known at each time, stamped at or before it; NaN where it is older than `max_gap` [s].

        Unlike `hold` it does not look whether, or when, another sample follows.
        """
        index = np.searchsorted(self.time, at, side="right") - 1
        values = self.values[np.maximum(index, 0)].copy()
        values[(index < 0) | (at - self.time[np.maximum(index, 0)] > max_gap)] = np.nan
        return values

    def kept_up(self, until: float, *, every: float) -> "Channel":
        """The same with each value repeated until the next one, and the last one up to a moment.

        Args:
            until: [s].
            every: largest interval between samples [s].
        """
        ends = np.append(self.time[1:], max(until, self.time[-1]))
        lasts = ends - self.time
        counts = np.maximum(np.ceil(lasts / every).astype(int), 1)
        source = np.repeat(np.arange(len(self.time)), counts)
        number = np.arange(len(source)) - np.repeat(np.cumsum(counts) - counts, counts)
        time = self.time[source] + number * (lasts / counts)[source]
        if until > self.time[-1]:
            time, source = np.append(time, until), np.append(source, len(self.time) - 1)
        return dataclasses.replace(self, time=time, values=self.values[source])

    def covered(self, at: Float[np.ndarray, " N"], max_gap: float) -> Bool[np.ndarray, " N"]:
        """Whether `linear` knows a value at each time."""
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
    channel, _, notes = read_numbered_channel(log, rig, name, source)
    return channel, notes


def read_numbered_channel(
    log: Log, rig: Rig, name: str, source: ChannelSource
) -> tuple[Channel, Int[np.ndarray, " n"], list[str]]:
    """The same as `read_channel`, with the number of each sample in the log, from 0."""
    topic = log.topics.get(source.topic)
    fields = source.fields if topic is None else topic.fields_here(source.fields, source.joints)
    samples = log.read(source.topic, fields, stamps=rig.clock.stamps)
    order = np.argsort(samples.time, kind="stable") if rig.clock.sort else np.arange(len(samples.time))
    in_order = Samples(samples.time[order], brought_together(samples.time, samples.values)[order])
    channel, numbers, notes = _clean(name, source, in_order, log.path, rig.vehicle)
    if rig.motion.axes != "z up":
        channel = dataclasses.replace(channel, values=to_z_up(name, source, channel.values, rig.motion.axes))
    return channel, order[numbers], notes


def largest(channel: str) -> float:
    """Largest value of a channel that is a measurement and no fault, in its unit."""
    return _FARTHEST if known_channels()[channel][0] == "m" else LARGEST


def largest_recorded(name: str, source: ChannelSource, column: int, vehicle: Vehicle) -> float:
    """Largest size of a number in a column that is a measurement, in the unit and scale in which it is recorded.

    Of geographic places two columns are degrees, and the height is not.
    """
    geographic = source.unit == GEOGRAPHIC
    if geographic and column < len(LARGEST_DEGREES):
        return LARGEST_DEGREES[column] / abs(source.scale or 1.0)
    factor = unit_factor(name, "m" if geographic else source.unit, vehicle.max_steer)
    return largest(name) / abs(source.scale * factor or 1.0)


def _clean(
    name: str, source: ChannelSource, samples: Samples, path: Path, vehicle: Vehicle
) -> tuple[Channel, Int[np.ndarray, " n"], list[str]]:
    # Clipped last: an infinite or invalid value is a fault to drop, not a value at the limit.
    values = convert(name, msgspec.structs.replace(source, clip=None), samples.values, vehicle)
    time = samples.time - source.delay
    notes = []

    unit = known_channels()[name][0]
    with np.errstate(invalid="ignore"):
        bad = ~((np.abs(values) <= largest(name)).all(axis=1) & np.isfinite(time))
    if source.valid is not None:
        with np.errstate(invalid="ignore"):
            bad |= ((values < source.valid[0]) | (values > source.valid[1])).any(axis=1)
    if name == "orientation":
        bad |= ~(np.abs(np.linalg.norm(values, axis=1) - 1) < 0.05)
    empty = between_samples(np.isnan(values).all(axis=1))
    if (lost := bad & ~empty).any():
        of = f"{lost.sum()} of {(~empty).sum()} samples"
        notes.append(f"{name}: {of} are not finite or not valid and were dropped{_first_run(lost)}")
    numbers = np.flatnonzero(~bad)
    time, values = time[~bad], values[~bad]
    if source.clip is not None:
        values = np.clip(values, *source.clip)
    if source.repeats == "drop":
        new = ~repeated(time, values)
        time, values, numbers = time[new], values[new], numbers[new]

    forward = increasing(time)
    if not forward.all():
        notes.append(
            f"{name}: {(~forward).sum()} of {len(forward)} stamps repeat or go back; those samples were dropped"
        )
    # Messages that are recorded twice say nothing against the clock.
    copies = int(((np.diff(time) == 0) & (np.diff(values, axis=0) == 0).all(axis=1)).sum())
    time, values, numbers = time[forward], values[forward], numbers[forward]

    if len(time) < LEAST_KEPT * (len(forward) - copies):
        raise LogError(
            f"{name}: {len(forward) - len(time)} of {len(forward)} stamps repeat or go back",
            where=path,
            how='the clock is broken: take another clock.column of a table, try clock.stamps = "receive" of a bag, or '
            "cut the log",
        )
    if len(time) < (1 if source.interpolation == "on change" else 2):
        raise RigError(
            f"channel '{name}' ({topic_in_words(source.topic)}) has no usable samples",
            where=path,
            how="fix its entry in the rig, or declare it absent",
        )
    return Channel(name, unit, time, values), numbers, notes


def repeated(time: Float[np.ndarray, " n"], values: Float[np.ndarray, "n k"]) -> Bool[np.ndarray, " n"]:
    """Samples equal to the one before, but for the first after every `REPEATED` of the same value."""
    same = np.append(False, (values[1:] == values[:-1]).all(axis=1))
    begin = np.maximum.accumulate(np.where(same, 0, np.arange(len(time))))
    slot = np.floor((time - time[begin]) / REPEATED)
    return np.asarray(same & (slot == np.append(0, slot[:-1])))


def _first_run(bad: Bool[np.ndarray, " n"]) -> str:
    """Numbers of the first samples in a row."""
    first = int(np.argmax(bad))
    good = np.flatnonzero(~bad[first:])
    last = first + int(good[0]) - 1 if len(good) else len(bad) - 1
    more = ", ..." if bad[last + 1 :].any() else ""
    return f" (sample {first}{more})" if first == last else f" (samples {first} to {last}{more})"


def unwrapped(values: Float[np.ndarray, "*n"], wrap: Wrap) -> Float[np.ndarray, "*n"]:
    """Raw numbers of a counter, those above its threshold less a period."""
    return np.where(values > wrap.above, values - wrap.period, values)


def convert(
    name: str, source: ChannelSource, raw: Float[np.ndarray, "n k"], vehicle: Vehicle
) -> Float[np.ndarray, "n c"]:
    """Raw numbers of a log in the channel's unit and sign, as its `ChannelSource` gives them.

    Args:
        vehicle: of the rig, for steering commands that are angles or turn rates.

    Raises:
        RigError: `source.values` lacks a number of the log.
    """
    if name == "orientation":
        return raw if source.offset == 0 else _turned(raw, source.offset)
    values = _meanings(name, source, raw) if source.values else raw
    if source.unit == GEOGRAPHIC:
        degrees = source.sign * (values * source.scale + source.offset)
        return _near_origin(source, local_from_geographic(degrees, source.origin))
    if source.wrap is not None:
        values = unwrapped(values, source.wrap)
    with np.errstate(over="ignore", invalid="ignore"):  # faults, which are dropped
        turning = values[:, :1] if source.turns else values
        values = source.sign * (turning * source.scale + source.offset)
        values = values * unit_factor(name, source.unit, vehicle.max_steer)
        if source.turns:
            values = bicycle_angle(values, raw[:, 1:], vehicle.wheelbase) / vehicle.max_steer
        if (control := control_of(name)) is not None and control.discrete:
            values = np.clip(np.round(values), control.low, control.high)
    values = np.abs(values) if source.absolute else values
    return values if source.clip is None else np.clip(values, *source.clip)


def _near_origin(source: ChannelSource, place: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "n c"]:
    """The same, if the plane that touches the earth at the rig's origin holds there."""
    away = np.nanmedian(np.hypot(place[:, 0], place[:, 1])) if np.isfinite(place[:, :2]).all(axis=1).any() else 0.0
    if source.origin is not None and away > FAR:
        raise RigError(
            f"channels.position.origin lies {away / 1e3:.0f} km from the places of {topic_in_words(source.topic)}",
            how="give latitude and longitude of a place near the drives, in this order",
        )
    return place


def _meanings(name: str, source: ChannelSource, raw: Float[np.ndarray, "n 1"]) -> Float[np.ndarray, "n 1"]:
    """What the numbers stand for; those that are not finite stay."""
    meanings = source.meanings()
    unknown = np.isfinite(raw) & ~np.isin(raw, list(meanings))
    if unknown.any():
        known = ", ".join(f'"{key}" = {value:g}' for key, value in source.values.items())
        raise RigError(
            f"channels.{name}.values lacks {raw[unknown][0]:g}, which {topic_in_words(source.topic)} has "
            f"{unknown.sum()} times",
            how=f"add what it stands for to values = {{ {known} }}",
        )
    values = raw.copy()
    for recorded, value in meanings.items():
        values[raw == recorded] = value
    return values


def _turned(quaternion: Float[np.ndarray, "n 4"], angle: float) -> Float[np.ndarray, "n 4"]:
    """Orientations turned about the body's z axis [rad]: the product with a quaternion (0, 0, sin, cos)."""
    x, y, z, w = quaternion.T
    sin, cos = np.sin(angle / 2), np.cos(angle / 2)
    return np.stack((x * cos + y * sin, y * cos - x * sin, z * cos + w * sin, w * cos - z * sin), axis=1)
