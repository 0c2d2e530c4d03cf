"""The folder of a report: metrics.json, report.html and the pictures."""

import io
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from offpiste.conventions import FEATURE_SETS
from offpiste.evaluation.evaluate import Evaluation
from offpiste.evaluation.figures import box_plot, distribution_plot, growth_plot, speed_plot
from offpiste.evaluation.page import render_html
from offpiste.evaluation.results import pooled_rows, write_metrics
from offpiste.evaluation.tables import Case, by_reading
from offpiste.evaluation.worst_windows import worst_plot
from offpiste.files import write_text, write_whole


def write_report(evaluation: Evaluation, folder: Path) -> None:
    """Write report.html, its pictures as PNG, and metrics.json, each whole or not at all."""
    pictures = {name: png(figure) for name, figure in draw_figures(evaluation).items()}
    for name, content in pictures.items():
        _write_bytes(folder / f"{name}.png", content)
    write_text(folder / "report.html", render_html(evaluation.metrics, pictures))
    write_metrics(folder / "metrics.json", evaluation.metrics)


def draw_figures(evaluation: Evaluation) -> dict[str, Figure]:
    """The report's pictures by name, all from the first start; models in the order of their median errors."""
    rows = pooled_rows(evaluation.metrics.results)
    start = rows[0].start
    groups = {group[0].reading: group for group in by_reading(rows) if group[0].start == start}
    cases = _ordered({case: errors.distance() for case, errors in evaluation.errors.items() if case.start == start})
    distance = {case.reading: errors for case, errors in cases.items()}
    # Curves would lie on each other: where a model reads the ground in two ways, the one that decides is drawn.
    mapped = {c.label for c in cases if c.lookup == "map"}
    decides = [c.reading for c in cases if c.lookup != "recorded" or c.label not in mapped]
    deciding = {label: distance[label] for label in decides}
    title = f"{evaluation.metrics.part} part, {start} start"
    return {
        "box": box_plot(distance, title=title),
        "growth": growth_plot({label: groups[label] for label in decides}, title=title),
        "distribution": distribution_plot(deciding, title=title),
        "speed": speed_plot(deciding, evaluation.speed, title=title),
        "worst": worst_plot(evaluation.worst, title=f"Worst windows of {evaluation.shown}, {title}"),
    }


def _ordered(errors: dict[Case, np.ndarray]) -> dict[Case, np.ndarray]:
    """Models by the median of their errors, the worst first; ways of reading the ground side by side."""
    median = dict.fromkeys((case.label for case in errors), 0.0)
    for case, values in errors.items():
        median[case.label] = max(median[case.label], float(np.median(values)))
    readings, sets = (None, "recorded", "map"), (None, *FEATURE_SETS)

    def place(case: Case) -> tuple[float, str, int, int]:
        return -median[case.label], case.label, readings.index(case.lookup), sets.index(case.feature_set)

    order = sorted(errors, key=place)
    return {case: errors[case] for case in order}


def png(figure: Figure) -> bytes:
    """A figure as the bytes of a PNG file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", facecolor="white")
    return stream.getvalue()


def _write_bytes(path: Path, content: bytes) -> None:
    def write(partial: Path) -> None:
        partial.write_bytes(content)

    write_whole(path, write)
