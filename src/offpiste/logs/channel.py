"""Channels: samples of one quantity in SI units at their native stamps, read from a log, cleaned and converted."""

import dataclasses
from bisect import bisect_left
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.core.channels import control_of
from offpiste.core.errors import LogError, RigError
from offpiste.core.geometry import LARGEST_DEGREES, bicycle_angle, local_from_geographic
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

_LARGEST_COORDINATE: Final = 1.5e7
"""Largest plausible coordinate [m]; northings of UTM reach 1e7 m."""
LARGEST: Final = 1e9
"""Largest plausible value of other channels, in their units."""
FAR: Final = 1e5
"""Distance from the origin at which a tangent plane is percents off [m]."""
KEPT_UP: Final = 6
"""Samples per `motion.window` in channels that are published on change; fits of their rates need four."""
LEAST_KEPT: Final = 0.5
"""Smallest share of samples, without copies, whose stamps increase."""
_LONGEST: Final = 86400.0
"""Longest recording [s]; stamps that span more have another unit, or are damaged."""
_SLOWER: Final = 0.1
"""Smallest share of rows left empty by a slower sensor."""
_TOGETHER: Final = 0.01
"""Largest time between messages that belong together [s]."""
_CHANCE: Final = 0.05
"""Largest share of samples in which components share a row by chance."""
_RUNS: Final = 20
"""Number of runs needed to judge how regular they are."""
_HALF_TURN = np.array([1.0, -1.0, -1.0])
WORLD_DOWN: Final = ("world down", "ned")
"""Values of `motion.axes` whose world z axis points down."""
_BODY_DOWN: Final = ("body down", "ned")
"""Values of `motion.axes` whose body z axis points down."""


@dataclass(frozen=True)
class Channel:
    """Samples of one quantity, strictly increasing in time, all finite."""

    name: str
    unit: str  # SI unit of the values (`offpiste.rig.channels.known_channels`)
    time: Float[np.ndarray, " n"]  # native stamps, corrected by the rig's delay [s]
    values: Float[np.ndarray, "n k"]  # a column per component

    def linear(self, at: Float[np.ndarray, " N"], *, max_gap: float) -> Float[np.ndarray, "N k"]:
        """Interpolate linearly; NaN outside the record and between samples further apart than `max_gap` [s]."""
        values = np.stack([np.interp(at, self.time, column) for column in self.values.T], axis=1)
        values[~self.covered(at, max_gap)] = np.nan
        return values

    def hold(self, at: Float[np.ndarray, " N"], *, max_gap: float) -> Float[np.ndarray, "N k"]:
        """Return the last value stamped at or before each time, e.g. of a command; NaN as in `linear`."""
        values = self.latest(at, max_gap=np.inf)
        values[~self.covered(at, max_gap)] = np.nan
        return values

    def latest(self, at: Float[np.ndarray, " N"], *, max_gap: float) -> Float[np.ndarray, "N k"]:
        """Return the last value known at each time; NaN if older than `max_gap` [s].

        Unlike `hold`, it does not depend on later samples.
        """
        index = np.searchsorted(self.time, at, side="right") - 1
        values = self.values[np.maximum(index, 0)].copy()
        values[(index < 0) | (at - self.time[np.maximum(index, 0)] > max_gap)] = np.nan
        return values

    def kept_up(self, until: float, *, every: float) -> "Channel":
        """Repeat each value at intervals of at most `every` until the next one, and the last one until a time [s]."""
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
        """Return whether `linear` knows a value at each time."""
        after = np.clip(np.searchsorted(self.time, at, side="right"), 1, len(self.time) - 1)
        inside = (at >= self.time[0]) & (at <= self.time[-1])
        return inside & (self.time[after] - self.time[after - 1] <= max_gap)


def refuse_long(start: float, end: float, path: str | Path) -> None:
    """Refuse a time grid from `start` to `end` [s] that is longer than a day."""
    if end - start > _LONGEST:
        how = "fix clock.unit, or remove the stamps that are far off"
        raise LogError(f"stamps span {(end - start) / 3600:.0f} hours", where=path, how=how)


def read_channel(
    log: Log, rig: Rig, name: str, source: ChannelSource
) -> tuple[Channel, Int[np.ndarray, " n"], list[str]]:
    """Read a channel, clean and convert it.

    Returns:
        the channel, the number of each sample in the log from 0, and notes on dropped samples.
    """
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
    """Return the largest plausible value of a channel, in its unit."""
    return _LARGEST_COORDINATE if known_channels()[channel][0] == "m" else LARGEST


def largest_recorded(name: str, source: ChannelSource, column: int, vehicle: Vehicle) -> float:
    """Return the largest plausible number in a column as recorded; latitude and longitude have limits in degrees."""
    geographic = source.unit == GEOGRAPHIC
    if geographic and column < len(LARGEST_DEGREES):
        return LARGEST_DEGREES[column] / abs(source.scale or 1.0)
    factor = unit_factor(name, "m" if geographic else source.unit, vehicle.max_steer)
    return largest(name) / abs(source.scale * factor or 1.0)


