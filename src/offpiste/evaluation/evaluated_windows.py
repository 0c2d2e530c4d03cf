"""Properties of evaluated windows: speed bands, driven distance, and overlap with the training path."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from offpiste.core.conventions import DT, HORIZON_STEPS
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset

NEAR: Final = 5.0
"""Largest distance of a place driven in training from the training path [m]."""

REVERSING: Final = 0.3
"""Backward speed above which a window starts in reverse if the log has no gear [m/s]."""


class Band(NamedTuple):
    """Range of initial speeds [m/s]."""

    name: str
    low: float
    high: float


BANDS: Final = (
    Band("0 to 1.5 m/s", 0.0, 1.5),
    Band("1.5 to 4 m/s", 1.5, 4.0),
    Band("4 to 8 m/s", 4.0, 8.0),
    Band("above 8 m/s", 8.0, np.inf),
)
"""Bands of windows that do not start in reverse."""

REVERSE: Final = "reverse"
"""Band of windows that start in reverse gear, or backwards if the log has no gear."""


@dataclass(frozen=True)
class EvaluatedWindows:
    """Evaluated windows of a dataset.

    Attributes:
        drive, row: index of each window's drive in the dataset, and row of its start in that drive.
    """

    dataset: Dataset
    drive: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]

    def at_start(self, column: str) -> Float[np.ndarray, "n ..."]:
        """Return a column of the dataset's rows (`offpiste.dataset.resample.Rows`) at the windows' starts."""
        drives = [drive.rows.column(column) for drive in self.dataset.drives]
        return np.array([drives[d][r] for d, r in zip(self.drive, self.row, strict=True)], dtype=float)

    @cached_property
    def start_state(self) -> Float[np.ndarray, "n 6"]:
        """Causal estimate of the initial state: px, py, yaw, vx, vy, yaw rate [m, rad, m/s, rad/s]."""
        return self.at_start("state_causal")

    @cached_property
    def start_speed(self) -> Float[np.ndarray, " n"]:
        """Causal estimate of the initial speed [m/s]."""
        return np.hypot(*self.start_state[:, 3:5].T)

    @cached_property
    def driven_distance(self) -> Float[np.ndarray, " n"]:
        """Length of the path driven during the 5 s of the window [m]."""
        # Rows outside of any window may be NaN.
        run = [
            np.concatenate(([0.0], np.cumsum(np.nan_to_num(np.hypot(*d.rows.state[:, 3:5].T.astype(float))) * DT)))
            for d in self.dataset.drives
        ]
        pairs = zip(self.drive, self.row, strict=True)
        return np.array([run[d][r + HORIZON_STEPS] - run[d][r] for d, r in pairs], dtype=float)

    def usual_step(self, stride: int) -> float:
        """Return the median number of rows between windows; `stride` if no drive has two windows."""
        key = np.unique(self.drive.astype(np.int64) << 32 | self.row)
        steps = np.diff(key & 0xFFFFFFFF)[np.diff(key >> 32) == 0]
        return float(np.median(steps)) if len(steps) else float(stride)


def in_reverse(windows: EvaluatedWindows) -> Bool[np.ndarray, " n"]:
    """Return a mask of the windows that start in reverse: by the gear, or by the velocity if there is none."""
    columns = [control.name for control in windows.dataset.rig.controls]
    backwards = windows.start_state[:, 3] < -REVERSING
    if "gear" not in columns:
        return np.asarray(backwards)
    gear = windows.at_start("control")[:, columns.index("gear")]
    return np.asarray(np.where(gear == 0, backwards, gear < 0))


def members(windows: EvaluatedWindows) -> dict[str, Bool[np.ndarray, " n"]]:
    """Return a mask of windows for each band that is not empty."""
    reverse, speed = in_reverse(windows), windows.start_speed
    bands = {band.name: ~reverse & (speed >= band.low) & (speed < band.high) for band in BANDS} | {REVERSE: reverse}
    return {name: mine for name, mine in bands.items() if mine.any()}


def share_driven_in_training(dataset: Dataset, part: str = "test") -> float:
    """Return the share of a part's path, by length, within `NEAR` of training rows of any drive.

    Drives are compared in the log's world frame; in drives of different worlds, places coincide by chance only. 0
    without training rows, NaN if the part has no path.
    """
    trained = np.concatenate([_places(dataset, number, "train")[0] for number in range(len(dataset.drives))])
    evaluated = [_places(dataset, number, part) for number in range(len(dataset.drives))]
    places = np.concatenate([place for place, _ in evaluated])
    metres = np.concatenate([length for _, length in evaluated])
    if metres.sum() == 0:
        return float("nan")
    if not len(trained):
        return 0.0
    distance, _ = cKDTree(trained).query(places, distance_upper_bound=NEAR)
    return float(metres[np.isfinite(distance)].sum() / metres.sum())


def _places(dataset: Dataset, number: int, part: str) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Return world positions of a part's valid rows in one drive, and the distance driven in each [m]."""
    drive = dataset.drives[number]
    chosen = drive.rows.valid & (drive.part == PARTS.index(part))
    state = drive.rows.state[chosen].astype(float)
    return state[:, :2] + drive.rows.origin, np.hypot(state[:, 3], state[:, 4]) * DT
