"""Lines with bands over one axis, drawn as a picture and as an interactive chart."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from offpiste.report.chart import DASHES, Chart, escaped, layout, rounded, translucent
from offpiste.report.figure import single

MOST_POINTS = 200
"""Points of a line in a browser; a longer one is thinned."""


@dataclass(frozen=True)
class Line:
    """A line.

    Attributes:
        colour: #rrggbb.
        style: of Matplotlib, "-" to "-.".
        low, high: ends of a band around it.
    """

    label: str
    x: Float[np.ndarray, " n"]
    y: Float[np.ndarray, " n"]
    colour: str
    style: str = "-"
    low: Float[np.ndarray, " n"] | None = None
    high: Float[np.ndarray, " n"] | None = None

    @property
    def end(self) -> float:
        """The last finite value; -inf where there is none."""
        finite = self.y[np.isfinite(self.y)]
        return float(finite[-1]) if len(finite) else -np.inf


@dataclass(frozen=True)
class LineChart:
    """Lines with a legend.

    Attributes:
        x_axis, y_axis: names and units.
        x_range, y_range: ends of the axes; None where the lines say; the y axis then begins at 0.
        markers: whether points are drawn on the lines; legends are then in the order of the lines' ends.
        hover: axis along which a browser shows the values of all lines.
    """

    lines: Sequence[Line]
    x_axis: str
    y_axis: str
    title: str = ""
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    markers: bool = True
    hover: Literal["x", "y"] = "x"

    def figure(self) -> Figure:
        """The lines as a picture, with the legend to the right, where it hides nothing."""
        figure, axes = single(7.6, 4.2, self.title)
        mark: dict[str, Any] = {"marker": "o", "markersize": 4} if self.markers else {}
        handles = []
        for line in self.lines:
            handles += axes.plot(line.x, line.y, line.style, color=line.colour, label=line.label, **mark)
            if line.low is not None and line.high is not None:
                axes.fill_between(line.x, line.low, line.high, color=line.colour, alpha=0.13, linewidth=0)
        axes.set(xlabel=self.x_axis, ylabel=self.y_axis, xlim=self.x_range)
        axes.set_ylim(*(self.y_range or (0, None)))
        order = self._legend_order()
        axes.legend(
            [handles[i] for i in order],
            [self.lines[i].label for i in order],
            frameon=False,
            fontsize=8,
            loc="upper left",
            bbox_to_anchor=(1.0, 1.0),
        )
        return figure

    def charts(self) -> Sequence[Chart]:
        """The lines as one chart."""
        traces: list[dict[str, Any]] = []
        for place in self._legend_order():
            line = self.lines[place]
            if line.low is not None and line.high is not None:
                traces.append(_band(line, line.low, line.high))
            traces.append(self._trace(line))
        y_range = self.y_range or (0.0, 1.05 * self._top())
        axes: dict[str, Any] = {
            "x": {"title": {"text": self.x_axis}, **({"range": self.x_range} if self.x_range else {})},
            "y": {"title": {"text": self.y_axis}, "range": y_range},
        }
        return (Chart(430, traces, layout(**axes, hovermode=f"{self.hover} unified")),)

    def _legend_order(self) -> list[int]:
        if not self.markers:
            return list(range(len(self.lines)))
        return sorted(range(len(self.lines)), key=lambda i: -self.lines[i].end)

    def _trace(self, line: Line) -> dict[str, Any]:
        thin = np.unique(np.linspace(0, len(line.x) - 1, min(MOST_POINTS, len(line.x))).astype(int))
        return {
            "type": "scatter",
            "name": escaped(line.label),
            "mode": "lines+markers" if self.markers else "lines",
            "x": rounded(line.x[thin]),
            "y": rounded(line.y[thin]),
            "line": {"color": line.colour, "dash": DASHES[line.style], "width": 2.2},
            "legendgroup": escaped(line.label),
            "hovertemplate": "%{y:.2f}" if self.hover == "x" else "%{x:.2f}",
        }

    def _top(self) -> float:
        values = [part[np.isfinite(part)] for line in self.lines for part in (line.y, line.high) if part is not None]
        return max((float(part.max()) for part in values if len(part)), default=1.0) or 1.0


def _band(line: Line, low: np.ndarray, high: np.ndarray) -> dict[str, Any]:
    known = np.isfinite(low) & np.isfinite(high)
    return {
        "type": "scatter",
        "name": escaped(line.label),
        "x": rounded(np.concatenate((line.x[known], line.x[known][::-1]))),
        "y": rounded(np.concatenate((high[known], low[known][::-1]))),
        "fill": "toself",
        "fillcolor": translucent(line.colour, 0.15),
        "line": {"width": 0},
        "mode": "lines",
        "hoverinfo": "skip",
        "legendgroup": escaped(line.label),
        "showlegend": False,
    }
