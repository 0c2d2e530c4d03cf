"""Colours and lines of models in figures: a model has the same colour in all of them."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from offpiste.dynamics import MODELS

RECORDED = "#000000"
"""Colour of what was driven."""

_SPARE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#7b3fa0", "#56b4e9")
"""Okabe and Ito's palette (jfly.uni-koeln.de/color, 2008), which colour-blind people can tell apart, and one more."""
_LINES = ("-", "--", ":", "-.")


def colour_of(label: str) -> str:
    """The colour of a model, whatever its variant."""
    name = label.split(" ")[0]
    declared = MODELS[name].colour if name in MODELS else ""
    return declared or _SPARE[sum(name.encode()) % len(_SPARE)]


def styles(labels: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Colour and line style by label: the colour follows the model's name, the line tells its variants apart."""
    found: dict[str, tuple[str, str]] = {}
    for label in labels:
        colour = colour_of(label)
        used = sum(other == colour for other, _ in found.values())
        found[label] = (colour, _LINES[used % len(_LINES)])
    return found


def legend_beside(axes: Axes, ends: Mapping[str, float] | None = None) -> None:
    """Add a legend to the right, where it hides nothing; in the order of the curves' ends where they are given."""
    handles, labels = axes.get_legend_handles_labels()
    height = ends or {}
    order = sorted(range(len(labels)), key=lambda i: -height.get(labels[i], np.inf))
    axes.legend(
        [handles[i] for i in order],
        [labels[i] for i in order],
        frameon=False,
        fontsize=8,
        loc="upper left",
        bbox_to_anchor=(1.0, 1.0),
    )
