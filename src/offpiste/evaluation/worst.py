"""The windows where a model is most wrong, and what it predicted there."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from offpiste.conventions import DT, HISTORY_STEPS, HORIZON_STEPS
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics import Dynamics
from offpiste.evaluation.judge import Errors, trajectories
from offpiste.evaluation.tabulate import REFERENCE, Case

SHOWN = 10


@dataclass(frozen=True)
class WorstWindow:
    """A window to be drawn.

    Attributes:
        drive: its name.
        time: of the start, since the start of the drive [s].
        heading: yaw at the start, in the world [rad].
        speed: at the start, by the causal estimate [m/s].
        error: distance error after 5 s, mean over the model's runs [m].
        recorded: path in the frame of the start: ahead, to the left [m].
        predicted: paths by model, one a run.
    """

    drive: str
    time: float
    heading: float
    speed: float
    error: float
    recorded: Float[np.ndarray, "T 2"]
    predicted: dict[str, tuple[Float[np.ndarray, "T 2"], ...]]


@dataclass(frozen=True)
class Worst:
    """Which windows: what identifies them, and the distance error after 5 s [m]."""

    drive: Int[np.ndarray, " n"]
    row: Int[np.ndarray, " n"]
    error: Float[np.ndarray, " n"]


def worst_windows(errors: Errors, *, count: int = SHOWN) -> Worst:
    """The windows of largest distance error after 5 s, no two of which share a row; at most `count`."""
    chosen: list[int] = []
    apart = HISTORY_STEPS + HORIZON_STEPS
    for i in np.argsort(-errors.distance(), kind="stable"):
        near = [j for j in chosen if errors.drive[i] == errors.drive[j] and abs(errors.row[i] - errors.row[j]) <= apart]
        if not near:
            chosen.append(int(i))
        if len(chosen) == count:
            break
    index = np.array(chosen, dtype=np.int64)
    return Worst(errors.drive[index], errors.row[index], errors.distance()[index])


def draw_worst(
    worst: Worst, judged: Sequence[tuple[Case, Dynamics, Windows]], *, shown: Case, dataset: Dataset
) -> tuple[WorstWindow, ...]:
    """Predict the worst windows again, by the model in question and by `kinematic`, and keep the paths."""
    predicted: list[dict[str, tuple[np.ndarray, ...]]] = [{} for _ in worst.row]
    for case, dynamics, windows in judged:
        if case != shown and not (case.label == REFERENCE and case.start == shown.start):
            continue
        place, index = _located(worst, windows)
        states = trajectories(dynamics, windows, index, lookup=case.lookup)
        heading = _rows(dataset, worst, "state_causal" if windows.start == "causal" else "state")[place, 2]
        finite = np.where(np.isfinite(states[..., :2]), states[..., :2], np.nan)
        for i, path in zip(place, _turned(finite, heading), strict=True):
            predicted[i][case.label] = (*predicted[i].get(case.label, ()), path)
    return tuple(_described(dataset, worst, i, shown, predicted[i]) for i in range(len(worst.row)))


def _described(
    dataset: Dataset, worst: Worst, i: int, shown: Case, predicted: dict[str, tuple[np.ndarray, ...]]
) -> WorstWindow:
    drive, row = dataset.drives[worst.drive[i]], int(worst.row[i])
    rows = drive.rows
    start = (rows.state_causal if shown.start == "causal" else rows.state)[row]
    recorded = (rows.state[row + 1 : row + 1 + HORIZON_STEPS, :2] - start[:2])[None]
    return WorstWindow(
        drive=drive.name,
        time=row * DT,
        heading=float(start[2]),
        speed=float(np.hypot(*rows.state_causal[row, 3:5])),
        error=float(worst.error[i]),
        recorded=_turned(recorded, start[None, 2])[0],
        predicted=predicted,
    )


def _located(worst: Worst, windows: Windows) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """Which of the worst windows are among these, and where."""
    row = windows.row_in_drive(np.arange(len(windows)))
    match = (windows.drive == worst.drive[:, None]) & (row == worst.row[:, None])
    place, index = np.nonzero(match)
    return place, index


def _rows(dataset: Dataset, worst: Worst, column: str) -> Float[np.ndarray, "n 6"]:
    return np.stack([getattr(dataset.drives[d].rows, column)[r] for d, r in zip(worst.drive, worst.row, strict=True)])


def _turned(paths: Float[np.ndarray, "n T 2"], heading: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n T 2"]:
    """World displacements as ahead and to the left of a start heading."""
    cos, sin = np.cos(heading)[:, None], np.sin(heading)[:, None]
    x, y = paths[..., 0], paths[..., 1]
    return np.stack((cos * x + sin * y, cos * y - sin * x), axis=-1)