def _clean(
    name: str, source: ChannelSource, samples: Samples, path: Path, vehicle: Vehicle
) -> tuple[Channel, Int[np.ndarray, " n"], list[str]]:
    # Clipped last: an infinite or invalid value is dropped as a fault, not limited.
    values = convert(name, msgspec.structs.replace(source, clip=None), samples.values, vehicle)
    time, notes = samples.time - source.delay, []
    with np.errstate(invalid="ignore", over="ignore"):
        bad = ~((np.abs(values) <= largest(name)).all(axis=1) & np.isfinite(time))
        if source.valid is not None:
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
    backward = f"{(~forward).sum()} of {len(forward)} stamps repeat or go back"
    if not forward.all():
        notes.append(f"{name}: {backward}; those samples were dropped")
    # Messages that are recorded twice are no sign of a broken clock.
    copies = int(((np.diff(time) == 0) & (np.diff(values, axis=0) == 0).all(axis=1)).sum())
    time, values, numbers = time[forward], values[forward], numbers[forward]
    if len(time) < LEAST_KEPT * (len(forward) - copies):
        how = 'choose another clock.column of a table, try clock.stamps = "receive" of a bag, or cut the log'
        raise LogError(f"{name}: {backward}", where=path, how=f"the clock is broken: {how}")
    if len(time) < (1 if source.interpolation == "on change" else 2):
        what = f"channel '{name}' ({topic_in_words(source.topic)}) has no usable samples"
        raise RigError(what, where=path, how="fix its entry in the rig, or declare it absent")
    return Channel(name, known_channels()[name][0], time, values), numbers, notes


def repeated(time: Float[np.ndarray, " n"], values: Float[np.ndarray, "n k"]) -> Bool[np.ndarray, " n"]:
    """Mark samples equal to the previous one, except for the first in each interval `REPEATED`."""
    same = np.append(False, (values[1:] == values[:-1]).all(axis=1))
    begin = np.maximum.accumulate(np.where(same, 0, np.arange(len(time))))
    slot = np.floor((time - time[begin]) / REPEATED)
    return np.asarray(same & (slot == np.append(0, slot[:-1])))


def _first_run(bad: Bool[np.ndarray, " n"]) -> str:
    """Return the numbers of the first run of marked samples."""
    first = int(np.argmax(bad))
    good = np.flatnonzero(~bad[first:])
    last = first + int(good[0]) - 1 if len(good) else len(bad) - 1
    more = ", ..." if bad[last + 1 :].any() else ""
    return f" (sample {first}{more})" if first == last else f" (samples {first} to {last}{more})"


