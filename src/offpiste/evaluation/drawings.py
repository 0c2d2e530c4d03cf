"""The worst windows, drawn as the vehicle saw them: heading up."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from offpiste.evaluation.figures import RECORDED, styles
from offpiste.evaluation.worst import WorstWindow

COLUMNS = 5


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
