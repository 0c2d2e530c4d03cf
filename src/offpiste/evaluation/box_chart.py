"""Box plot of errors with a line for each model, as high as there are models, as a picture and for a browser."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from offpiste.evaluation.box_plots import MEAN, MEDIAN, box_statistics, colour_of
from offpiste.report.chart import INK, Chart, escaped, layout, translucent
from offpiste.report.figure import plain

LINE_INCHES, LINE_PIXELS = 0.42, 46
"""Height of a box and the space around it."""


@dataclass(frozen=True)
class BoxChart:
    """Box plot of errors by model.

    Boxes reach from the lower to the upper quartile, whiskers to the last value within 1.5 IQR of them. Green: median;
    orange: mean; both are given as numbers. Failed predictions are counted beside the name; they are in the quartiles,
    and a model that has any has no mean.

    Attributes:
        errors: by label, from top to bottom; infinite where a prediction failed.
    """

    errors: Mapping[str, Float[np.ndarray, " n"]]
    quantity: str = "Distance error after 5 s [m]"
    title: str = ""

    @property
    def _boxes(self) -> list[dict[str, Any]]:
        return [box_statistics(label, values) for label, values in self.errors.items()]

    def figure(self) -> Figure:
        """The boxes as a picture, whose height grows with their number."""
        boxes = self._boxes
        figure = Figure(figsize=(8.4, 1.1 + LINE_INCHES * len(boxes)), dpi=150, layout="constrained")
        axes = plain(figure.add_subplot(), self.title, grid="x")
        drawn = axes.bxp(
            boxes,
            orientation="horizontal",
            showfliers=False,
            showmeans=True,
            meanline=True,
            patch_artist=True,
            widths=0.55,
            # The median lies on the mean, thinner, so that both are seen where they are equal.
            medianprops={"color": MEDIAN, "linewidth": 1.6, "zorder": 4},
            meanprops={"color": MEAN, "linewidth": 3.6, "linestyle": "-", "zorder": 3},
        )
        for patch, label in zip(drawn["boxes"], self.errors, strict=True):
            patch.set(facecolor=colour_of(label), alpha=0.4, edgecolor="none")
        _write_numbers(axes, boxes)
        axes.set(xlim=(0, 1.02 * self._top(boxes)), ylim=(len(boxes) + 0.6, 0.4), xlabel=self.quantity)
        axes.spines["left"].set_visible(False)
        axes.tick_params(left=False, labelsize=9)
        return figure

    def charts(self) -> Sequence[Chart]:
        """The boxes as one chart, whose height grows with their number."""
        boxes = self._boxes
        names = [escaped(box["label"]).replace("\n", "<br>") for box in boxes]
        traces: list[dict[str, Any]] = []
        for name, label, box in zip(names, self.errors, boxes, strict=True):
            if np.isfinite(box["whishi"]):
                traces.append(_box(name, colour_of(label), box))
        drawn = [(name, box) for name, box in zip(names, boxes, strict=True) if np.isfinite(box["whishi"])]
        traces.append(_means([name for name, _ in drawn], [box for _, box in drawn]))
        x = {"title": {"text": self.quantity}, "range": (0, 1.02 * self._top(boxes))}
        y: dict[str, Any] = {"categoryorder": "array", "categoryarray": names[::-1], "range": (-0.6, len(names) - 0.4)}
        y |= {"showgrid": False}
        means = [_number("mean", {"yref": "paper", "y": 1, "yanchor": "bottom"})]
        means += [
            _number(f"{box['mean']:.2f}" if np.isfinite(box["mean"]) else "–", {"y": name})
            for name, box in zip(names, boxes, strict=True)
        ]
        margin = {"l": 48, "r": 46, "t": 48, "b": 44}  # the numbers' name stands below the toolbar
        look = layout(x=x, y=y, margin=margin, hovermode="y", showlegend=False, boxgap=0.45, annotations=means)
        return (Chart(106 + LINE_PIXELS * len(boxes), traces, look),)

    def _top(self, boxes: Sequence[Mapping[str, Any]]) -> float:
        ends = [float(box[name]) for box in boxes for name in ("whishi", "mean") if np.isfinite(box[name])]
        return max(ends, default=1.0) or 1.0


def _write_numbers(axes: Axes, boxes: Sequence[Mapping[str, Any]]) -> None:
    """Medians and means in two columns to the right of the boxes."""
    for column, (name, key, colour) in enumerate((("median", "med", MEDIAN), ("mean", "mean", MEAN))):
        style: dict[str, Any] = {"color": colour, "fontsize": 9, "ha": "right"}
        right = 1.07 + 0.09 * column
        axes.text(right, 1.01, name, transform=axes.transAxes, va="bottom", **style)
        for place, box in enumerate(boxes, start=1):
            text = f"{box[key]:.2f}" if np.isfinite(box[key]) else "–"
            axes.text(right, place, text, transform=axes.get_yaxis_transform(), va="center", **style)


def _number(text: str, place: Mapping[str, Any]) -> dict[str, Any]:
    """A number to the right of the boxes."""
    font = {"color": MEAN}
    return {"text": text, "xref": "paper", "x": 1.01, "xanchor": "left", "showarrow": False, "font": font, **place}


def _box(name: str, colour: str, box: Mapping[str, Any]) -> dict[str, Any]:
    ends = {"q1": "q1", "median": "med", "q3": "q3", "lowerfence": "whislo", "upperfence": "whishi"}
    return {
        "type": "box",
        "orientation": "h",
        "y": [name],
        **{plotly: [round(float(box[own]), 3)] for plotly, own in ends.items()},
        "fillcolor": translucent(colour, 0.45),
        "line": {"color": INK, "width": 1.3},
        "hoverinfo": "skip",
    }


def _means(names: Sequence[str], boxes: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Markers at the means, or at the median where there is none, that show all numbers of their box."""
    shown = ("med", "mean", "q1", "q3", "whislo", "whishi")
    numbers = [[f"{box[key]:.2f}" if np.isfinite(box[key]) else "–" for key in shown] for box in boxes]
    return {
        "type": "scatter",
        "mode": "markers",
        "x": [round(float(box["mean"] if np.isfinite(box["mean"]) else box["med"]), 3) for box in boxes],
        "y": list(names),
        "marker": {"color": MEAN, "symbol": "diamond", "size": 9},
        "customdata": numbers,
        "hovertemplate": "median %{customdata[0]}, mean %{customdata[1]} m<br>quartiles %{customdata[2]} and "
        "%{customdata[3]} m<br>whiskers %{customdata[4]} and %{customdata[5]} m<extra></extra>",
    }
