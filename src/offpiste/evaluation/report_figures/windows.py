"""Windows where a model is as wrong as usual, and where it is most wrong, and what was predicted there."""

from offpiste.evaluation.evaluate import Evaluation
from offpiste.evaluation.metrics import Case
from offpiste.evaluation.report_figures import deciding_cases, report_figure, title_of
from offpiste.evaluation.window_chart import window_chart
from offpiste.evaluation.window_paths import WindowPaths, predict_paths, typical_windows, worst_windows
from offpiste.report.chart import Chart

QUARTILES = {0.25: "lower quartile", 0.5: "median", 0.75: "upper quartile"}

EACH = 2
"""Windows at each quartile."""

WORST = 10
"""Number of worst windows."""

PANELS = (
    "Each panel starts at the triangle and looks up; dots are the places after 5 s. A model with several runs has a "
    "line for each. Colours of the ground: the first three features of the vehicle's own map, as it was at the start "
    "where the dataset keeps that; grey: ground that no camera had seen. Without visual features: a broad line "
    "wherever the drive went at any time."
)


@report_figure(
    "typical",
    section="Typical windows",
    caption=f"Windows at the quartiles of the error, as far as there are some that do not overlap. {PANELS}",
)
def draw_typical(evaluation: Evaluation) -> Chart | None:
    """Paths in windows at the quartiles of the error of the model that was named first."""
    return _chart(predict_typical(evaluation), f"Windows at the quartiles of {_shown(evaluation)}")


@report_figure(
    "worst",
    section="Worst windows",
    caption=f"The windows of largest distance error after 5 s, no two of which overlap, of the worst quarter. {PANELS}",
)
def draw_worst(evaluation: Evaluation) -> Chart | None:
    """Paths in the worst windows of the model that was named first."""
    return _chart(predict_worst(evaluation), f"Worst windows of {_shown(evaluation)}")


def predict_typical(evaluation: Evaluation) -> tuple[WindowPaths, ...]:
    """Paths in the windows at the quartiles."""
    chosen, shares = typical_windows(evaluation.errors[evaluation.shown], tuple(QUARTILES), each=EACH)
    return predict_paths(evaluation, chosen, _cases(evaluation), [QUARTILES[share] for share in shares])


def predict_worst(evaluation: Evaluation) -> tuple[WindowPaths, ...]:
    """Paths in the worst windows."""
    chosen = worst_windows(evaluation.errors[evaluation.shown], count=WORST)
    return predict_paths(evaluation, chosen, _cases(evaluation))


def _cases(evaluation: Evaluation) -> list[Case]:
    """A case of each model, in the way of reading the terrain that decides; the model that was named first comes last,
    on top of the others.
    """
    shown = evaluation.shown
    first = {case.label: case for case in reversed(deciding_cases(evaluation))}
    others = [case for case in reversed(first.values()) if case.label != shown.label]
    return [*others, shown]


def _chart(windows: tuple[WindowPaths, ...], title: str) -> Chart | None:
    return window_chart(windows, title) if windows else None


def _shown(evaluation: Evaluation) -> str:
    return f"{evaluation.shown.reading_label}, {title_of(evaluation)}"