def between_samples(empty: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Mark empty rows between the samples of a sensor that is slower than its table.

    Runs of empty rows, and runs between them, then have similar lengths within a factor of two. Longer empty runs are
    lost samples; if run lengths vary, rows were lost at random and none is marked.
    """
    none = np.zeros(len(empty), bool)
    if not len(empty) or empty.mean() < _SLOWER:
        return none
    begin = np.flatnonzero(np.diff(empty, prepend=~empty[0]))
    length, is_empty = np.diff(begin, append=len(empty)), empty[begin]
    longest = 0.0
    for kind in (False, True):
        runs = length[1:-1][is_empty[1:-1] == kind]
        if len(runs) < _RUNS:
            return none
        longest = 2 * float(np.median(runs)) + 1
        if np.percentile(runs, 90) > longest:
            return none
    return np.asarray(empty & np.repeat(length <= longest, length))


def brought_together(time: Float[np.ndarray, " n"], values: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
    """Fill the rows of the first column with the other columns' values of nearly the same time.

    CAN buses send latitude and longitude in messages of their own, which become rows of their own. Other rows become
    empty. Nothing is changed if rows hold all columns, other than by chance.

    Args:
        time: stamps, in any order [s].
    """
    if values.shape[1] < 2:
        return values
    known = np.isfinite(values) & np.isfinite(time)[:, None]
    fewest = known.sum(axis=0).min()
    if fewest < 2 or known.all(axis=1).sum() > _CHANCE * fewest:
        return values
    result = np.full_like(values, np.nan)
    at = np.flatnonzero(known[:, 0])
    for column, there in enumerate(known.T):
        rows = np.flatnonzero(there)[np.argsort(time[there], kind="stable")]
        after = np.searchsorted(time[rows], time[at]).clip(1, len(rows) - 1)
        earlier = time[at] - time[rows[after - 1]] < time[rows[after]] - time[at]
        near = rows[after - earlier]
        result[at, column] = np.where(np.abs(time[near] - time[at]) < _TOGETHER, values[near, column], np.nan)
    return result


def increasing(time: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Mark as many rows as possible whose stamps increase, so that an outlier only costs its own row.

    If a clock was set back and as many rows remain before the step as behind it, those before are kept.

    Args:
        time: stamps without NaN [s].
    """
    if not len(time):
        return np.zeros(0, dtype=bool)
    later = np.append(True, time[1:] > np.maximum.accumulate(time)[:-1])
    if len(time) - later.sum() == (np.diff(time) <= 0).sum():
        return later  # each step back costs a row at least
    return max(later, _longest_increasing(time), key=np.sum)


def _longest_increasing(time: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Mark the longest increasing subsequence, found by the smallest last stamp of each length."""
    ends: list[float] = []
    last: list[int] = []
    before = np.full(len(time), -1)
    for row, stamp in enumerate(time.tolist()):
        length = bisect_left(ends, stamp)
        if length:
            before[row] = last[length - 1]
        if length == len(ends) or stamp < ends[length]:
            ends[length : length + 1], last[length : length + 1] = [stamp], [row]
    kept = np.zeros(len(time), dtype=bool)
    row = last[-1]
    while row >= 0:
        kept[row] = True
        row = before[row]
    return kept


def unwrapped(values: Float[np.ndarray, "*n"], wrap: Wrap) -> Float[np.ndarray, "*n"]:
    """Unwrap the raw numbers of a counter."""
    return np.where(values > wrap.above, values - wrap.period, values)


def convert(
    name: str, source: ChannelSource, raw: Float[np.ndarray, "n k"], vehicle: Vehicle
) -> Float[np.ndarray, "n c"]:
    """Convert raw numbers to the channel's unit and sign; the vehicle converts steering angles and turn rates."""
    if name == "orientation":
        return raw if source.offset == 0 else _turned(raw, source.offset)
    values = _meanings(name, source, raw) if source.values else raw
    if source.unit == GEOGRAPHIC:
        degrees = source.sign * (values * source.scale + source.offset)
        return _near_origin(source, local_from_geographic(degrees, source.origin))
    if source.wrap is not None:
        values = unwrapped(values, source.wrap)
    with np.errstate(over="ignore", invalid="ignore"):  # faulty values are dropped later
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
    """Return the positions after checking that they lie near the rig's origin, where the tangent plane is valid."""
    away = np.nanmedian(np.hypot(place[:, 0], place[:, 1])) if np.isfinite(place[:, :2]).all(axis=1).any() else 0.0
    if source.origin is not None and away > FAR:
        where = topic_in_words(source.topic)
        what = f"channels.position.origin lies {away / 1e3:.0f} km from the places of {where}"
        raise RigError(what, how="give latitude and longitude of a place near the drives, in this order")
    return place


def _meanings(name: str, source: ChannelSource, raw: Float[np.ndarray, "n 1"]) -> Float[np.ndarray, "n 1"]:
    """Replace recorded numbers by their meanings; numbers that are not finite stay."""
    meanings = source.meanings()
    unknown = np.isfinite(raw) & ~np.isin(raw, list(meanings))
    if unknown.any():
        known = ", ".join(f'"{key}" = {value:g}' for key, value in source.values.items())
        where = f"{topic_in_words(source.topic)} has {unknown.sum()} times"
        what = f"channels.{name}.values lacks {raw[unknown][0]:g}, which {where}"
        raise RigError(what, how=f"add its meaning to values = {{ {known} }}")
    values = raw.copy()
    for recorded, value in meanings.items():
        values[raw == recorded] = value
    return values


def _turned(quaternion: Float[np.ndarray, "n 4"], angle: float) -> Float[np.ndarray, "n 4"]:
    """Rotate orientations about the body's z axis [rad]: the product with a quaternion (0, 0, sin, cos)."""
    x, y, z, w = quaternion.T
    sin, cos = np.sin(angle / 2), np.cos(angle / 2)
    return np.stack((x * cos + y * sin, y * cos - x * sin, z * cos + w * sin, w * cos - z * sin), axis=1)


def turning_sign(name: str, axes: str) -> int:
    """Return the sign by which an offset in the rig turns a heading, or its rate, to the left.

    Orientations turn about the body's axis, headings about the world's.
    """
    return -1 if axes in (_BODY_DOWN if name == "orientation" else WORLD_DOWN) else 1


def to_z_up(name: str, source: ChannelSource, values: Float[np.ndarray, "n k"], axes: str) -> Float[np.ndarray, "n k"]:
    """Convert values of a channel to a world and a body whose z axes point up, by half a turn about the x axis.

    Positions from latitude and longitude are east, north, up in any log. They become north, west, up where the world of
    the log is north, east, down, as the other channels do.

    Args:
        axes: `motion.axes` of the rig.
    """
    world, body = axes in WORLD_DOWN, axes in _BODY_DOWN
    if name == "orientation":
        x, y, z, w = values.T
        if world:  # i multiplied from the left
            x, y, z, w = w, -z, y, -x
        if body:  # i multiplied from the right
            x, y, z, w = w, z, -y, -x
        return np.stack((x, y, z, w), axis=1)
    if name in ("yaw", "yaw_rate"):
        return values * turning_sign(name, axes)
    if name == "position" and source.unit == GEOGRAPHIC:
        return np.column_stack((values[:, 1], -values[:, 0], values[:, 2:])) if world else values
    is_velocity = name in ("linear_velocity", "angular_velocity")
    in_world = name == "position" or (is_velocity and source.frame == "world")
    if (in_world and world) or (is_velocity and source.frame == "body" and body):
        return values * _HALF_TURN[: values.shape[1]]
    return values
