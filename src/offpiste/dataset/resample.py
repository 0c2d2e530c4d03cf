"""Resampling of a drive to rows at 50 Hz."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields

import numpy as np
from jaxtyping import Bool, Float

from offpiste.core.conventions import DT
from offpiste.core.errors import LogError
from offpiste.dataset.columns import COLUMNS, RowGrid
from offpiste.dataset.features_under_wheels import Cells
from offpiste.logs.drive import Drive, common_span
from offpiste.logs.motion import across_jumps


@dataclass(frozen=True)
class Rows:
    """A drive on an even grid of `conventions.DT` (docs/formats.md)."""

    time: Float[np.ndarray, " N"]  # by the pose's clock [s]
    origin: Float[np.ndarray, " 2"]  # subtracted from px, py so that float32 is precise enough [m]
    state: Float[np.ndarray, "N 6"]  # smoothed targets (`conventions.STATE`)
    state_causal: Float[np.ndarray, "N 6"]  # estimates from the past only
    actuators: Float[np.ndarray, "N A"]  # columns of `Rig.actuators`; NaN where absent
    actuators_causal: Float[np.ndarray, "N A"]  # the same from samples stamped at or before each row
    control: Float[np.ndarray, "N U"]  # columns of `Rig.controls`; NaN where absent
    control_causal: Float[np.ndarray, "N U"]
    # surface normals in the world frame by feature set (D = 1 without a map) and wheel; NaN where unknown
    normal: Float[np.ndarray, "D N 4 3"]
    normal_causal: Float[np.ndarray, "N 3"]  # normal of the path driven until each row
    valid: Bool[np.ndarray, " N"]  # rows with all channels of the rig
    cells: Cells | None = None  # ground cells under the wheels and their features, from a map
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)  # other columns of `COLUMNS`, by name

    @property
    def distance(self) -> float:
        """Distance driven in valid rows [m]."""
        return float(np.hypot(*self.state[self.valid, 3:5].T).sum() * DT)

    @property
    def world_xy(self) -> Float[np.ndarray, "N 2"]:
        """Positions in the world frame in double precision [m]."""
        return np.asarray(self.state[:, :2] + self.origin, np.float64)

    def column(self, name: str) -> np.ndarray:
        """Return a column of `COLUMNS`; NaN if these rows lack it."""
        if name in OWN_COLUMNS:
            return np.asarray(getattr(self, name))
        if name in self.extra:
            return self.extra[name]
        return np.full((len(self.time), *COLUMNS[name].shape), np.nan, np.float32)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return all arrays with a value per row, by name."""
        return {"time": self.time, **{name: self.column(name) for name in COLUMNS}, "valid": self.valid}


OWN_COLUMNS = frozenset(f.name for f in fields(Rows)) - {"time", "origin", "valid", "cells", "extra"}
"""Columns that are attributes of `Rows`."""


def rows_from_arrays(
    arrays: Mapping[str, np.ndarray], origin: Float[np.ndarray, " 2"], cells: Cells | None = None
) -> Rows:
    """Return rows from the arrays of `Rows.arrays`."""
    own = {name: arrays[name] for name in ("time", *OWN_COLUMNS, "valid")}
    extra = {name: values for name, values in arrays.items() if name not in own}
    return Rows(origin=origin, cells=cells, extra=extra, **own)


def extract_rows(drive: Drive) -> Rows:
    """Resample every column of `COLUMNS` to 50 Hz and mark complete rows; nothing is extrapolated or filled.

    Raises `LogError` if the channels share no time, or less than a second of complete rows.
    """
    start, end = common_span(list(drive.channels.values()), drive.name)
    time = start + DT * np.arange(int((end - start) / DT) + 1)
    grid = RowGrid(drive, time)
    columns = {name: column.read(grid) for name, column in COLUMNS.items()}

    complete = {name: column.complete(columns[name], drive.rig) for name, column in COLUMNS.items()}
    valid = np.logical_and.reduce([~across_jumps(drive, time), *complete.values()])
    if valid.sum() * DT < 1.0:
        worst = min(complete, key=lambda name: int(complete[name].sum()))
        raise LogError(
            f"no second of it has all channels of the rig ({valid.sum()} complete rows of {len(valid)}, and "
            f"{complete[worst].sum()} of '{worst}')",
            where=drive.name,
            how="run `offpiste inspect` on it; widen motion.window, so that it holds five samples of the pose, or"
            " clock.max_gap, or declare a channel absent",
        )
    known = np.isfinite(columns["state_causal"]).all(axis=1)
    origin = columns["state_causal"][np.argmax(known), :2].copy()
    for name, column in COLUMNS.items():
        if column.relative:
            columns[name] = columns[name] - np.concatenate((origin, np.zeros(column.shape[0] - 2)))
        columns[name] = columns[name].astype(np.float32)
    return rows_from_arrays({"time": time, **columns, "valid": valid}, origin)
