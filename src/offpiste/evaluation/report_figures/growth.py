"""Growth of the error with the horizon."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from offpiste.evaluation.evaluate import Evaluation
from offpiste.evaluation.metrics import ResultRow, pooled_rows
from offpiste.evaluation.model_colours import legend_beside, styles
from offpiste.evaluation.report_figures import deciding_errors, main_start, report_figure, title_of
from offpiste.evaluation.result_rows import by_reading
from offpiste.report.figure import single

CAPTION = "Mean distance error against the horizon; bands: 95 % intervals of the mean."


@report_figure("growth", section="Growth of the error", caption=CAPTION)
def draw(evaluation: Evaluation) -> Figure:
    """Mean distance error by horizon, for each model with the terrain lookup that decides."""
    groups = by_reading(pooled_rows(evaluation.metrics.results))
    by_label = {group[0].reading_label: group for group in groups if group[0].start == main_start(evaluation)}
    return growth_plot({label: by_label[label] for label in deciding_errors(evaluation)}, title=title_of(evaluation))


def growth_plot(rows: Mapping[str, Sequence[ResultRow]], *, title: str = "") -> Figure:
    """Mean distance error against the horizon, with the 95 % interval as a band.

    Args:
        rows: by label, in ascending order of horizons.
    """
    figure, axes = single(7.6, 4.2, title)
    ends = {}
    for label, (colour, line) in styles(list(rows)).items():
        seconds = [row.horizon_s for row in rows[label]]
        mean = np.array([row.distance_error_m.mean for row in rows[label]])
        low, high = np.array([row.distance_error_m.ci95 for row in rows[label]]).T
        axes.plot(seconds, mean, line, color=colour, marker="o", markersize=4, label=label)
        axes.fill_between(seconds, low, high, color=colour, alpha=0.13, linewidth=0)
        if np.isfinite(mean).any():
            ends[label] = float(mean[np.isfinite(mean)][-1])
    axes.set(xlabel="Horizon [s]", ylabel="Mean distance error [m]", xlim=(0.8, 5.2), xticks=[1, 2, 3, 4, 5])
    axes.set_ylim(bottom=0)
    legend_beside(axes, ends)
    return figure
