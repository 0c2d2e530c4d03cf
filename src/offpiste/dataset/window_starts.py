"""Starts of windows."""

import numpy as np
from jaxtyping import Bool, Int

from offpiste.core.conventions import DT, FEATURE_SETS, HISTORY_STEPS, HORIZON_STEPS, MIN_EVALUATION_SPEED
from offpiste.core.errors import DatasetError
from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.resample import Rows
from offpiste.dataset.splits import part_number
from offpiste.dataset.store import Dataset

MIN_HINDSIGHT = 0.5  # smallest share of a window's ground with features in hindsight (paper: all); 0 keeps all windows


def window_starts(
    usable: Bool[np.ndarray, " N"], *, history: int = HISTORY_STEPS, horizon: int = HORIZON_STEPS
) -> Int[np.ndarray, " n"]:
    """Return the rows t for which rows t - history ... t + horizon are all usable."""
    run = np.concatenate(([0], np.cumsum(usable)))
    length = history + horizon + 1
    if len(usable) < length:
        return np.zeros(0, dtype=np.int64)
    return np.flatnonzero(run[length:] - run[:-length] == length) + history


def enough_hindsight(
    cells: Cells | None, least: float, *, horizon: int = HORIZON_STEPS
) -> Bool[np.ndarray, " N"] | None:
    """Return the mask of rows t whose ground along t ... t + horizon - 1 was seen in hindsight to at least a share.

    None if every row qualifies: without cells, or with cells of true ground properties.
    """
    if cells is None or least <= 0 or len(cells.valid) != len(FEATURE_SETS):
        return None
    valid = np.append(cells.valid[FEATURE_SETS.index("hindsight")], False)  # -1 is the last
    run = np.concatenate(([0.0], np.cumsum(valid[cells.index].mean(axis=1))))
    end = np.minimum(np.arange(len(cells.index)) + horizon, len(cells.index))
    return np.asarray((run[end] - run[:-1]) / (end - np.arange(len(cells.index))) >= least - 1e-9)


def evaluation_starts(
    rows: Rows,
    mine: Bool[np.ndarray, " N"],
    min_hindsight: float = 0.0,
    min_speed: float = MIN_EVALUATION_SPEED,
    horizon: int = HORIZON_STEPS,
) -> Int[np.ndarray, " n"]:
    """Return the rows t of a drive at which windows in the rows `mine` start.

    Args:
        min_hindsight: smallest share of ground seen in hindsight (`enough_hindsight`).
        min_speed: of the causal estimate at t [m/s]; 0 includes standstills.
    """
    result = window_starts(rows.valid & mine, horizon=horizon)
    if min_speed > 0:
        result = result[np.hypot(rows.state_causal[result, 3], rows.state_causal[result, 4]) > min_speed]
    enough = enough_hindsight(rows.cells, min_hindsight, horizon=horizon)
    return result if enough is None else result[enough[result]]


def no_window(dataset: Dataset, part: str, horizon: int, min_speed: float) -> DatasetError:
    """Return the error for a part without windows."""
    what = f"the {part} part has no window of {horizon * DT:g} s"
    if any((drive.part == part_number(part)).any() for drive in dataset.drives):
        what, how = f"{what} that starts above {min_speed:.3g} m/s", "give longer or faster drives"
    else:
        count = len(dataset.drives)
        what = f"{what}, and no row (split {dataset.split.text}, {count} drive{'s' * (count > 1)})"
        how = "extract more or longer drives"
    return DatasetError(what, where=dataset.path, how=f"{how}, or choose another --split")
