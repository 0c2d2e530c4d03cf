"""Box plots of errors, and the colours of models in figures."""

import re
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from offpiste.dynamics import MODELS
from offpiste.report.chart import MEAN, MEDIAN, Box, Chart, Panel, box_statistics, draw_boxes
from offpiste.report.figure import plain
from offpiste.report.text_table import number

RECORDED = "#000000"
"""Colour of recorded paths."""

_SPARE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#7b3fa0", "#56b4e9")
"""Okabe and Ito's palette (jfly.uni-koeln.de/color, 2008), which colour-blind people can distinguish, and one more."""
_LINES = ("-", "--", ":", "-.")

QUANTITY = "Distance error after 5 s [m]"


def colour_of(label: str) -> str:
    """Return the colour of a model by a label such as "b (flat)", "DF" or "blind · map"."""
    name = re.split(r" [(·]", label)[0].lower()
    declared = next((model.colour for key, model in MODELS.items() if name in (key, model.display_name)), "")
    return declared or _SPARE[sum(name.encode()) % len(_SPARE)]


def styles(labels: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Return colour and line style by label: colours distinguish models, line styles their variants."""
    result: dict[str, tuple[str, str]] = {}
    for label in labels:
        colour = colour_of(label)
        used = sum(other == colour for other, _ in result.values())
        result[label] = (colour, _LINES[used % len(_LINES)])
    return result


def box_chart(errors: Mapping[str, Float[np.ndarray, " n"]], *, title: str = "") -> Chart:
    """Describe horizontal box plots of distance errors, one for each model.

    Boxes extend over the quartiles, whiskers to the last value within 1.5 IQR. Failed predictions are counted beside
    the name and in the quartiles; a model with failed predictions has no mean.

    Args:
        errors: by label, from top to bottom; infinite if a prediction failed.
    """
    boxes, ends = [], [1e-6]
    for label, values in errors.items():
        numbers, failed = box_statistics(values), int((~np.isfinite(values)).sum())
        about = f"median {number(numbers['med'])}, mean {number(numbers['mean'])}" + (
            f", {failed} failed" if failed else ""
        )
        boxes.append(Box(f"{label}\n{about}", colour_of(label), numbers))
        ends += [end for end in (numbers["whishi"], numbers["mean"]) if np.isfinite(end)]
    x_range, y_range = (0.0, 1.02 * max(ends)), (len(boxes) - 0.4, -0.6)
    return Chart([Panel(QUANTITY, boxes=boxes, hover="y", x_range=x_range, y_range=y_range)], title)


Groups = Mapping[str, Mapping[str, Float[np.ndarray, " _"]]]
"""Errors by position on the axis and by model; infinite if a prediction failed."""


def whisker_top(groups: Groups) -> float:
    """Return the highest end of a whisker, for figures that share their axis."""
    tops = [box_statistics(values)["whishi"] for models in groups.values() for values in models.values()]
    return max((top for top in tops if np.isfinite(top)), default=0.0) or 1.0


def grouped_box_plot(groups: Groups, *, title: str = "", axis: str = "", top: float | None = None) -> Figure:
    """Draw vertical box plots of several models side by side, as in the paper (Fig. 3 and 4).

    Boxes extend over the quartiles, whiskers to the last value within 1.5 IQR, which is written at its end. Green:
    median; orange: mean.

    Args:
        axis: name of the axis.
        top: upper end of the axis, for figures that share it (`whisker_top`).
    """
    top = top or whisker_top(groups)
    wide = sum(len(models) for models in groups.values())
    width = 1.6 + (0.62 if wide < 8 else 0.46) * wide + 0.3 * len(groups)
    figure = Figure(figsize=(width, 4.4), dpi=150, layout="constrained")
    axes = plain(figure.add_subplot(), title, grid="y")
    place, ticks = 0.0, []
    for models in groups.values():
        boxes = [Box(name, colour_of(name), box_statistics(values)) for name, values in models.items()]
        places = place + np.arange(len(boxes))
        draw_boxes(axes, boxes, places, orientation="vertical")
        for at, box in zip(places, boxes, strict=True):
            low, high = box.numbers["whislo"], box.numbers["whishi"]
            if np.isnan(high):
                axes.text(at, 0.5 * top, "failed", rotation=90, ha="center", fontsize=8)
            else:
                axes.text(at, low - 0.02 * top, f"{low:.2f}", ha="center", va="top", fontsize=6.5)
                axes.text(at, high + 0.02 * top, f"{high:.2f}", ha="center", va="bottom", fontsize=6.5)
        ticks.append(float(places.mean()))
        place = float(places[-1]) + 1.7
    axes.set(xlim=(-0.6, place - 0.8), ylim=(-0.1 * top, 1.12 * top), ylabel=QUANTITY, xlabel=axis)
    axes.set_xticks(ticks, list(groups))
    names = dict.fromkeys(name for models in groups.values() for name in models)
    handles: list[Artist] = [Patch(facecolor=colour_of(name), alpha=0.4, label=name) for name in names]
    handles += axes.plot([], [], color=MEDIAN, linewidth=1.5, label="median")
    handles += axes.plot([], [], color=MEAN, linewidth=3.2, label="mean")
    columns = max(3, int(width / 1.2))
    figure.legend(handles=handles, frameon=False, fontsize=8, ncols=columns, loc="outside lower right")
    return figure
