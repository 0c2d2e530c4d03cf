"""The folder of a report: metrics.json, report.html and the pictures."""

import io
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from offpiste.evaluation.drawings import worst_plot
from offpiste.evaluation.evaluate import Evaluation
from offpiste.evaluation.figures import box_plot, distribution_plot, growth_plot, speed_plot
from offpiste.evaluation.page import render_html
from offpiste.evaluation.results import pooled_rows, way, write_metrics
from offpiste.evaluation.table import by_way
from offpiste.evaluation.tabulate import Case
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
    groups = {way(group[0].label, group[0].lookup): group for group in by_way(rows) if group[0].start == start}
    cases = _ordered({case: errors.distance() for case, errors in evaluation.errors.items() if case.start == start})
    distance = {way(case.label, case.lookup): errors for case, errors in cases.items()}
    # Curves would lie on each other: where a model reads the ground in two ways, the one that decides is drawn.
    decides = [way(c.label, c.lookup) for c in cases if c.lookup != "recorded" or c._replace(lookup="map") not in cases]
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
    ways = (None, "recorded", "map")
    order = sorted(errors, key=lambda case: (-median[case.label], case.label, ways.index(case.lookup)))
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
