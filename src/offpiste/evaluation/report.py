"""Report of an evaluation: report.html, its figures, and metrics.json."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from offpiste.dynamics import MODELS
from offpiste.evaluation.errors import HORIZONS
from offpiste.evaluation.evaluate import Evaluation
from offpiste.evaluation.intervals import MIN_UNITS
from offpiste.evaluation.metrics import Metrics, pooled_rows, run_rows, single_rows, write_metrics
from offpiste.evaluation.report_figures import REPORT_FIGURES
from offpiste.evaluation.report_headlines import headline_texts, result_cards
from offpiste.evaluation.report_tables import (
    band_table,
    component_table,
    difference_table,
    distribution_table,
    horizon_table,
    run_table,
)
from offpiste.evaluation.result_rows import REFERENCE
from offpiste.report.chart import Drawing
from offpiste.report.figure import png
from offpiste.report.page import Page, Picture, Section, write_page
from offpiste.report.text_table import TextTable, number

Pictures = dict[str, list[Picture]]
"""Pictures by the heading of their section."""


def write_report(evaluation: Evaluation, folder: Path) -> None:
    """Write report.html, its figures as PNG files, and metrics.json, each whole or not at all."""
    write_page(report_page(evaluation.metrics, draw_figures(evaluation)), folder)
    write_metrics(folder / "metrics.json", evaluation.metrics)


def draw_figures(evaluation: Evaluation) -> Pictures:
    """All registered figures for which there is something to draw."""
    pictures: Pictures = {}
    for name, registered in REPORT_FIGURES.items():
        drawn = registered.draw(evaluation)
        if drawn is not None:
            picture = _picture(name, drawn, registered.caption)
            pictures.setdefault(registered.section, []).append(picture)
    return pictures


def _picture(name: str, drawn: Figure | Drawing, caption: str) -> Picture:
    if isinstance(drawn, Figure):
        return Picture(name, png(drawn), caption)
    return Picture(name, png(drawn.figure()), caption, drawn.charts())


def report_page(metrics: Metrics, pictures: Pictures) -> Page:
    """The report as a page."""
    models = ", ".join(dict.fromkeys(headline.model for headline in metrics.headlines)) or "baselines"
    notes = Section("How to read this", notes=_notes(metrics))
    return Page(
        f"{models} on {metrics.dataset.rstrip('/').rpartition('/')[2]}",
        headline_texts(metrics),
        _facts(metrics),
        [*_sections(metrics, pictures), notes],
        result_cards(metrics),
    )


def _sections(metrics: Metrics, pictures: Pictures) -> list[Section]:
    """Tables and figures; those of headings that only figures have come last."""
    rows, runs = pooled_rows(metrics.results), run_rows(metrics.results)
    several = len({row.band for row in metrics.bands}) > 1
    tables: dict[str, list[TextTable]] = {
        "Mean distance error by horizon": [horizon_table(rows)],
        "Growth of the error": [],
        "All components after 5 s": [component_table(rows)],
        "Paired differences after 5 s": [difference_table(rows)],
        "Each run after 5 s": [run_table(runs)] if runs else [],
        "Error by the speed at the start": [band_table(metrics.bands)] if several else [],
        "Distribution": [distribution_table(rows)],
        "Typical windows": [],
        "Worst windows": [],
    }
    sections = [Section(name, tables.get(name, []), pictures.get(name, [])) for name in {**tables, **pictures}]
    return [section for section in sections if section.tables or section.pictures]


def _facts(metrics: Metrics) -> dict[str, str]:
    windows, made = metrics.windows, metrics.made
    failed = sum(row.n_failed for row in single_rows(metrics.results) if row.horizon_s == HORIZONS[-1])
    facts = {
        "dataset": metrics.dataset,
        "split": f"{metrics.split}; evaluated on the {metrics.part} part",
        "windows": f"{windows.n} of 5 s, one every {windows.stride_s:g} s, in {windows.blocks} blocks of "
        f"{windows.block_s:g} s on {windows.drives} drive(s)",
        "driving": f"median {number(windows.median_distance_m, 1)} m in 5 s, "
        f"{number(windows.median_speed_mps, 1)} m/s at the start",
        "seen before": f"{number(100 * windows.driven_in_training, 0)} % of the path lies within 5 m of training's",
        "date": made.date,
        "machine": made.machine,
        "command": made.command,
        "versions": ", ".join(f"{name} {version}" for name, version in made.versions.items()),
    }
    if metrics.assumptions:
        facts["assumptions"] = "; ".join(metrics.assumptions)
    if metrics.warnings:
        facts["warnings"] = "; ".join(metrics.warnings)
    if failed:
        facts["failed"] = f"predictions that are not finite: {failed}; means over them are not either"
    return facts


def _map_reads(metrics: Metrics) -> str:
    """Return what the lookup `map` reads."""
    if metrics.features:
        return "reads it at the predicted place, as a planner does"
    return "reads the slope of the path driven later, at its point nearest to the predicted place, which no planner has"


def _notes(metrics: Metrics) -> Sequence[str]:
    units = ", ".join(f"{name} {np.sqrt(scale):.3g}" for name, scale in metrics.loss.scale.items())
    weights = ", ".join(f"{name} {weight:g}" for name, weight in metrics.loss.weights.items())
    names = dict.fromkeys(row.model for row in metrics.results)
    known = "; ".join(f"{name}: {MODELS[name].what}" for name in names if name in MODELS and MODELS[name].what)
    first = metrics.headlines[0].model if metrics.headlines else ""
    return (
        *([f"Models: {known}."] if known else []),
        *([f"The report is about {first}, which the command names first."] if first else []),
        "Start: a causal start knows only what was known at the time; a smoothed one sees a little of the future, and "
        "is shown beside it for comparison. The causal one is what a planner has.",
        "Lookup: recorded reads the terrain under the recorded future path, as in the paper, which also gives away how "
        f"far the vehicle went; map {_map_reads(metrics)}, and decides. Models without a lookup do not read the "
        "terrain.",
        "Intervals are of the mean, bootstrapped over drives, then blocks within each drawn drive, then seeds: windows "
        f"of one drive that start within {metrics.windows.block_s:g} s of each other stay together, since overlapping "
        "windows are not independent, and windows of a drive share its ground. Of a single drive blocks are drawn, and "
        f"nothing is said of other drives; a dash: fewer than {MIN_UNITS} drives, or blocks of a single drive.",
        "A model with several runs: each window's error is the mean over seeds; folds are evaluated on different "
        "windows, which are put together. It is the mean of errors, not the error of a mean prediction.",
        f"The loss is the mean over all 250 steps of squared errors, each divided by the mean square error of "
        f"{REFERENCE} in training (roots: {units}), weighted ({weights}) and summed.",
        "A prediction that is not finite counts as infinitely wrong.",
    )
