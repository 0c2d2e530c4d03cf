"""Declared columns of a drive's rows, read by resampling, the store, validation and windows.

Modules of this package and extensions (`offpiste.core.registry`) register a `Column` by name.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal

import numpy as np
from jaxtyping import Bool, Float

from offpiste.core.channels import channel_of_rate, control_of
from offpiste.core.errors import DatasetError, LogError
from offpiste.core.geometry import local_polynomial
from offpiste.core.registry import Registry
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.logs.motion import Motion, estimate_motion
from offpiste.rig.rig import Rig

Segment = Literal["past", "start", "ahead", "target"]
"""Rows of a window: t-10 ... t-1; t; t ... t+T-1; t+1 ... t+T."""


@dataclass(frozen=True)
class RowGrid:
    """Drive and the evenly spaced times of its rows by the pose's clock [s]."""

    drive: Drive
    time: Float[np.ndarray, " N"]

    @cached_property
    def motion(self) -> Motion:
        """Planar states at the rows."""
        return estimate_motion(self.drive, self.time)

    def channel(self, name: str, *, causal: bool) -> Float[np.ndarray, " N"]:
        """Return a channel of one field at the rows; NaN in gaps and for an absent channel.

        Args:
            causal: use only samples stamped at or before each row.
        """
        channel, gap = self._measured(name, causal=causal), self.drive.rig.clock.max_gap
        if channel is None:
            return np.full(len(self.time), np.nan)
        if causal:
            return channel.latest(self.time, max_gap=gap)[:, 0]
        source, control = self.drive.rig.channels.get(name), control_of(name)
        hold = (source is not None and source.holds) or (control is not None and control.discrete)
        return (channel.hold if hold else channel.linear)(self.time, max_gap=gap)[:, 0]

    def _measured(self, name: str, *, causal: bool) -> Channel | None:
        """Return a channel of the log or the derivative that replaces it; None if the log has neither."""
        channel = self.drive.channels.get(name)
        if channel is None and (measured := channel_of_rate(name)) in self.drive.channels:
            return _derivative(self.drive.channels[measured], window=self.drive.rig.motion.window, causal=causal)
        return channel


def _derivative(channel: Channel, *, window: float, causal: bool) -> Channel:
    _, rate = local_polynomial(channel.time, channel.values, channel.time, window=window, causal=causal)
    known = np.isfinite(rate[:, 0])
    if known.sum() < 2:
        raise LogError(f"{channel.name}: too few samples in {window:g} s for its rate", how="widen motion.window")
    return Channel(f"{channel.name} rate", f"{channel.unit}/s", channel.time[known], rate[known])


@dataclass(frozen=True)
class Column:
    """Column of float32 values [N, *shape], or [D, N, *shape] by feature set."""

    read: Callable[[RowGrid], np.ndarray]  # reads the values of a drive; NaN where unknown
    shape: tuple[int, ...] = ()  # of one row
    # components that a rig's logs have; in complete rows they are finite
    present: Callable[[Rig], bool | Sequence[bool]] = lambda rig: True
    segments: tuple[Segment, ...] = ()  # rows of a window in a batch
    # layout of `conventions.STATE`, with px, py relative to the drive's origin, or to a window's start
    relative: bool = False
    by_feature_set: bool = False  # one value per feature set; stays on disk, and only `normal` is gathered into batches

    @property
    def row_axis(self) -> int:
        """Axis of the rows."""
        return int(self.by_feature_set)

    def complete(self, values: np.ndarray, rig: Rig) -> Bool[np.ndarray, " N"]:
        """Return the mask of rows in which all present components are finite."""
        unknown = ~np.isfinite(values) & np.asarray(self.present(rig))
        others = tuple(axis for axis in range(values.ndim) if axis != self.row_axis)
        return np.asarray(~unknown.any(axis=others))


COLUMNS: Final[Registry[Column]] = Registry("column", package=__name__, error=DatasetError)


def channel_column(name: str, *segments: Segment) -> Column:
    """Return a column of a channel with one field, causal if windows read only its past and start."""
    causal = set(segments) <= {"past", "start"}
    return Column(lambda grid: grid.channel(name, causal=causal), (), lambda rig: name in rig.channels, segments)
