"""Figures of the distance error: box plot, distribution, growth with the horizon, dependence on initial speed."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from offpiste.evaluation.box_plots import QUANTITY, box_chart, styles
from offpiste.evaluation.evaluate import Evaluation
from offpiste.evaluation.metrics import ResultRow, by_reading, pooled_rows
from offpiste.evaluation.report_figures import deciding_errors, distance_errors, main_start, report_figure, title_of
from offpiste.report.chart import Chart, Line, Panel, by_end

BINS = 6
"""Number of bins with equal numbers of windows."""


@report_figure(
    "box",
    section="Mean distance error by horizon",
    caption="Distance error after 5 s. Boxes: quartiles; whiskers: last value within 1.5 IQR; line in the box: median; "
    "orange: mean. Values beyond the whiskers are not drawn.",
)
def draw_box_plot(evaluation: Evaluation) -> Chart:
    """Draw distance errors after 5 s by model and terrain lookup."""
    return box_chart(distance_errors(evaluation), title=title_of(evaluation))


@report_figure(
    "distribution",
    section="Distribution",
    caption="Share of windows with a distance error after 5 s below a value.",
)
def draw_distribution(evaluation: Evaluation) -> Chart:
    """Draw the distribution of each model's errors, with the deciding terrain lookup."""
    return distribution_plot(deciding_errors(evaluation), title=title_of(evaluation))


def distribution_plot(errors: Mapping[str, Float[np.ndarray, " n"]], *, title: str = "") -> Chart:
    """Draw the share of windows with a distance error after 5 s below a value."""
    shown = [values[np.isfinite(values)] for values in errors.values()]
    limit = max((float(np.quantile(values, 0.98)) for values in shown if len(values)), default=1.0)
    lines = []
    for label, style in styles(list(errors)).items():
        # Failed windows count, so that the curve of a model that fails never reaches 100 %.
        values = np.sort(errors[label])
        lines.append(Line(label, values, 100 * np.arange(1, len(values) + 1) / len(values), *style))
    sides = (0.0, limit), (0.0, 101.0)
    panel = Panel(QUANTITY, "Windows below [%]", lines, x_range=sides[0], y_range=sides[1], hover="y unified")
    return Chart([panel], title)


@report_figure(
    "growth",
    section="Growth of the error",
    caption="Mean distance error against the horizon; bands: 95 % intervals of the mean.",
)
def draw_growth(evaluation: Evaluation) -> Chart:
    """Draw the mean distance error by horizon, for each model with the deciding terrain lookup."""
    groups = by_reading(pooled_rows(evaluation.metrics.results))
    by_label = {group[0].reading_label: group for group in groups if group[0].start == main_start(evaluation)}
    return growth_plot({label: by_label[label] for label in deciding_errors(evaluation)}, title=title_of(evaluation))


def growth_plot(rows: Mapping[str, Sequence[ResultRow]], *, title: str = "") -> Chart:
    """Draw the mean distance error against the horizon, with the 95 % interval as a band.

    Args:
        rows: by label, in ascending order of horizons.
    """
    lines = []
    for label, style in styles(list(rows)).items():
        points = [(row.horizon_s, row.distance_error_m.mean, *row.distance_error_m.ci95) for row in rows[label]]
        seconds, mean, low, high = np.array(points).T
        lines.append(Line(label, seconds, mean, *style, marker="o", low=low, high=high))
    return Chart([Panel("Horizon [s]", "Mean distance error [m]", by_end(lines), x_range=(0.8, 5.2))], title)


@report_figure(
    "speed",
    section="Distribution",
    caption="Mean distance error after 5 s by initial speed; all bins hold equal numbers of windows.",
)
def draw_start_speed(evaluation: Evaluation) -> Chart:
    """Draw the error by initial speed, for each model with the deciding terrain lookup."""
    speed = evaluation.windows.start_speed
    return binned_plot(deciding_errors(evaluation), speed, axis="Initial speed [m/s]", title=title_of(evaluation))


def binned_plot(
    errors: Mapping[str, Float[np.ndarray, " n"]], values: Float[np.ndarray, " n"], *, axis: str, title: str = ""
) -> Chart:
    """Draw the mean distance error after 5 s against a quantity of the windows, in bins of equal numbers of windows.

    Args:
        errors: by label; infinite if a prediction failed.
        values: the quantity in each window.
        axis: its name and unit.
    """
    edges = np.unique(np.quantile(values, np.linspace(0, 1, BINS + 1)))
    which = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, max(len(edges) - 2, 0))
    bins = [which == k for k in np.unique(which)]
    centres = np.array([float(np.median(values[mine])) for mine in bins])
    lines = []
    for label, style in styles(list(errors)).items():
        means = np.array([float(errors[label][mine].mean()) for mine in bins])
        lines.append(Line(label, centres, means, *style, marker="o"))
    return Chart([Panel(axis, "Mean distance error after 5 s [m]", by_end(lines))], title)
