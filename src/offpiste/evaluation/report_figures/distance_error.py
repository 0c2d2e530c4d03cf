"""Figures of the distance error: box plot, distribution, growth with the horizon, by speed at the start."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from offpiste.evaluation.box_plots import box_plot, legend_beside, styles
from offpiste.evaluation.evaluate import Evaluation
from offpiste.evaluation.metrics import ResultRow, pooled_rows
from offpiste.evaluation.report_figures import deciding_errors, distance_errors, main_start, report_figure, title_of
from offpiste.evaluation.result_rows import by_reading
from offpiste.report.figure import single

CAPTION_BOX_PLOT = (
    "Distance error after 5 s. Boxes: quartiles; whiskers: last value within 1.5 IQR, given by the values with "
    "arrows; green: median; orange: mean. Values beyond the whiskers are not drawn."
)


@report_figure("box", section="Mean distance error by horizon", caption=CAPTION_BOX_PLOT)
def draw_box_plot(evaluation: Evaluation) -> Figure:
    """Distance errors after 5 s by model and terrain lookup."""
    return box_plot(distance_errors(evaluation), title=title_of(evaluation))


CAPTION_DISTRIBUTION = "Share of windows whose distance error after 5 s stays below a value."


@report_figure("distribution", section="Distribution", caption=CAPTION_DISTRIBUTION)
def draw_distribution(evaluation: Evaluation) -> Figure:
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


CAPTION_GROWTH = "Mean distance error against the horizon; bands: 95 % intervals of the mean."


@report_figure("growth", section="Growth of the error", caption=CAPTION_GROWTH)
def draw_growth(evaluation: Evaluation) -> Figure:
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


BINS = 6
"""Number of bins, each with as many windows."""

CAPTION_START_SPEED = "Mean distance error after 5 s by the speed at the start; every bin holds as many windows."


@report_figure("speed", section="Distribution", caption=CAPTION_START_SPEED)
def draw_start_speed(evaluation: Evaluation) -> Figure:
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
