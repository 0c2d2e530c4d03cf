"""Figure of predicted regions of windows with the recorded paths."""

from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics.models import display_name
from offpiste.evaluation.box_plots import RECORDED
from offpiste.report.figure import BLUE, plain, write_png
from offpiste.training.run import load_run, refuse_unfit
from offpiste.uncertainty.calibration import AT, NOMINAL
from offpiste.uncertainty.fit import SpreadPrediction, predict_with_spread
from offpiste.uncertainty.spread import EVERY

PART: Final = "test"
"""Drawn part of the split."""

DRAWN: Final = 10
"""Number of windows."""

COLUMNS: Final = 5
"""Number of panels side by side."""


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
    figure = draw_regions(found, windows.gather(index).target[..., :2].numpy(), run.model)
    write_png(out / "regions.png", figure, dpi=110)
    return out / "regions.png"


def draw_regions(found: SpreadPrediction, recorded: Float[np.ndarray, "B T 2"], model: str) -> Figure:
    """Draw a panel for each window with recorded and predicted path and the regions after 1, 3 and 5 s.

    Args:
        recorded: positions relative to the start [m].
    """
    lines = -(-len(recorded) // COLUMNS)
    figure = Figure(figsize=(14, 3.2 * lines), layout="constrained")
    figure.suptitle(
        f"{display_name(model)}: regions that contain the vehicle with 50, 80 and 95 % after 1, 3 and 5 s", fontsize=10
    )
    panels = figure.subplots(lines, COLUMNS, squeeze=False).ravel()
    for number, axes in enumerate(panels):
        if number >= len(recorded):
            axes.set_axis_off()
            continue
        plain(axes, "")
        for ellipse in ellipses(found, number):
            axes.add_patch(ellipse)
        _draw_path(axes, recorded[number], RECORDED, "recorded")
        _draw_path(axes, found.trajectory.state[number, :, :2].numpy(), BLUE, "predicted")
        axes.set_aspect("equal", adjustable="datalim")
        axes.set(xlabel="x [m]", ylabel="y [m]")
    panels[0].legend(frameon=False, fontsize=8)
    return figure


def ellipses(found: SpreadPrediction, number: int) -> list[Ellipse]:
    """Return the regions of a window in the frame of its start."""
    drawn = []
    for probability in NOMINAL:
        half = found.region(probability)[number].numpy()
        for moment in AT:
            x, y, yaw = found.trajectory.state[number, EVERY * (moment + 1) - 1, :3].tolist()
            along, across = 2 * half[moment]
            drawn.append(Ellipse((x, y), along, across, angle=np.degrees(yaw), color=BLUE, alpha=0.15, linewidth=0))
    return drawn


def _draw_path(axes: Axes, path: Float[np.ndarray, "T 2"], colour: str, label: str) -> None:
    axes.plot(*np.concatenate((np.zeros((1, 2)), path)).T, color=colour, linewidth=1.4, label=label)
    axes.plot(*path[[EVERY * (moment + 1) - 1 for moment in AT]].T, ".", color=colour, markersize=5)
