"""Box plots in the paper's form, several models side by side at each place of an axis (Fig. 3 and 4)."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from offpiste.evaluation.figures import MEAN, MEDIAN, box_statistics, colour_of, plain_axes

Groups = Mapping[str, Mapping[str, Float[np.ndarray, " _"]]]
"""Errors by place on the axis and by model; infinite where a prediction failed."""


def whisker_top(groups: Groups) -> float:
    """The highest end of a whisker: figures that share it have the same axis."""
    tops = [box_statistics("", values)["whishi"] for models in groups.values() for values in models.values()]
    return max((float(top) for top in tops if np.isfinite(top)), default=0.0) or 1.0


def grouped_boxes(
    groups: Groups,
    *,
    title: str = "",
    axis: str = "",
    quantity: str = "Distance error after 5 s [m]",
    top: float | None = None,
) -> Figure:
    """Boxes reach from quartile to quartile, whiskers to the last value within 1.5 IQR of them.

    The whiskers' ends are given by the values with arrows. Green: median; orange: mean.

    Args:
        axis: what the places are.
        top: upper end of the axis, where figures are to share it (`whisker_top`).
    """
    top = top or whisker_top(groups)
    names = list(dict.fromkeys(name for models in groups.values() for name in models))
    wide = sum(len(models) for models in groups.values())
    figure, axes = plain_axes(1.6 + (0.62 if wide < 8 else 0.46) * wide + 0.3 * len(groups), 4.4, title)
    place, ticks = 0.0, []
    for models in groups.values():
        places = place + np.arange(len(models))
        _draw(axes, models, places, top)
        ticks.append(float(places.mean()))
        place = float(places[-1]) + 1.7
    axes.set(xlim=(-0.6, place - 0.8), ylim=(-0.1 * top, 1.12 * top), ylabel=quantity, xlabel=axis)
    axes.set_xticks(ticks, list(groups))
    _legend(figure, axes, names)
    return figure


def _draw(axes: Axes, models: Mapping[str, np.ndarray], places: Sequence[float] | np.ndarray, top: float) -> None:
    boxes = [{**box_statistics(name, values), "label": ""} for name, values in models.items()]
    drawn = axes.bxp(
        boxes,
        positions=list(places),
        widths=0.62,
        showfliers=False,
        showmeans=True,
        meanline=True,
        patch_artist=True,
        manage_ticks=False,
        medianprops={"color": MEDIAN, "linewidth": 1.5, "zorder": 4},
        meanprops={"color": MEAN, "linewidth": 3.2, "linestyle": "-", "zorder": 3},
    )
    for patch, name in zip(drawn["boxes"], models, strict=True):
        patch.set(facecolor=colour_of(name), alpha=0.4, edgecolor="none")
    for at, box in zip(places, boxes, strict=True):
        if np.isnan(box["whishi"]):
            axes.annotate("failed", (float(at), 0.5 * top), rotation=90, ha="center", fontsize=8)
            continue
        low, high = float(box["whislo"]), float(box["whishi"])
        for end, height in ((low, low - 0.065 * top), (high, high + 0.065 * top)):
            axes.annotate(
                f"{end:.2f}",
                xy=(float(at), end),
                xytext=(float(at), height),
                ha="center",
                va="center",
                fontsize=6.5,
                arrowprops={"arrowstyle": "-|>", "linewidth": 0.5, "color": "black", "mutation_scale": 6, "shrinkB": 0},
            )


def _legend(figure: Figure, axes: Axes, names: Sequence[str]) -> None:
    handles: list[Artist] = [Patch(facecolor=colour_of(name), alpha=0.4, label=name) for name in names]
    handles += axes.plot([], [], color=MEDIAN, linewidth=1.5, label="median")
    handles += axes.plot([], [], color=MEAN, linewidth=3.2, label="mean")
    figure.legend(handles=handles, frameon=False, fontsize=8, ncols=len(handles), loc="outside lower right")
