"""The windows where a model is most wrong, and what was predicted there."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from offpiste.conventions import DT, HISTORY_STEPS, HORIZON_STEPS
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.evaluation.box_plots import RECORDED, styles
from offpiste.evaluation.errors import Errors, in_start_frame, trajectories
from offpiste.evaluation.evaluate import Evaluation
from offpiste.evaluation.report_figures import report_figure, title_of
from offpiste.evaluation.result_rows import REFERENCE, Case

CAPTION = (
    "The windows of largest distance error after 5 s, no two of which overlap. The vehicle starts at the triangle and "
    "looks up; dots are the places after 5 s. A model with several runs has a line for each."
)

SHOWN = 10
"""Number of windows."""

COLUMNS = 5
"""Panels side by side."""


@report_figure("worst", section="Worst windows", caption=CAPTION)
def draw(evaluation: Evaluation) -> Figure:
    """Paths in the worst windows of the model that was named first."""
    shown = evaluation.shown.reading_label
    return worst_plot(predict_worst(evaluation), title=f"Worst windows of {shown}, {title_of(evaluation)}")


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


def worst_windows(errors: Errors, *, count: int = SHOWN) -> Errors:
    """Errors of the windows of largest distance error after 5 s, no two of which share a row; at most `count`."""
    chosen: list[int] = []
    apart = HISTORY_STEPS + HORIZON_STEPS
    for i in np.argsort(-errors.distance(), kind="stable"):
        near = [j for j in chosen if errors.drive[i] == errors.drive[j] and abs(errors.row[i] - errors.row[j]) <= apart]
        if not near:
            chosen.append(int(i))
        if len(chosen) == count:
            break
    return errors.take(np.array(chosen, dtype=np.int64))


def predict_worst(evaluation: Evaluation) -> tuple[WorstWindow, ...]:
    """Paths in the worst windows, predicted again by the model in question and by `kinematic`."""
    dataset, shown = evaluation.windows.dataset, evaluation.shown
    worst = worst_windows(evaluation.errors[shown])
    predicted: list[dict[str, tuple[np.ndarray, ...]]] = [{} for _ in worst.row]
    for case, model, windows, _ in evaluation.predictions:
        if case != shown and not (case.label == REFERENCE and case.start == shown.start):
            continue
        place, index = _located(worst, windows)
        states = trajectories(model.dynamics, windows, index, lookup=case.lookup)
        heading = _rows(dataset, worst, "state_causal" if windows.start == "causal" else "state")[place, 2]
        finite = np.where(np.isfinite(states[..., :2]), states[..., :2], np.nan)
        for i, path in zip(place, in_start_frame(finite, heading), strict=True):
            predicted[i][case.label] = (*predicted[i].get(case.label, ()), path)
    return tuple(_described(dataset, worst, i, shown, predicted[i]) for i in range(len(worst.row)))


def _described(
    dataset: Dataset, worst: Errors, i: int, shown: Case, predicted: dict[str, tuple[np.ndarray, ...]]
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
        error=float(worst.distance()[i]),
        recorded=in_start_frame(recorded, start[None, 2])[0],
        predicted=predicted,
    )


def _located(worst: Errors, windows: Windows) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """Numbers of the worst windows that are among these windows, and their indices there."""
    row = windows.row_in_drive(np.arange(len(windows)))
    match = (windows.drive == worst.drive[:, None]) & (row == worst.row[:, None])
    place, index = np.nonzero(match)
    return place, index


def _rows(dataset: Dataset, worst: Errors, column: str) -> Float[np.ndarray, "n 6"]:
    return np.stack([getattr(dataset.drives[d].rows, column)[r] for d, r in zip(worst.drive, worst.row, strict=True)])


def worst_plot(worst: Sequence[WorstWindow], *, title: str = "") -> Figure:
    """Recorded and predicted paths of windows, in a grid of five columns.

    Every panel starts at the origin and looks up, a metre ahead as long as a metre aside; its title gives the distance
    error after 5 s, speed and heading in the world at the start, the drive and the time in it.
    """
    lines = max(1, -(-len(worst) // COLUMNS))
    figure = Figure(figsize=(11, 0.9 + 3.6 * lines), dpi=150, layout="constrained")
    if title:
        figure.suptitle(title, fontsize=11, x=0.01, ha="left")
    panels = np.atleast_1d(figure.subplots(lines, min(COLUMNS, max(len(worst), 1)), squeeze=False)).ravel()
    style = styles(list(dict.fromkeys(label for window in worst for label in window.predicted)))
    for axes, window in zip(panels, worst, strict=False):
        _draw(axes, window, {label: colour for label, (colour, _) in style.items()})
    for axes in panels[len(worst) :]:
        axes.set_axis_off()
    for i, axes in enumerate(panels[: len(worst)]):
        axes.set_xlabel("to the right [m]", fontsize=8)
        if i % COLUMNS == 0:
            axes.set_ylabel("ahead [m]", fontsize=8)
    if worst:
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False, fontsize=9)
    return figure


def _draw(axes: Axes, window: WorstWindow, colours: dict[str, str]) -> None:
    paths = [("recorded", RECORDED, window.recorded)]
    for label, runs in window.predicted.items():
        paths += [(label if i == 0 else "", colours[label], path) for i, path in enumerate(runs)]
    for label, colour, path in paths:
        if not np.isfinite(path).all():
            path = path[: int(np.argmin(np.isfinite(path).all(axis=1)))]
        ahead, left = np.concatenate((np.zeros((1, 2)), path)).T
        width = 1.0 if len(window.predicted.get(label, ())) > 1 or not label else 1.6
        axes.plot(-left, ahead, color=colour, linewidth=width, label=label or None)
        axes.plot(-left[-1], ahead[-1], marker="o", markersize=4, color=colour)
    axes.plot(0, 0, marker="^", markersize=6, color=RECORDED)
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(color="#e5e5e5", linewidth=0.5)
    axes.tick_params(labelsize=7)
    axes.set_title(
        f"error {_metres(window.error)}\n"
        f"{window.speed:.1f} m/s, heading {np.degrees(window.heading) % 360:.0f}°\n"
        f"{window.drive}, at {window.time:.1f} s",
        fontsize=8,
    )


def _metres(error: float) -> str:
    return f"{error:.2f} m" if np.isfinite(error) else "failed"
