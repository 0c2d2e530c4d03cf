"""The folder of a figure: report.html, which needs nothing but itself, its pictures, and metrics.json."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import msgspec
from matplotlib.figure import Figure

from offpiste.conventions import FEATURE_SETS
from offpiste.dataset.store import Dataset
from offpiste.evaluation.evaluated_windows import share_driven_in_training
from offpiste.evaluation.metrics import LossUnits, provenance
from offpiste.files import write_text
from offpiste.report.figure import png
from offpiste.report.page import Page, Picture, Section, table_section, write_page
from offpiste.report.text_table import TextTable
from offpiste.reproduction import figures, tables
from offpiste.reproduction.figures import draw_same, predict_same
from offpiste.reproduction.pieces import said, times_by_kind
from offpiste.reproduction.results import FigureMetrics, Findings
from offpiste.reproduction.runs import PART, Work, driven_in
from offpiste.reproduction.settings import PCA_SWEPT, Member, Reproduction
from offpiste.training.losses import COMPONENTS
from offpiste.training.run import load_run
from offpiste.visualization.coverage import FeatureCoverage, covered
from offpiste.visualization.coverage_figures import coverage_sections

SAME = "The same ten windows with features seen from every distance, read at recorded places. Up: ahead at the start."


def write_figure(asked: Reproduction, work: Work, found: Findings) -> TextTable:
    """Write report.html, its pictures, and metrics.json, each file whole or not at all.

    Returns:
        The paper's claims beside what was found.
    """
    dataset, folder = work.dataset, asked.out / asked.figure
    stored, is_fig4 = len(dataset.features), asked.figure == "fig4"
    seen = covered(dataset) if is_fig4 else None
    metrics = _metrics(asked, work, found, seen)
    compared = tables.fig4_claims(found) if is_fig4 else tables.fig3_claims(found, stored)
    drawn = figures.fig4(found) if is_fig4 else figures.fig3(found, stored)
    pictures = [_picture(name, figure, figures.caption(name)) for name, figure in drawn.items()]
    sections = [table_section(compared, *pictures)]
    sections += [table_section(table) for table in _error_tables(found, metrics, dataset) if table.lines]
    if is_fig4:
        sections.append(Section("The same windows", pictures=[_same_windows(asked, work, found.members)]))
    if seen is not None:
        sections += coverage_sections(seen, ("rates", "differences"))
    title = f"offpiste reproduce {asked.figure} --size {asked.size.name}"
    headlines = tables.sentences(found, "dc" if is_fig4 else "cf")
    write_page(Page(title, headlines, _facts(asked, work, metrics), sections), folder)
    write_text(folder / "metrics.json", msgspec.json.format(msgspec.json.encode(metrics), indent=2).decode() + "\n")
    return compared


def _error_tables(found: Findings, metrics: FigureMetrics, dataset: Dataset) -> list[TextTable]:
    common = [tables.error_table(metrics.results), tables.difference_table(found), tables.seed_table(found)]
    if metrics.figure != "fig4":
        return common
    quantities = [name for name in tables.NAMES if name != "vy_error_mps"]
    by_distance = [tables.distance_table(found, metrics.results, name) for name in quantities]
    return [*common, *by_distance, tables.seen_table(found, dataset)]


def _picture(name: str, figure: Figure, caption: str) -> Picture:
    return Picture(name.replace(" ", "-"), png(figure), caption)


def _same_windows(asked: Reproduction, work: Work, members: Sequence[Member]) -> Picture:
    models = {m.label: load_run(asked.runs / m.folder(0), device=asked.device).dynamics for m in members}
    return _picture("same windows", draw_same(predict_same(models, work.windows)), SAME)


def _metrics(asked: Reproduction, work: Work, found: Findings, seen: FeatureCoverage | None) -> FigureMetrics:
    dataset = work.dataset
    pairs = [(member, reading) for member in found.members if member != found.baseline for reading in found.readings]
    single = [run for pair in pairs for run in found.each_seed(*pair) if len(found.runs[pair]) > 1]
    return FigureMetrics(
        figure=asked.figure,
        settings=asked.described(),
        dataset=str(dataset.path),
        split=dataset.split.text,
        part=PART,
        seeds={member.label: list(member.seeds(asked.size)) for member in found.members},
        windows={
            " ".join(filter(None, reading)): len(found.over_seeds(found.baseline, reading).row)
            for reading in found.readings
        },
        made=provenance("", found.sampling.seed, asked.device),
        loss=LossUnits(asdict(asked.size.train.weights), dict(zip(COMPONENTS, work.scale.tolist(), strict=True))),
        against_b=[found.against(*pair) for pair in pairs] + single,
        coverage={} if seen is None else _coverage(seen),
        results=found.rows(),
    )


def _coverage(seen: FeatureCoverage) -> dict[str, Any]:
    """By feature set."""
    return {
        "feature_sets": list(FEATURE_SETS),
        "valid": seen.whole.share.tolist(),
        "valid_of_hindsight": seen.whole.of_hindsight.tolist(),
        "valid_in_reach": seen.whole.in_reach.tolist(),
        "l2_difference_over_range": seen.apart.length.tolist(),
        "l2_difference_of_unrelated_cells": seen.unrelated,
    }


def _facts(asked: Reproduction, work: Work, metrics: FigureMetrics) -> dict[str, str]:
    dataset, size, driven = work.dataset, asked.size, driven_in(work.dataset)
    stored, most = len(dataset.features), max(PCA_SWEPT)
    capped = "" if stored >= most else f"; the paper goes up to {most}, but there are no more here"
    train = size.train
    return {
        "dataset": f"{dataset.path}, {len(dataset.drives)} drives, {stored} features{capped}",
        "split": f"{dataset.split.text}; {_seen_before(asked, work)}",
        "driven": f"{driven.train:.0f} s to train, {driven.validation:.0f} s to validate, {driven.test:.0f} s to test",
        "judged": ", ".join(f"{number} windows of 5 s {where}" for where, number in _judged(metrics).items()),
        "training": f"{train.epochs} epochs, batch {train.batch}, a window every {train.stride} rows; best epoch by "
        "validation",
        "seeds": ", ".join(f"{label}: {' '.join(map(str, seeds))}" for label, seeds in metrics.seeds.items()),
        "spent": ", ".join(f"{kind} {said(time)}" for kind, time in times_by_kind(asked.times).items()),
        "date": metrics.made.date,
        "machine": metrics.made.machine,
        "command": metrics.made.command,
        "versions": ", ".join(f"{name} {version}" for name, version in metrics.made.versions.items()),
    }


def _judged(metrics: FigureMetrics) -> dict[str, int]:
    """Windows at recorded places, the same for all feature sets, and on the map."""
    kinds = {"recorded": "at recorded places", "map": "on the map"}
    return {kinds[reading.split()[0]]: number for reading, number in metrics.windows.items()}


def _seen_before(asked: Reproduction, work: Work) -> str:
    if asked.dataset is None and asked.split == "drives":
        return "every drive in a world of its own, test drives in worlds that never trained"
    share = 100 * share_driven_in_training(work.dataset, PART)
    return f"{share:.0f} % of the test path has coordinates within 5 m of training's"
