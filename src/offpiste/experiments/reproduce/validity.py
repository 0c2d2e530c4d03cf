"""Windows whose ground was seen all along: on them, what grows with distance is not for want of features."""

import numpy as np
from jaxtyping import Bool

from offpiste.conventions import HISTORY_STEPS, HORIZON_STEPS
from offpiste.dataset.store import Dataset
from offpiste.dataset.views import set_number
from offpiste.evaluation.judge import Errors


def valid_throughout(dataset: Dataset, feature_set: str, windows: Errors) -> Bool[np.ndarray, " n"]:
    """Whether every wheel stands on a cell with features of the set at rows t-10 ... t+249 of each window."""
    found = np.zeros(len(windows.row), bool)
    for number, drive in enumerate(dataset.drives):
        cells = drive.rows.cells
        mine = np.flatnonzero(windows.drive == number)
        if cells is None or not len(mine):
            continue
        valid = cells.valid[set_number(feature_set, len(cells.valid))]
        seen = ((cells.index >= 0) & valid[cells.index]).all(axis=1) if valid.size else np.zeros(len(cells.index), bool)
        run = np.concatenate(([0], np.cumsum(seen)))
        row = windows.row[mine]
        found[mine] = run[row + HORIZON_STEPS] - run[row - HISTORY_STEPS] == HORIZON_STEPS + HISTORY_STEPS
    return found
