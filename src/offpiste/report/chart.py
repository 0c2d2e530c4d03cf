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
from offpiste.report.text_table import number

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

    @property
    def end(self) -> float:
        """Last finite value; -inf if there is none."""
        finite = self.y[np.isfinite(self.y)]
        return float(finite[-1]) if len(finite) else -np.inf


def by_end(lines: Sequence[Line]) -> list[Line]:
    """Sort lines by their ends, the highest first, as in a legend beside them."""
    return sorted(lines, key=lambda line: -line.end)


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
        x_range, y_range: ends of the axes; None: range of the lines, for y from 0.
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
    equal: bool = False
    hover: Literal["x unified", "y unified", "y", "closest"] = "x unified"


@dataclass(frozen=True)
class Chart:
    """Figure of one panel, or of several small panels with a common legend.

    Attributes:
        columns: largest number of panels side by side in a PNG file.
    """

    panels: Sequence[Panel]
    title: str = ""
    columns: int = 5


def box_statistics(values: Float[np.ndarray, " n"]) -> dict[str, float]:
    """Return the numbers of a box; infinite values count in the quartiles, and numbers they make infinite are NaN."""
    failed = not np.isfinite(values).all()
    found = cbook.boxplot_stats(np.minimum(values, 1e300), whis=1.5)[0]
    box = {name: float(found[name]) for name in ("whislo", "q1", "med", "q3", "whishi", "mean")}
    if failed:
        box["mean"] = np.nan
    if box["q3"] > 1e200:
        box.update(dict.fromkeys(("q1", "med", "q3", "whislo", "whishi"), np.nan))
    return box


def box_panel(boxes: Sequence[Box], x_axis: str) -> Panel:
    """Return a panel with boxes below each other, the first at the top."""
    ends = [box.numbers[name] for box in boxes for name in ("whishi", "mean") if np.isfinite(box.numbers[name])]
    top = 1.02 * (max(ends, default=1.0) or 1.0)
    return Panel(x_axis, boxes=boxes, x_range=(0.0, top), y_range=(len(boxes) - 0.4, -0.6), hover="y")


def draw(chart: Chart) -> Figure:
    """Draw a chart with Matplotlib."""
    count = len(chart.panels)
    small = count > 1
    height = max(1.1 + 0.42 * len(panel.boxes) if panel.boxes else 4.2 for panel in chart.panels)
    columns = min(chart.columns, count)
    rows, wide = -(-count // columns), 2.2 if chart.columns <= 5 else 1.6
    size = (wide * chart.columns, 0.9 + 1.4 * wide * rows) if small else (8.0, height)
    figure = Figure(figsize=size, dpi=150, layout="constrained")
    if small:
        figure.suptitle(chart.title, fontsize=11, x=0.01, ha="left")
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
        numbers = [{**box.numbers, "label": box.label} for box in panel.boxes]
        places = np.arange(float(len(numbers)))
        draw_boxes(axes, numbers, [box.colour for box in panel.boxes], places, orientation="horizontal")
        _write_numbers(axes, panel.boxes)
        axes.spines["left"].set_visible(False)
        axes.tick_params(left=False)
    axes.set(xlabel=panel.x_axis, ylabel=panel.y_axis, xlim=panel.x_range)
    axes.set_ylim(*(panel.y_range or (0, None)))
    if panel.equal:
        axes.set_aspect("equal")


def draw_boxes(
    axes: Axes,
    numbers: Sequence[Mapping[str, Any]],
    colours: Sequence[str],
    places: Float[np.ndarray, " n"],
    *,
    orientation: Literal["vertical", "horizontal"],
) -> None:
    """Draw boxes with Matplotlib; the thin median lies on the thick mean, so that both are visible."""
    drawn = axes.bxp(
        [dict(each) for each in numbers],
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
    for patch, colour in zip(drawn["boxes"], colours, strict=True):
        patch.set(facecolor=colour, alpha=0.4, edgecolor="none")


def _write_numbers(axes: Axes, boxes: Sequence[Box]) -> None:
    """Write medians and means in two columns to the right of the boxes."""
    for right, name, key, colour in ((1.07, "median", "med", MEDIAN), (1.16, "mean", "mean", MEAN)):
        style: dict[str, Any] = {"color": colour, "fontsize": 9, "ha": "right"}
        axes.text(right, 1.01, name, transform=axes.transAxes, va="bottom", **style)
        for place, box in enumerate(boxes):
            text = number(box.numbers[key])
            axes.text(right, place, text, transform=axes.get_yaxis_transform(), va="center", **style)
