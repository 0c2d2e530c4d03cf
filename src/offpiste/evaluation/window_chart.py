"""Recorded and predicted paths of windows on their ground, a panel for each."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.core.conventions import DT
from offpiste.evaluation.box_plots import RECORDED, colour_of
from offpiste.evaluation.window_paths import WindowPaths
from offpiste.report.chart import Chart, Line, Panel, Raster
from offpiste.report.figure import SOFT

FADED = 0.55
"""Opacity of the ground, on which lines have to be visible."""
START: Final = Line("", np.zeros(1), np.zeros(1), RECORDED, marker="^")
"""Triangle at the start of a window."""


def window_chart(windows: Sequence[WindowPaths], title: str = "") -> Chart:
    """Paths of windows, each in a panel that starts at the triangle and looks up.

    A panel's title gives the distance error after 5 s, speed and heading in the world at the start, the drive and the
    time in it.
    """
    return Chart([_panel(window) for window in windows], title)


def _panel(window: WindowPaths) -> Panel:
    (ahead, left), half = window.centre, window.half
    x_range, y_range = (-left - half, -left + half), (ahead - half, ahead + half)
    lines, raster = [], None
    if window.ground is not None:
        raster = Raster(window.ground.rgba, (*x_range, *y_range), FADED)
    elif window.driven is not None:
        lines.append(Line("", -window.driven[:, 1], window.driven[:, 0], SOFT, width=5.0, opacity=0.3))
    lines.append(path_line("recorded", RECORDED, window.recorded, window.recorded))
    for label, runs in window.predicted.items():
        width = 1.0 if len(runs) > 1 else 1.6
        lines += [path_line(label, colour_of(label), path, window.recorded, width) for path in runs]
    lines.append(START)
    return Panel(
        "to the right [m]",
        "ahead [m]",
        lines,
        raster=raster,
        title=panel_title(window),
        x_range=x_range,
        y_range=y_range,
        equal=True,
        hover="closest",
    )


def path_line(
    label: str, colour: str, path: Float[np.ndarray, "T 2"], recorded: Float[np.ndarray, "T 2"], width: float = 1.6
) -> Line:
    """A path as far as it is finite; its points show the time and the distance to the recorded path at that time."""
    failed = ~np.isfinite(path).all(axis=1)
    shown = np.concatenate((np.zeros((1, 2)), path[: int(np.argmax(failed)) if failed.any() else None]))
    away = np.linalg.norm(shown - np.concatenate((np.zeros((1, 2)), recorded))[: len(shown)], axis=1)
    hover = [f"{label} after {step * DT:.1f} s" for step in range(len(shown))]
    if path is not recorded:
        hover = [f"{text}\n{metres:.2f} m from the recorded place" for text, metres in zip(hover, away, strict=True)]
    x, y = -shown[:, 1], shown[:, 0]
    return Line(label, x, y, colour, width=width, marker="o", marked="last", hover=hover)


def panel_title(window: WindowPaths) -> str:
    """Title of a panel in three lines."""
    note = f"{window.note}: " if window.note else ""
    error = f"{window.error:.2f} m" if np.isfinite(window.error) else "failed"
    return (
        f"{note}error {error}\n"
        f"{window.speed:.1f} m/s, heading {np.degrees(window.heading) % 360:.0f}°\n"
        f"{window.drive}, at {window.time:.1f} s"
    )
