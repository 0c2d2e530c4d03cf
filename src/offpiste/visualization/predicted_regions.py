"""Figure of predicted regions of windows with the recorded paths."""

from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.core.conventions import DT
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics.models import display_name
from offpiste.evaluation.box_plots import RECORDED
from offpiste.report.chart import Chart, Line, Panel, draw
from offpiste.report.figure import BLUE, write_png
from offpiste.training.run import load_run, refuse_unfit
from offpiste.uncertainty.calibration import AT, HORIZONS, NOMINAL
from offpiste.uncertainty.fit import SpreadPrediction, predict_with_spread

PART: Final = "test"
"""Drawn part of the split."""

DRAWN: Final = 10
"""Number of windows."""

MARGIN: Final = 4.0
"""Margin around the paths [m]."""


def view_regions(folder: Path, dataset: Dataset, out: Path) -> Path:
    """Write regions.png with a run's predictions for windows across the test part, on their maps.

    Raises:
        RunError: the run is missing, does not fit the dataset or has no spread.
        DatasetError: the part has no window with a map.
    """
    run = load_run(folder)
    refuse_unfit(run, dataset)
    windows = Windows(dataset, PART)
    index = windows.evaluation_indices(5)
    index = index[np.unique(np.linspace(0, len(index) - 1, DRAWN).astype(int))]
    found = predict_with_spread(run, windows[index], "map")
    chart = regions_chart(found, windows.gather(index).target[..., :2].numpy(), run.model)
    write_png(out / "regions.png", draw(chart))
    return out / "regions.png"


def regions_chart(found: SpreadPrediction, recorded: Float[np.ndarray, "B T 2"], model: str) -> Chart:
    """Describe a panel for each window with recorded and predicted path and the regions after 1, 3 and 5 s.

    Args:
        recorded: positions relative to the start [m].
    """
    panels = []
    for number, path in enumerate(recorded):
        predicted = found.trajectory.state[number, :, :2].numpy()
        outlines = ellipses(found, number)
        shown = np.concatenate((np.zeros((1, 2)), path, predicted, *outlines))
        shown = shown[np.isfinite(shown).all(axis=1)]
        middle, half = (shown.min(axis=0) + shown.max(axis=0)) / 2, np.ptp(shown, axis=0).max() / 2 + MARGIN
        (left, right), (low, high) = np.stack((middle - half, middle + half), axis=1).tolist()
        lines = [Line("", x, y, BLUE, width=0.8, opacity=0.6) for x, y in (outline.T for outline in outlines)]
        for label, colour, places in (("recorded", RECORDED, path), ("predicted", BLUE, predicted)):
            x, y = np.concatenate((np.zeros((1, 2)), places)).T
            lines.append(Line(label, x, y, colour, marker="o", marked="last"))
        panels.append(Panel("x [m]", "y [m]", lines, x_range=(left, right), y_range=(low, high), equal=True))
    title = f"{display_name(model)}: regions that contain the vehicle with 50, 80 and 95 % after 1, 3 and 5 s"
    return Chart(panels, title)


def ellipses(found: SpreadPrediction, number: int) -> list[Float[np.ndarray, "P 2"]]:
    """Return the outlines of the regions of a window in the frame of its start, by probability and time [m]."""
    angle = np.linspace(0, 2 * np.pi, 61)
    outlines = []
    for probability in NOMINAL:
        half = found.region(probability)[number].numpy()
        for moment, seconds in zip(AT, HORIZONS, strict=True):
            x, y, yaw = found.trajectory.state[number, round(seconds / DT) - 1, :3].tolist()
            along, across = half[moment, 0] * np.cos(angle), half[moment, 1] * np.sin(angle)
            cos, sin = np.cos(yaw), np.sin(yaw)
            outlines.append(np.column_stack((x + cos * along - sin * across, y + sin * along + cos * across)))
    return outlines
