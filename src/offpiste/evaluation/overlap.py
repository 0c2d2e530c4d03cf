"""What the judged windows are like: how fast, how far, and whether training has driven there before."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from offpiste.conventions import DT, HORIZON_STEPS
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset

NEAR = 5.0
"""A place counts as driven in training within this distance [m]."""


def start_speeds(dataset: Dataset, drive: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Speed at the start of windows, by the causal estimate [m/s]."""
    speed = [np.hypot(*d.rows.state_causal[:, 3:5].T.astype(float)) for d in dataset.drives]
    return np.array([speed[d][r] for d, r in zip(drive, row, strict=True)], dtype=float)


def driven_distances(
    dataset: Dataset, drive: Int[np.ndarray, " n"], row: Int[np.ndarray, " n"], *, steps: int = HORIZON_STEPS
) -> Float[np.ndarray, " n"]:
    """Metres driven along the path in the 5 s of each window."""
    # Rows outside of any window may be NaN and must not spoil the running sum.
    run = [
        np.concatenate(([0.0], np.cumsum(np.nan_to_num(np.hypot(*d.rows.state[:, 3:5].T.astype(float))) * DT)))
        for d in dataset.drives
    ]
    return np.array([run[d][r + steps] - run[d][r] for d, r in zip(drive, row, strict=True)], dtype=float)


def share_driven_in_training(dataset: Dataset, part: str = "test", *, near: float = NEAR) -> float:
    """Share of a part's path (by metres) that training rows of any drive pass within `near` metres.

    Drives are compared by their positions in the log's world frame; where each drive has a world of its own, places of
    different drives coincide by chance only. 0 where nothing is trained on, nan where the part has no path.
    """
    trained = np.concatenate([_places(dataset, number, "train")[0] for number in range(len(dataset.drives))])
    judged = [_places(dataset, number, part) for number in range(len(dataset.drives))]
    places = np.concatenate([place for place, _ in judged])
    metres = np.concatenate([length for _, length in judged])
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
