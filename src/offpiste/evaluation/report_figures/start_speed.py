"""Error by the speed at the start, and the plot against any quantity of the windows."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from offpiste.evaluation.evaluate import Evaluation
from offpiste.evaluation.model_colours import legend_beside, styles
from offpiste.evaluation.report_figures import deciding_errors, report_figure, title_of
from offpiste.report.figure import single

BINS = 6
"""Number of bins, each with as many windows."""

CAPTION = "Mean distance error after 5 s by the speed at the start; every bin holds as many windows."


@report_figure("speed", section="Distribution", caption=CAPTION)
def draw(evaluation: Evaluation) -> Figure:
    """Error by the speed at the start, for each model with the terrain lookup that decides."""
    speed = evaluation.windows.start_speed
    return binned_plot(deciding_errors(evaluation), speed, axis="Speed at the start [m/s]", title=title_of(evaluation))


def binned_plot(
    errors: Mapping[str, Float[np.ndarray, " n"]], values: Float[np.ndarray, " n"], *, axis: str, title: str = ""
) -> Figure:
    """Mean distance error after 5 s against a quantity of the windows, in bins of as many windows each.

    Args:
        errors: by label; infinite where a prediction failed.
        values: the quantity in each window.
        axis: its name and unit.
    """
    figure, axes = single(7.6, 4.2, title)
    edges = np.unique(np.quantile(values, np.linspace(0, 1, BINS + 1)))
    which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, max(len(edges) - 2, 0))
    bins = np.unique(which)
    centres = [float(np.median(values[which == k])) for k in bins]
    for (label, error), (colour, line) in zip(errors.items(), styles(list(errors)).values(), strict=True):
        means = [float(error[which == k].mean()) for k in bins]
        axes.plot(centres, means, line, color=colour, marker="o", markersize=4, label=label)
    axes.set(xlabel=axis, ylabel="Mean distance error after 5 s [m]")
    axes.set_ylim(bottom=0)
    legend_beside(axes)
    return figure
