"""Description of a figure, drawn with Matplotlib for PNG files and with Plotly (`plotly_charts`) for pages."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib import cbook
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from offpiste.report.figure import plain

MEDIAN, MEAN = "#1a7f37", "#d95f02"


@dataclass(frozen=True)
class Line:
    """Line through points.

    Attributes:
        label: in the legend; "" for none.
        colour: #rrggbb.
        style: of Matplotlib, "-" to "-.".
        width: in points.
        marker: of Matplotlib; "" for none.
        marked: points with a marker.
        low, high: ends of a band around the line.
        hover: text of each point on a page.
    """

    label: str
    x: Float[np.ndarray, " n"]
    y: Float[np.ndarray, " n"]
    colour: str
    style: str = "-"
    width: float = 1.6
    marker: Literal["", "o", "^"] = ""
    marked: Literal["all", "last"] = "all"
    opacity: float = 1.0
    low: Float[np.ndarray, " n"] | None = None
    high: Float[np.ndarray, " n"] | None = None
    hover: Sequence[str] = ()


def by_end(lines: Sequence[Line]) -> list[Line]:
    """Sort lines by their last finite values, the highest first, as in a legend beside them."""

    def end(line: Line) -> float:
        finite = line.y[np.isfinite(line.y)]
        return float(finite[-1]) if len(finite) else -np.inf

    return sorted(lines, key=end, reverse=True)


@dataclass(frozen=True)
class Box:
    """Horizontal box over the quartiles with whiskers, median and mean.

    Attributes:
        numbers: by the names of `matplotlib.cbook.boxplot_stats`; not finite without a box.
    """

    label: str
    colour: str
    numbers: Mapping[str, float]


@dataclass(frozen=True)
class Raster:
    """Image below the lines.

    Attributes:
        extent: left, right, bottom, top.
    """

    rgba: UInt8[np.ndarray, "h w 4"]
    extent: tuple[float, float, float, float]
    opacity: float = 1.0


@dataclass(frozen=True)
class Panel:
    """Pair of axes with their content.

    Attributes:
        x_axis, y_axis: names and units.
        boxes: the first at the top.
        x_range, y_range: ends of the axes; None: range of the lines, for y from 0.
        x_ticks: names of the places 0, 1, ... on the axis; empty: numbers.
        equal: whether both axes have the same scale.
        hover: Plotly's hovermode.
    """

    x_axis: str
    y_axis: str = ""
    lines: Sequence[Line] = ()
    boxes: Sequence[Box] = ()
    raster: Raster | None = None
    title: str = ""
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    x_ticks: Sequence[str] = ()
    equal: bool = False
    hover: Literal["x unified", "y unified", "y", "closest"] = "x unified"


@dataclass(frozen=True)
class Chart:
    """Figure of one panel, or of several small panels with a common legend."""

    panels: Sequence[Panel]
    title: str = ""


COLUMNS = 5
"""Largest number of small panels side by side in a PNG file."""


def box_statistics(values: Float[np.ndarray, " n"]) -> dict[str, float]:
    """Return the numbers of a box; infinite values count in the quartiles, and numbers they make infinite are NaN."""
    found = cbook.boxplot_stats(np.minimum(values, 1e300), whis=1.5)[0]
    box = {name: float(found[name]) for name in ("whislo", "q1", "med", "q3", "whishi", "mean")}
    if not np.isfinite(values).all():
        box["mean"] = np.nan
    return dict.fromkeys(box, np.nan) if box["q3"] > 1e200 else box


def draw(chart: Chart) -> Figure:
    """Draw a chart with Matplotlib."""
    count = len(chart.panels)
    small = count > 1
    columns = min(COLUMNS, count)
    rows = -(-count // columns)
    height = max(1.1 + 0.5 * len(panel.boxes) if panel.boxes else 4.2 for panel in chart.panels)
    size = (2.2 * COLUMNS, 0.9 + 3.1 * rows) if small else (8.0, height)
    figure = Figure(figsize=size, dpi=150, layout="constrained")
    figure.suptitle(chart.title if small else "", fontsize=11, x=0.01, ha="left")
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for place, (axes, panel) in enumerate(zip(grid, chart.panels, strict=False)):
        plain(axes, "" if small else panel.title or chart.title, grid="x" if panel.boxes else "both")
        _draw_panel(axes, panel)
        if small:
            axes.set_title(panel.title, fontsize=8)
            axes.tick_params(labelsize=7)
            axes.set_ylabel("" if place % columns else panel.y_axis, fontsize=8)
            axes.set_xlabel(panel.x_axis, fontsize=8)
    for axes in grid[count:]:
        axes.set_axis_off()
    handles, labels = grid[0].get_legend_handles_labels()
    named = dict(zip(labels, handles, strict=True))  # runs of a model share a label
    if named:
        where: dict[str, Any] = {"loc": "outside lower center", "ncols": 6} if small else {"loc": "outside right upper"}
        figure.legend([*named.values()], [*named], frameon=False, fontsize=8, **where)
    return figure


def _draw_panel(axes: Axes, panel: Panel) -> None:
    if panel.raster is not None:
        axes.imshow(panel.raster.rgba, extent=panel.raster.extent, alpha=panel.raster.opacity, interpolation="nearest")
    for line in panel.lines:
        look: dict[str, Any] = {"color": line.colour, "linewidth": line.width, "alpha": line.opacity}
        look |= {"marker": line.marker, "markersize": 6 if line.marker == "^" else 4}
        look["markevery"] = [-1] if line.marked == "last" else None
        axes.plot(line.x, line.y, line.style, label=line.label or None, **look)
        if line.low is not None and line.high is not None:
            axes.fill_between(line.x, line.low, line.high, color=line.colour, alpha=0.13, linewidth=0)
    if panel.boxes:
        draw_boxes(axes, panel.boxes, np.arange(float(len(panel.boxes))), orientation="horizontal")
        axes.spines["left"].set_visible(False)
        axes.tick_params(left=False)
    axes.set(xlabel=panel.x_axis, ylabel=panel.y_axis, xlim=panel.x_range)
    axes.set_ylim(*(panel.y_range or (0, None)))
    if panel.x_ticks:
        axes.set_xticks(range(len(panel.x_ticks)), panel.x_ticks)
    if panel.equal:
        axes.set_aspect("equal")


def draw_boxes(
    axes: Axes,
    boxes: Sequence[Box],
    places: Float[np.ndarray, " n"],
    *,
    orientation: Literal["vertical", "horizontal"],
) -> None:
    """Draw boxes with Matplotlib; the thin median lies on the thick mean, so that both are visible."""
    drawn = axes.bxp(
        [{**box.numbers, "label": box.label} for box in boxes],
        positions=places,
        orientation=orientation,
        widths=0.6,
        showfliers=False,
        showmeans=True,
        meanline=True,
        patch_artist=True,
        manage_ticks=orientation == "horizontal",
        medianprops={"color": MEDIAN, "linewidth": 1.6, "zorder": 4},
        meanprops={"color": MEAN, "linewidth": 3.4, "linestyle": "-", "zorder": 3},
    )
    for patch, box in zip(drawn["boxes"], boxes, strict=True):
        patch.set(facecolor=box.colour, alpha=0.4, edgecolor="none")
