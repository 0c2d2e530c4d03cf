"""Registry of the figures in an evaluation's report (docs/extending.md)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.registry import Registry
from offpiste.evaluation.evaluate import Evaluation
from offpiste.evaluation.metrics import Case
from offpiste.report.chart import Chart

Draw = Callable[[Evaluation], Chart | Figure | None]
"""Function from an evaluation to a chart, or to a static Matplotlib figure; None if there is nothing to draw."""


@dataclass(frozen=True)
class ReportFigure:
    """Figure of the report.

    Attributes:
        section: heading of its section; an unknown heading adds a section at the end of the report.
        caption: text below the figure.
    """

    section: str
    caption: str
    draw: Draw


REPORT_FIGURES: Final[Registry[ReportFigure]] = Registry("figure of the report", package=__name__)


def report_figure(name: str, *, section: str, caption: str) -> Callable[[Draw], Draw]:
    """Register a function as a figure of the report.

    Args:
        name: of the PNG file beside the report, without the ending.
        section, caption: see `ReportFigure`.
    """

    def add(draw: Draw) -> Draw:
        REPORT_FIGURES.register(name)(ReportFigure(section, caption, draw))
        return draw

    return add


def main_start(evaluation: Evaluation) -> str:
    """Return the start of predictions that figures show: the first one."""
    return evaluation.metrics.results[0].start


def title_of(evaluation: Evaluation) -> str:
    """Return the title of a figure: part of the split and start of predictions."""
    return f"{evaluation.metrics.part} part, {main_start(evaluation)} start"


def distance_errors(evaluation: Evaluation) -> dict[str, Float[np.ndarray, " n"]]:
    """Return distance errors after 5 s by model and terrain lookup, sorted by the models' medians."""
    return {case.reading_label: evaluation.errors[case].distance() for case in _ordered_cases(evaluation)}


def deciding_errors(evaluation: Evaluation) -> dict[str, Float[np.ndarray, " n"]]:
    """Return distance errors after 5 s by model, with the deciding terrain lookup."""
    return {case.reading_label: evaluation.errors[case].distance() for case in deciding_cases(evaluation)}


def deciding_cases(evaluation: Evaluation) -> list[Case]:
    """Return the cases of the first start with the deciding terrain lookup: the map if there is one."""
    cases = _ordered_cases(evaluation)
    mapped = {case.label for case in cases if case.lookup == "map"}
    return [case for case in cases if case.lookup != "recorded" or case.label not in mapped]


def _ordered_cases(evaluation: Evaluation) -> list[Case]:
    """Return the cases of the first start, models with the largest median error first, sorted by lookup for each."""
    cases = [case for case in evaluation.errors if case.start == main_start(evaluation)]
    median = {case: float(np.median(evaluation.errors[case].distance())) for case in cases}
    readings, sets = (None, "recorded", "map"), (None, *FEATURE_SETS)

    def place(case: Case) -> tuple[float, str, int, int]:
        largest = max(value for other, value in median.items() if other.label == case.label)
        return -largest, case.label, readings.index(case.lookup), sets.index(case.feature_set)

    return sorted(cases, key=place)
