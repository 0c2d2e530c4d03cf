"""Recorded and predicted paths of windows on their ground, a panel each, as a picture and for a browser."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from offpiste.core.conventions import DT
from offpiste.evaluation.box_plots import RECORDED, colour_of
from offpiste.evaluation.window_paths import WindowPaths
from offpiste.report.chart import INK, SOFT, Chart, escaped, layout, rounded

COLUMNS = 5
"""Panels side by side in the picture."""

PANEL_PIXELS = 330
"""Height of a panel in a browser."""

FADED = 0.55
"""Opacity of the ground, on which lines have to be seen."""

EVERY = 10
"""Steps between the points of a path in a browser."""


@dataclass(frozen=True)
class WindowChart:
    """Paths of windows, each in a panel that starts at the triangle and looks up.

    A metre ahead is as long as a metre aside. A panel's title gives the distance error after 5 s, speed and heading in
    the world at the start, the drive and the time in it.
    """

    windows: Sequence[WindowPaths]
    title: str = ""

    def figure(self) -> Figure:
        """The panels as a picture, in a grid of five columns."""
        count = len(self.windows)
        columns = min(COLUMNS, max(count, 1))
        lines = max(1, -(-count // columns))
        figure = Figure(figsize=(11, 0.9 + 3.1 * lines), dpi=150, layout="constrained")
        if self.title:
            figure.suptitle(self.title, fontsize=11, x=0.01, ha="left")
        panels = np.atleast_1d(figure.subplots(lines, columns, squeeze=False)).ravel()
        for axes, window in zip(panels, self.windows, strict=False):
            _draw(axes, window)
        for axes in panels[count:]:
            axes.set_axis_off()
        for i, axes in enumerate(panels[:count]):
            axes.set_xlabel("to the right [m]", fontsize=8)
            if i % COLUMNS == 0:
                axes.set_ylabel("ahead [m]", fontsize=8)
        if count:
            handles, labels = panels[0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False, fontsize=9)
        return figure

    def charts(self) -> Sequence[Chart]:
        """A chart for each panel."""
        return [_chart(window) for window in self.windows]


def _finite(path: Float[np.ndarray, "T 2"]) -> Float[np.ndarray, "t 2"]:
    """A path from its start as far as it is finite."""
    failed = ~np.isfinite(path).all(axis=1)
    return np.concatenate((np.zeros((1, 2)), path[: int(np.argmax(failed)) if failed.any() else None]))


def _draw(axes: Axes, window: WindowPaths) -> None:
    (ahead, left), half = window.centre, window.half
    if window.ground is not None:
        extent = (-left - half, -left + half, ahead - half, ahead + half)
        axes.imshow(window.ground.rgba, extent=extent, alpha=FADED, interpolation="nearest")
    elif window.driven is not None:
        axes.plot(-window.driven[:, 1], window.driven[:, 0], color="#d5d9dd", linewidth=5, zorder=1)
    paths = [("recorded", RECORDED, window.recorded)]
    for label, runs in window.predicted.items():
        paths += [(label if i == 0 else "", colour_of(label), path) for i, path in enumerate(runs)]
    for label, colour, path in paths:
        forward, side = _finite(path).T
        width = 1.0 if len(window.predicted.get(label, ())) > 1 or not label else 1.6
        axes.plot(-side, forward, color=colour, linewidth=width, label=label or None)
        axes.plot(-side[-1], forward[-1], marker="o", markersize=4, color=colour)
    axes.plot(0, 0, marker="^", markersize=6, color=RECORDED)
    axes.set_aspect("equal")
    axes.set(xlim=(-left - half, -left + half), ylim=(ahead - half, ahead + half))
    axes.grid(color="#e5e5e5", linewidth=0.5)
    axes.tick_params(labelsize=7)
    axes.set_title(panel_title(window), fontsize=8)


def panel_title(window: WindowPaths) -> str:
    """What a panel says of its window, in three lines."""
    note = f"{window.note}: " if window.note else ""
    return (
        f"{note}error {_metres(window.error)}\n"
        f"{window.speed:.1f} m/s, heading {np.degrees(window.heading) % 360:.0f}°\n"
        f"{window.drive}, at {window.time:.1f} s"
    )


def _metres(error: float) -> str:
    return f"{error:.2f} m" if np.isfinite(error) else "failed"


def _chart(window: WindowPaths) -> Chart:
    (ahead, left), half = window.centre, window.half
    traces: list[dict[str, Any]] = []
    if window.ground is None and window.driven is not None:
        traces.append(_line(window.driven, {"color": SOFT, "width": 9}, opacity=0.3, hoverinfo="skip"))
    traces.append(_trace("recorded", INK, 3.0, window.recorded, window.recorded))
    for label, runs in window.predicted.items():
        width = 2.2 if len(runs) == 1 else 1.5
        traces += [_trace(label, colour_of(label), width, path, window.recorded) for path in runs]
    start = {"color": INK, "symbol": "triangle-up", "size": 11}
    traces.append({"type": "scatter", "x": [0], "y": [0], "mode": "markers", "marker": start, "hoverinfo": "skip"})
    axis = {"ticksuffix": " m", "nticks": 6, "constrain": "domain"}
    x = {**axis, "range": (-left - half, -left + half)}
    y = {**axis, "range": (ahead - half, ahead + half), "scaleanchor": "x"}
    margin = {"l": 36, "r": 6, "t": 6, "b": 28}
    images = [] if window.ground is None else [_image(window, window.ground.address)]
    return Chart(
        PANEL_PIXELS,
        traces,
        layout(x=x, y=y, margin=margin, images=images, showlegend=False, hovermode="closest"),
        panel_title(window),
    )


def _image(window: WindowPaths, address: str) -> Mapping[str, Any]:
    (ahead, left), half = window.centre, window.half
    place = {"x": -left - half, "y": ahead + half, "sizex": 2 * half, "sizey": 2 * half}
    how = {"xref": "x", "yref": "y", "sizing": "stretch", "layer": "below", "opacity": FADED}
    return {"source": address, **place, **how}


def _trace(
    label: str, colour: str, width: float, path: Float[np.ndarray, "T 2"], recorded: Float[np.ndarray, "T 2"]
) -> dict[str, Any]:
    """A path whose points show the time since the start and the distance to the recorded path at that time."""
    shown = _finite(path)
    steps = np.unique([*range(0, len(shown), EVERY), len(shown) - 1])
    away = np.linalg.norm(shown - np.concatenate((np.zeros((1, 2)), recorded))[: len(shown)], axis=1)
    of = "" if label == "recorded" else "<br>%{customdata[1]} m from the recorded place"
    return {
        **_line(shown[steps], {"color": colour, "width": width}),
        "name": escaped(label),
        "mode": "lines+markers",
        "marker": {"color": colour, "size": [0] * (len(steps) - 1) + [9], "opacity": 1},
        "customdata": [[f"{step * DT:.1f}", f"{away[step]:.2f}"] for step in steps],
        "hovertemplate": f"{escaped(label)} after %{{customdata[0]}} s{of}<extra></extra>",
    }


def _line(path: Float[np.ndarray, "n 2"], line: Mapping[str, Any], **others: Any) -> dict[str, Any]:
    x, y = rounded(-path[:, 1], 2), rounded(path[:, 0], 2)
    return {"type": "scatter", "mode": "lines", "x": x, "y": y, "line": line, **others}
