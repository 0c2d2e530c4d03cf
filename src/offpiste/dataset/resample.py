"""From a drive to rows at 50 Hz: what every model reads, with nothing guessed and nothing filled."""

import numpy as np
from jaxtyping import Bool, Float

from offpiste.conventions import DT
from offpiste.dataset.columns import COLUMNS, RowGrid
from offpiste.dataset.rows import Rows, rows_from_arrays
from offpiste.errors import LogError
from offpiste.logs.drive import Drive, common_span
from offpiste.logs.poses import find_jumps


def extract_rows(drive: Drive) -> Rows:
    """Bring a drive to 50 Hz: every column of `COLUMNS`, and which rows are complete.

    Raises:
        LogError: the channels have no common time, or no second of it is complete.
    """
    start, end = common_span(list(drive.channels.values()), drive.name)
    time = start + DT * np.arange(int((end - start) / DT) + 1)
    grid = RowGrid(drive, time)
    columns = {name: column.read(grid) for name, column in COLUMNS.items()}

    valid = ~_across_jumps(drive, time)
    for name, column in COLUMNS.items():
        valid &= column.complete(columns[name], drive.rig)
    if valid.sum() * DT < 1.0:
        raise LogError(
            f"no second of it has all channels of the rig ({valid.sum()} complete rows of {len(valid)})",
            where=drive.name,
            how="run `offpiste inspect` on it; widen clock.max_gap or motion.window, or declare a channel absent",
        )
    origin = columns["state"][np.flatnonzero(valid)[0], :2].copy()
    for name, column in COLUMNS.items():
        if column.relative:
            columns[name] = columns[name] - np.concatenate((origin, np.zeros(column.shape[0] - 2)))
        columns[name] = columns[name].astype(np.float32)
    return rows_from_arrays({"time": time, **columns, "valid": valid}, origin)


def _across_jumps(drive: Drive, time: Float[np.ndarray, " N"]) -> Bool[np.ndarray, " N"]:
    """Rows whose motion would be estimated from samples on both sides of a jump."""
    across, window = np.zeros(len(time), bool), max(drive.rig.motion.window, 2 * DT)
    for before, after in find_jumps(drive.channels["position"], drive.channels.get("orientation")):
        # Targets use half a window to either side, causal states a whole one back.
        across |= (time > before - window / 2) & (time < after + window)
    return across
