"""Report of a reproduced figure: report.html, its pictures, and metrics.json."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import msgspec
from matplotlib.figure import Figure

from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.files import write_text
from offpiste.dataset.store import Dataset
from offpiste.evaluation.evaluated_windows import share_driven_in_training
from offpiste.evaluation.metrics import LossUnits, provenance
from offpiste.report.figure import png
from offpiste.report.page import Page, Picture, Section, table_section, write_page
from offpiste.report.text_table import TextTable
from offpiste.reproduction import figures, tables
from offpiste.reproduction.figures import draw_same, predict_same
from offpiste.reproduction.results import FigureMetrics, FigureResults
from offpiste.reproduction.runs import PART, EvaluationData, driven_time
from offpiste.reproduction.settings import PCA_SWEPT, FigureModel, ReproductionSettings
from offpiste.reproduction.steps import format_duration, times_by_kind
from offpiste.training.losses import COMPONENTS
from offpiste.training.run import load_run
from offpiste.visualization.coverage_figures import coverage_sections
from offpiste.visualization.coverage_tables import FeatureCoverage, measure_coverage

SAME = "The same ten windows with features seen from every distance, read at recorded places. Up: ahead at the start."


def write_figure(settings: ReproductionSettings, data: EvaluationData, results: FigureResults) -> TextTable:
    """Write report.html, its pictures, and metrics.json, each file whole or not at all.

    Returns:
        The paper's claims beside the results.
    """
    dataset, folder = data.dataset, settings.out / settings.figure
    stored, is_fig4 = len(dataset.features), settings.figure == "fig4"
    seen = measure_coverage(dataset) if is_fig4 else None
    metrics = _metrics(settings, data, results, seen)
    compared = tables.fig4_claims(results) if is_fig4 else tables.fig3_claims(results, stored)
    drawn = figures.fig4(results) if is_fig4 else figures.fig3(results, stored)
    pictures = [_picture(name, figure, figures.caption(name, results)) for name, figure in drawn.items()]
    sections = [table_section(compared, *pictures)]
    sections += [table_section(table) for table in _error_tables(results, metrics, dataset) if table.lines]
    if is_fig4:
        sections.append(Section("The same windows", pictures=[_same_windows(settings, data, results.models)]))
    if seen is not None:
        sections += coverage_sections(seen, ("rates", "differences"))
    title = f"offpiste reproduce {settings.figure} --size {settings.size.name}"
    headlines = tables.sentences(results, "dc" if is_fig4 else "cf")
    write_page(Page(title, headlines, _facts(settings, data, metrics), sections), folder)
    write_text(folder / "metrics.json", msgspec.json.format(msgspec.json.encode(metrics), indent=2).decode() + "\n")
    return compared


def _error_tables(results: FigureResults, metrics: FigureMetrics, dataset: Dataset) -> list[TextTable]:
    common = [tables.error_table(metrics.results), tables.difference_table(results), tables.seed_table(results)]
    if metrics.figure != "fig4":
        return common
    quantities = [name for name in tables.NAMES if name != "vy_error_mps"]
    by_distance = [tables.distance_table(results, metrics.results, name) for name in quantities]
    return [*common, *by_distance, tables.seen_table(results, dataset)]


def _picture(name: str, figure: Figure, caption: str) -> Picture:
    return Picture(name.replace(" ", "-"), png(figure), caption)


def _same_windows(settings: ReproductionSettings, data: EvaluationData, models: Sequence[FigureModel]) -> Picture:
    dynamics = {m.label: load_run(settings.runs / m.folder(0), device=settings.device).dynamics for m in models}
    return _picture("same windows", draw_same(predict_same(dynamics, data.windows)), SAME)


def _metrics(
    settings: ReproductionSettings, data: EvaluationData, results: FigureResults, seen: FeatureCoverage | None
) -> FigureMetrics:
    dataset = data.dataset
    others = [model for model in results.models if model != results.baseline]
    pairs = [(model, reading) for model in others for reading in results.readings]
    single = [run for pair in pairs for run in results.compare_seeds(*pair) if len(results.runs[pair]) > 1]
    return FigureMetrics(
        figure=settings.figure,
        settings=settings.described(),
        dataset=str(dataset.path),
        split=dataset.split.text,
        part=PART,
        seeds={model.label: list(range(settings.size.seeds)) for model in results.models},
        windows={
            " ".join(filter(None, reading)): len(results.over_seeds(results.baseline, reading).row)
            for reading in results.readings
        },
        made=provenance("", results.sampling.seed, settings.device),
        loss=LossUnits(asdict(settings.size.train.weights), dict(zip(COMPONENTS, data.scale.tolist(), strict=True))),
        against_b=[results.compare(*pair) for pair in pairs] + single,
        coverage={} if seen is None else _coverage(seen),
        results=results.rows(),
    )


def _coverage(seen: FeatureCoverage) -> dict[str, Any]:
    """Coverage by feature set."""
    return {
        "feature_sets": list(FEATURE_SETS),
        "valid": seen.whole.share.tolist(),
        "valid_of_hindsight": seen.whole.of_hindsight.tolist(),
        "valid_in_reach": seen.whole.in_reach.tolist(),
        "l2_difference_over_range": seen.apart.length.tolist(),
        "l2_difference_of_unrelated_cells": seen.unrelated,
    }


def _facts(settings: ReproductionSettings, data: EvaluationData, metrics: FigureMetrics) -> dict[str, str]:
    dataset, size, driven = data.dataset, settings.size, driven_time(data.dataset)
    stored, most = len(dataset.features), max(PCA_SWEPT)
    capped = "" if stored >= most else f"; the paper goes up to {most}, but there are no more here"
    train = size.train
    return {
        "dataset": f"{dataset.path}, {len(dataset.drives)} drives, {stored} features{capped}",
        "split": f"{dataset.split.text}; {_seen_before(settings, data)}",
        "driven": f"{driven.train:.0f} s to train, {driven.validation:.0f} s to validate, {driven.test:.0f} s to test",
        "evaluated": ", ".join(f"{number} windows of 5 s {where}" for where, number in _evaluated(metrics).items()),
        "training": f"{train.epochs} epochs, batch {train.batch}, a window every {train.stride} rows; best epoch by "
        "validation",
        "seeds": ", ".join(f"{label}: {' '.join(map(str, seeds))}" for label, seeds in metrics.seeds.items()),
        "spent": ", ".join(f"{kind} {format_duration(time)}" for kind, time in times_by_kind(settings.times).items()),
        "date": metrics.made.date,
        "machine": metrics.made.machine,
        "command": metrics.made.command,
        "versions": ", ".join(f"{name} {version}" for name, version in metrics.made.versions.items()),
    }


def _evaluated(metrics: FigureMetrics) -> dict[str, int]:
    """Number of windows at recorded places, the same for all feature sets, and on the map."""
    kinds = {"recorded": "at recorded places", "map": "on the map"}
    return {kinds[reading.split()[0]]: number for reading, number in metrics.windows.items()}


def _seen_before(settings: ReproductionSettings, data: EvaluationData) -> str:
    if settings.dataset is None and settings.split == "drives":
        return "every drive in a world of its own, test drives in worlds that never trained"
    share = 100 * share_driven_in_training(data.dataset, PART)
    return f"{share:.0f} % of the test path has coordinates within 5 m of training's"
