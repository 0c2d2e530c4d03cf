"""Windows that models are evaluated on: speed, distance, and whether training has driven there before."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from offpiste.core.conventions import DT, HORIZON_STEPS
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset

NEAR = 5.0
"""A place counts as driven in training within this distance [m]."""


@dataclass(frozen=True)
class EvaluatedWindows:
    """Quantities of windows, one value per window.

    Attributes:
        drive, row: number of the window's drive in the dataset, and row of its start in that drive.
    """

    dataset: Dataset
    drive: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]

    def at_start(self, column: str) -> Float[np.ndarray, "n ..."]:
        """Values of a column at the windows' starts.

        Args:
            column: of the dataset's rows (`offpiste.dataset.resample.Rows`), e.g. "control".
        """
        drives = [drive.rows.column(column) for drive in self.dataset.drives]
        return np.array([drives[d][r] for d, r in zip(self.drive, self.row, strict=True)], dtype=float)

    @cached_property
    def start_state(self) -> Float[np.ndarray, "n 6"]:
        """Causal estimate of the state at the start: px, py, yaw, vx, vy, yaw rate [m, rad, m/s, rad/s]."""
        return self.at_start("state_causal")

    @cached_property
    def start_speed(self) -> Float[np.ndarray, " n"]:
        """Speed at the start, by the causal estimate [m/s]."""
        return np.hypot(*self.start_state[:, 3:5].T)

    @cached_property
    def driven_distance(self) -> Float[np.ndarray, " n"]:
        """Length of the path driven in the window's 5 s [m]."""
        # Rows outside of any window may be NaN and must not spoil the running sum.
        run = [
            np.concatenate(([0.0], np.cumsum(np.nan_to_num(np.hypot(*d.rows.state[:, 3:5].T.astype(float))) * DT)))
            for d in self.dataset.drives
        ]
        pairs = zip(self.drive, self.row, strict=True)
        return np.array([run[d][r + HORIZON_STEPS] - run[d][r] for d, r in pairs], dtype=float)

    def usual_step(self, stride: int) -> float:
        """Median rows between windows; `stride` where no drive has two of them."""
        key = np.unique(self.drive.astype(np.int64) << 32 | self.row)
        steps = np.diff(key & 0xFFFFFFFF)[np.diff(key >> 32) == 0]
        return float(np.median(steps)) if len(steps) else float(stride)


def share_driven_in_training(dataset: Dataset, part: str = "test", *, near: float = NEAR) -> float:
    """Share of a part's path (by metres) that training rows of any drive pass within `near` metres.

    Drives are compared by their positions in the log's world frame; where each drive has a world of its own, places of
    different drives coincide by chance only. 0 where nothing is trained on, nan where the part has no path.
    """
    trained = np.concatenate([_places(dataset, number, "train")[0] for number in range(len(dataset.drives))])
    evaluated = [_places(dataset, number, part) for number in range(len(dataset.drives))]
    places = np.concatenate([place for place, _ in evaluated])
    metres = np.concatenate([length for _, length in evaluated])
    if metres.sum() == 0:
        return float("nan")
    if not len(trained):
        return 0.0
    distance, _ = cKDTree(trained).query(places, distance_upper_bound=near)
    return float(metres[np.isfinite(distance)].sum() / metres.sum())


def _places(dataset: Dataset, number: int, part: str) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """World positions of a part's valid rows in one drive, and the metres driven in each."""
    drive = dataset.drives[number]
    chosen = drive.rows.valid & (drive.part == PARTS.index(part))
    state = drive.rows.state[chosen].astype(float)
    return state[:, :2] + drive.rows.origin, np.hypot(state[:, 3], state[:, 4]) * DT
