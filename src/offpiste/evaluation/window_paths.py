"""Windows that a report draws: which ones, what was driven and predicted there, and the ground that was known."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.core.conventions import DT, HISTORY_STEPS, HORIZON_STEPS
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.evaluation.errors import Errors, in_start_frame, trajectories
from offpiste.evaluation.evaluate import Evaluation, Prediction
from offpiste.evaluation.ground_pictures import GroundPicture, ground_pictures
from offpiste.evaluation.metrics import Case

APART: Final = HISTORY_STEPS + HORIZON_STEPS
"""Rows between windows that share none."""

NEAR = 0.1
"""Share of the windows by which one may be off the quantile that it stands for."""

NOT_WORST = 0.75
"""Share of the windows that are not called the worst."""

MARGIN = 4.0
"""Ground that is drawn around the paths [m]."""

MOST_REACH = 2.0
"""Panels reach no further than this many times what the recorded path needs: predictions that run away are cut."""


@dataclass(frozen=True)
class WindowPaths:
    """A window to be drawn, in the frame of its start: ahead, to the left [m].

    Attributes:
        drive: its name.
        time: of the start, since the start of the drive [s].
        heading: yaw at the start, in the world [rad].
        speed: at the start, by the causal estimate [m/s].
        error: distance error after 5 s of the model that chose the window, mean over its runs [m].
        recorded: path.
        predicted: paths by model, one a run.
        note: what the window was chosen for.
        driven: the drive's whole path around the window; NaN where it is outside.
        centre, half: middle and half the width of the square that is drawn.
        ground: the map in that square; None where there is none.
    """

    drive: str
    time: float
    heading: float
    speed: float
    error: float
    recorded: Float[np.ndarray, "T 2"]
    predicted: dict[str, tuple[Float[np.ndarray, "T 2"], ...]]
    note: str = ""
    driven: Float[np.ndarray, "N 2"] | None = None
    centre: tuple[float, float] = (12.0, 0.0)
    half: float = 16.0
    ground: GroundPicture | None = None


def worst_windows(errors: Errors, *, count: int) -> Errors:
    """Errors of the windows of largest distance error after 5 s, no two of which share a row; at most `count`.

    None is among the better `NOT_WORST`: on a short part there are not as many.
    """
    distance = errors.distance()
    order = np.argsort(-distance, kind="stable")
    bad = distance >= np.quantile(distance, NOT_WORST, method="nearest")
    return errors.take(_apart(errors, order[bad[order]], count))


def typical_windows(errors: Errors, shares: Sequence[float], *, each: int) -> tuple[Errors, list[float]]:
    """Errors of the windows closest to quantiles of the distance error after 5 s, no two of which share a row.

    Those that are farther than `NEAR` from them are left out: on a short part others take the rows of the closest.

    Args:
        shares: the quantiles, 0 to 1; those that fall on failed predictions are left out.
        each: windows for each of them.

    Returns:
        The errors, and the share that each window was chosen for.
    """
    distance, chosen = errors.distance(), np.empty(0, np.int64)
    of: list[float] = []
    for share in each * sorted(shares, key=lambda share: abs(share - 0.5)):  # the median first, where rows are few
        low, wanted, high = np.quantile(distance, np.clip((share - NEAR, share, share + NEAR), 0, 1), method="nearest")
        if np.isfinite(wanted):
            near = np.argsort(np.abs(distance - wanted), kind="stable")
            near = near[(distance[near] >= low) & (distance[near] <= high) & np.isfinite(distance[near])]
            added = _apart(errors, near, 1, chosen)
            chosen = np.concatenate((chosen, added))
            of += [share] * len(added)
    order = np.argsort(of, kind="stable")
    return errors.take(chosen[order]), [of[i] for i in order]


def _apart(
    errors: Errors, order: Int[np.ndarray, " n"], count: int, taken: Int[np.ndarray, " m"] | None = None
) -> Int[np.ndarray, " k"]:
    """The first `count` windows in this order that share no row with each other, nor with those taken."""
    used: list[int] = [] if taken is None else taken.tolist()
    chosen: list[int] = []
    for i in order:
        if len(chosen) == count:
            break
        if not any(errors.drive[i] == errors.drive[j] and abs(errors.row[i] - errors.row[j]) <= APART for j in used):
            chosen.append(int(i))
            used.append(int(i))
    return np.array(chosen, dtype=np.int64)


def predict_paths(
    evaluation: Evaluation, chosen: Errors, cases: Sequence[Case], notes: Sequence[str] = ()
) -> tuple[WindowPaths, ...]:
    """Paths in some windows, predicted again by each run of each model, on the ground as the dataset keeps it.

    Args:
        chosen: errors of the windows in the case that chose them.
        cases: those to be drawn, one a model.
        notes: what each window was chosen for.
    """
    dataset, start = evaluation.windows.dataset, cases[0].start
    poses = _rows(dataset, chosen, "state_causal" if start == "causal" else "state")
    predicted: list[dict[str, tuple[np.ndarray, ...]]] = [{case.label: () for case in cases} for _ in chosen.row]
    for prediction in evaluation.predictions:
        if prediction.case in cases:
            place, paths = _paths(prediction, chosen, poses)
            for i, path in zip(place, paths, strict=True):
                predicted[i][prediction.case.label] = (*predicted[i][prediction.case.label], path)
    windows = [_described(dataset, chosen, i, poses[i], predicted[i]) for i in range(len(chosen.row))]
    squares = [(window.centre, window.half) for window in windows]
    grounds = ground_pictures(dataset, chosen.drive, chosen.row, poses[:, :3], squares)
    return tuple(
        WindowPaths(**{**vars(window), "ground": ground, "note": note})
        for window, ground, note in zip(windows, grounds, notes or [""] * len(windows), strict=True)
    )


def _paths(
    prediction: Prediction, chosen: Errors, poses: Float[np.ndarray, "n 6"]
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m T 2"]]:
    """Numbers of the chosen windows that a run predicts, and its paths in them."""
    place, index = _located(chosen, prediction.windows)
    model, windows, lookup = prediction.model, prediction.windows, prediction.case.lookup
    states = trajectories(model.dynamics, windows, index, lookup=lookup)
    finite = np.where(np.isfinite(states[..., :2]), states[..., :2], np.nan)
    return place, in_start_frame(finite, poses[place, 2])


def _described(
    dataset: Dataset,
    chosen: Errors,
    i: int,
    pose: Float[np.ndarray, " 6"],
    predicted: dict[str, tuple[np.ndarray, ...]],
) -> WindowPaths:
    drive, row = dataset.drives[chosen.drive[i]], int(chosen.row[i])
    rows = drive.rows
    path = in_start_frame((rows.state[:, :2] - pose[:2])[None], pose[None, 2])[0]
    recorded = path[row + 1 : row + 1 + HORIZON_STEPS]
    centre, half = _square(recorded, [path for runs in predicted.values() for path in runs])
    return WindowPaths(
        drive=drive.name,
        time=row * DT,
        heading=float(pose[2]),
        speed=float(np.hypot(*rows.state_causal[row, 3:5])),
        error=float(chosen.distance()[i]),
        recorded=recorded,
        predicted=predicted,
        driven=_inside(path, rows.valid, centre, half),
        centre=centre,
        half=half,
    )


def _square(recorded: np.ndarray, predicted: Sequence[np.ndarray]) -> tuple[tuple[float, float], float]:
    """Middle and half the width of a square around the recorded path, and the predicted ones within reason."""
    own = np.concatenate((np.zeros((1, 2)), recorded))
    low, high = own.min(axis=0), own.max(axis=0)
    reach = MOST_REACH * max(float((high - low).max()) / 2, MARGIN)
    middle = (low + high) / 2
    for path in predicted:
        ends = np.clip(path[np.isfinite(path).all(axis=1)], middle - reach, middle + reach)
        low = np.minimum(low, ends.min(axis=0, initial=np.inf))
        high = np.maximum(high, ends.max(axis=0, initial=-np.inf))
    ahead, left = (low + high) / 2
    return (float(ahead), float(left)), float((high - low).max()) / 2 + MARGIN


def _inside(
    path: Float[np.ndarray, "N 2"], valid: Bool[np.ndarray, " N"], centre: tuple[float, float], half: float
) -> Float[np.ndarray, "M 2"]:
    """Every fifth point of the part of a path that lies in a square, with NaN between its pieces."""
    shown = valid & (np.abs(path - centre).max(axis=1) <= half)
    thin = np.arange(0, len(path), 5)
    kept = shown[thin] | np.roll(shown[thin], 1)
    return np.where(shown[thin, None], path[thin], np.nan)[kept]


def _located(chosen: Errors, windows: Windows) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """Numbers of the chosen windows that are among these windows, and their indices there."""
    row = windows.row_in_drive(np.arange(len(windows)))
    match = (windows.drive == chosen.drive[:, None]) & (row == chosen.row[:, None])
    place, index = np.nonzero(match)
    return place, index


def _rows(dataset: Dataset, chosen: Errors, column: str) -> Float[np.ndarray, "n 6"]:
    rows = [getattr(dataset.drives[d].rows, column)[r] for d, r in zip(chosen.drive, chosen.row, strict=True)]
    return np.array(rows, dtype=np.float64).reshape(-1, 6)
