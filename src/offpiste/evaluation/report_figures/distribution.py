"""Distribution of the distance errors."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from offpiste.evaluation.evaluate import Evaluation
from offpiste.evaluation.model_colours import legend_beside, styles
from offpiste.evaluation.report_figures import deciding_errors, report_figure, title_of
from offpiste.report.figure import single

CAPTION = "Share of windows whose distance error after 5 s stays below a value."


@report_figure("distribution", section="Distribution", caption=CAPTION)
def draw(evaluation: Evaluation) -> Figure:
    """Distribution of each model's errors, with the terrain lookup that decides."""
    return distribution_plot(deciding_errors(evaluation), title=title_of(evaluation))


def distribution_plot(errors: Mapping[str, Float[np.ndarray, " n"]], *, title: str = "") -> Figure:
    """Share of windows whose distance error after 5 s stays below a value."""
    figure, axes = single(7.6, 4.2, title)
    shown = [values[np.isfinite(values)] for values in errors.values()]
    limit = max((float(np.quantile(values, 0.98)) for values in shown if len(values)), default=1.0)
    for (label, values), (colour, line) in zip(errors.items(), styles(list(errors)).values(), strict=True):
        ordered = np.sort(values)
        # Failed windows are in the count, so that a curve of a model that fails never reaches the top.
        share = np.arange(1, len(ordered) + 1) / len(ordered)
        axes.plot(ordered, 100 * share, line, color=colour, label=label)
    axes.set(xlabel="Distance error after 5 s [m]", ylabel="Windows below [%]", xlim=(0, limit), ylim=(0, 101))
    legend_beside(axes)
    return figure
