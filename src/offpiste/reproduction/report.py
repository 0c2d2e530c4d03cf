"""Report of a reproduced figure: the paper's claims, tables, pictures and metrics.json."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from offpiste.core.conventions import FEATURE_SETS
from offpiste.dataset.store import Dataset
from offpiste.evaluation.evaluate import Reading
from offpiste.evaluation.evaluated_windows import share_driven_in_training
from offpiste.evaluation.intervals import PairedDifference, percent
from offpiste.evaluation.metrics import LossUnits, ResultRow, last_rows, pooled_rows, provenance, write_metrics
from offpiste.evaluation.report import component_table
from offpiste.report.page import Page, picture, table_section, write_page
from offpiste.report.text_table import TextTable, interval, number
from offpiste.reproduction.data import driven_seconds, opened
from offpiste.reproduction.figures import caption, fig3, fig4
from offpiste.reproduction.results import HINDSIGHT, MAP, FigureMetrics, FigureResults
from offpiste.reproduction.runs import PART, loss_units
from offpiste.reproduction.settings import (
    BASELINE,
    PCA_SWEPT,
    ReproductionSettings,
    compression_sizes,
    feature_numbers,
    paper_name,
)
from offpiste.training.losses import COMPONENTS
from offpiste.visualization.coverage import FeatureCoverage, coverage_sections, measure_coverage

NAMES = {
    "distance_error_m": "distance [m]",
    "vx_error_mps": "v_x [m/s]",
    "yaw_error_rad": "yaw [rad]",
    "vy_error_mps": "v_y [m/s]",
    "loss": "loss",
}
"""Names of the errors in tables."""

VERDICTS = ("yes", "yes, not certain", "no, not certain", "no", "–")
"""Verdicts from certainly yes to certainly no."""


def write_figure(settings: ReproductionSettings, results: FigureResults) -> TextTable:
    """Write report.html, its figures and metrics.json, each whole or not at all.

    Returns:
        the paper's claims and the results.
    """
    dataset, folder = opened(settings), settings.out / settings.figure
    stored, is_fig4 = len(dataset.features), settings.figure == "fig4"
    coverage = measure_coverage(dataset) if is_fig4 else None
    metrics = _metrics(settings, dataset, results, coverage)
    claims = fig4_claims(results) if is_fig4 else fig3_claims(results, stored)
    drawn = fig4(results) if is_fig4 else fig3(results, stored)
    pictures = [picture(name.replace(" ", "-"), figure, caption(name, results)) for name, figure in drawn.items()]
    tables = [component_table(pooled_rows(metrics.results)), difference_table(results), seed_table(results)]
    if is_fig4:
        tables += [distance_table(results, metrics.results, name) for name in NAMES if name != "vy_error_mps"]
    sections = [table_section(claims, *pictures), *(table_section(table) for table in tables if table.lines)]
    if coverage is not None:
        sections += coverage_sections(coverage)
    title = f"offpiste reproduce {settings.figure} --size {settings.size.name}"
    headlines = sentences(results, "dc" if is_fig4 else "cf")
    write_page(Page(title, headlines, _facts(settings, dataset, metrics), sections), folder)
    write_metrics(folder / "metrics.json", metrics)
    return claims


def _metrics(
    settings: ReproductionSettings, dataset: Dataset, results: FigureResults, coverage: FeatureCoverage | None
) -> FigureMetrics:
    pairs = [(label, reading) for label in _others(results) for reading in results.readings]
    units = dict(zip(COMPONENTS, loss_units(settings).tolist(), strict=True))
    return FigureMetrics(
        figure=settings.figure,
        settings=settings.described(),
        dataset=str(dataset.path),
        split=dataset.split.text,
        part=PART,
        seeds={label: list(range(settings.size.seeds)) for label in results.models},
        windows={
            " ".join(filter(None, reading)): len(results.errors(BASELINE, reading).row) for reading in results.readings
        },
        made=provenance("", results.sampling.seed, settings.device),
        loss=LossUnits(asdict(settings.size.train.weights), units),
        against_b=[results.compare(*pair) for pair in pairs]
        + [run for pair in pairs for run in results.compare_seeds(*pair)],
        coverage={} if coverage is None else _coverage(coverage),
        results=results.rows(),
    )


def _coverage(coverage: FeatureCoverage) -> dict[str, Any]:
    """Return the coverage by feature set."""
    return {
        "feature_sets": list(FEATURE_SETS),
        "valid": coverage.share.tolist(),
        "valid_of_hindsight": coverage.of_hindsight.tolist(),
        "valid_in_reach": coverage.in_reach.tolist(),
        "l2_difference_over_range": coverage.apart.length.tolist(),
        "l2_difference_of_unrelated_cells": coverage.unrelated,
    }


def _facts(settings: ReproductionSettings, dataset: Dataset, metrics: FigureMetrics) -> dict[str, str]:
    stored, most, training = len(dataset.features), max(PCA_SWEPT), settings.size.train
    capped = "" if stored >= most else f"; the paper uses up to {most}"
    places = {"recorded": "at recorded places", "map": "on the map"}
    evaluated = {places[reading.split()[0]]: count for reading, count in metrics.windows.items()}
    if settings.dataset is None and settings.split == "drives":
        seen_before = "each drive in its own world, test drives in worlds without training"
    else:
        share = 100 * share_driven_in_training(dataset, PART)
        seen_before = f"{share:.0f} % of the test path is within 5 m of the training path, by coordinates"
    driven = zip(driven_seconds(dataset), ("train", "validate", "test"), strict=True)
    return {
        "dataset": f"{dataset.path}, {len(dataset.drives)} drives, {stored} features{capped}",
        "split": f"{dataset.split.text}; {seen_before}",
        "driven": ", ".join(f"{seconds:.0f} s to {use}" for seconds, use in driven),
        "evaluated": ", ".join(f"{count} windows of 5 s {where}" for where, count in evaluated.items()),
        "training": f"{training.epochs} epochs, batch {training.batch}, a window every {training.stride} rows; best "
        "epoch by validation",
        "seeds": ", ".join(f"{label}: {' '.join(map(str, seeds))}" for label, seeds in metrics.seeds.items()),
        **metrics.made.facts(),
    }


def verdict(difference: PairedDifference, limit: float = 0.0) -> str:
    """Judge whether errors are below `limit` (-0.1: by 10 % and more), and whether the interval confirms it."""
    if not np.isfinite(difference.mean):
        return "–"
    # A model that learned nothing equals b exactly.
    reached = "yes" if difference.mean <= limit and difference.mean < 0 else "no"
    low, high = difference.ci95
    sure = np.isfinite(high) and (high <= limit if reached == "yes" else low > limit or low >= 0)
    return reached if sure else f"{reached}, not certain"


def above(difference: PairedDifference) -> str:
    """Judge whether errors are above 0, and whether the interval confirms it."""
    low, high = difference.ci95
    return verdict(PairedDifference(-difference.mean, (-high, -low)))


def fig3_claims(results: FigureResults, stored: int) -> TextTable:
    """Compare with the claims of figure 3: features help in hindsight; code length and feature number matter little."""
    lines: list[tuple[str, ...]] = []
    for quantity, name, limit in (("loss", "summed loss", -0.10), ("vx_error_mps", "v_x error at 5 s", -0.08)):
        for reading in _present(results, (HINDSIGHT, MAP)):
            mine = _gain(results, "cf", reading, quantity)
            paper = f"{100 * limit:.0f} %" if reading == HINDSIGHT else f"{100 * limit:.0f} % (recorded)"
            lines.append((f"CF against B, mean {name}, {_place(reading)}", paper, percent(mine), verdict(mine, limit)))
    for reading in _present(results, (HINDSIGHT, MAP)):
        df, cf = (_gain(results, name, reading) for name in ("df", "cf"))
        apart = results.apart("df", "cf", [reading])
        said = above(apart)
        lines.append(
            (
                f"DF equal to or slightly below CF, distance error, {_place(reading)}",
                "DF slightly below",
                f"DF {100 * df.mean:+.1f} %, CF {100 * cf.mean:+.1f} %, DF minus CF {percent(apart)} of B",
                said if said == "–" else VERDICTS[3 - VERDICTS.index(said)],
            )
        )
    for name, swept in (("n", compression_sizes(stored)), ("PCA features", feature_numbers(stored))):
        gains = {n: _gain(results, model.label, HINDSIGHT) for n, model in swept.items()}
        numbers = ", ".join(f"{n}: {percent(gain)}" for n, gain in gains.items())
        below = max((verdict(gain) for gain in gains.values()), key=VERDICTS.index)
        lines.append((f"robust to {name}, distance error against B", "all below B", numbers, below))
    return _claims(lines)


def fig4_claims(results: FigureResults) -> TextTable:
    """Compare with the claims of figure 4: models trained on hindsight fail at large distances, DC does not."""
    lines: list[tuple[str, ...]] = []
    for label in ("df", "cf"):
        far = {name: _gain(results, label, ("recorded", name)) for name in ("20", "30", "40")}
        behind = min((above(value) for value in far.values()), key=VERDICTS.index)
        numbers = ", ".join(f"{name} m: {percent(value)}" for name, value in far.items())
        lines.append((f"{label.upper()} above B at large distances", "above", numbers, behind))
    apart = results.apart("df", "cf", [("recorded", name) for name in ("10", "20", "30", "40")])
    numbers = f"DF minus CF, mean over 10 to 40 m: {percent(apart)} of B"
    lines.append(("DF more sensitive than CF", "DF worse", numbers, above(apart)))
    for name in ("hindsight", "0", "10", "20", "30"):
        value = _gain(results, "dc", ("recorded", name))
        where = "in hindsight" if name == "hindsight" else f"at {name} m"
        lines.append((f"DC below B {where}", "below", percent(value), verdict(value)))
    for reading in _present(results, (MAP,)):
        value = _gain(results, "dc", reading)
        lines.append((f"DC below B, {_place(reading)} (decides)", "not in the paper", percent(value), verdict(value)))
    return _claims(lines)


def sentences(results: FigureResults, label: str) -> list[str]:
    """Return sentences with a model's main numbers, the deciding terrain lookup first."""
    lines = []
    for reading in _present(results, (MAP, HINDSIGHT)):
        distance, loss = (percent(_gain(results, label, reading, name)) for name in ("distance_error_m", "loss"))
        numbers = f"distance error after 5 s {distance}, loss {loss}"
        lines.append(f"{paper_name(label)} against {paper_name(BASELINE)}, {_place(reading)}: {numbers}")
    return lines


def _gain(results: FigureResults, label: str, reading: Reading, quantity: str = "distance_error_m") -> PairedDifference:
    return results.compare(label, reading).relative[quantity]


def _present(results: FigureResults, wanted: Sequence[Reading]) -> Iterator[Reading]:
    return (reading for reading in wanted if reading in results.readings)


def _place(reading: Reading) -> str:
    return "map at predicted places" if reading == MAP else "recorded lookup in hindsight"


def _claims(lines: Sequence[tuple[str, ...]]) -> TextTable:
    about = (
        "Relative to B on the same windows, over all seeds, with 95 % intervals over drives, blocks and seeds. The "
        "last column follows the mean; 'not certain' means that the interval includes the limit. A claim with several "
        "numbers is as certain as the deciding number."
    )
    return TextTable("What the paper says", ("claim", "paper", "here", "as in the paper"), lines, about)


def _named(label: str, reading: Reading) -> str:
    return f"{paper_name(label)} · {' '.join(filter(None, reading))}"


def _others(results: FigureResults) -> list[str]:
    return [label for label in results.models if label != BASELINE]


def difference_table(results: FigureResults) -> TextTable:
    """Compare every model with `b`, with the same terrain lookup on the same windows."""
    lines = []
    for label in _others(results):
        for reading in results.readings:
            against = results.compare(label, reading)
            cells = (percent(against.relative[key]) for key in NAMES)
            lines.append((_named(label, reading), *cells, f"{against.n}", f"{against.levels.seeds}"))
    about = (
        f"Mean error relative to that of {paper_name(BASELINE)}; negative values: the model is better. Both use the "
        "same draws of drives, blocks and seeds."
    )
    names = ("model", *(name.partition(" [")[0] for name in NAMES.values()), "windows", "seeds")
    return TextTable(f"Against {paper_name(BASELINE)}", names, lines, about)


def seed_table(results: FigureResults) -> TextTable:
    """Compare each run with the `b` of the same seed, for models with several runs."""
    lines = []
    for label in _others(results):
        for reading in _present(results, (MAP, HINDSIGHT)):
            if runs := results.compare_seeds(label, reading):
                gains = ([100 * run.relative[key].mean for run in runs] for key in ("distance_error_m", "loss"))
                lines.append((_named(label, reading), *map(_spread, gains)))
    about = f"Each run relative to the run of {paper_name(BASELINE)} with the same seed, and the standard deviation."
    return TextTable("Seeds", ("model", "distance error [%]", "loss [%]"), lines, about)


def _spread(values: Sequence[float]) -> str:
    return f"{', '.join(f'{value:+.1f}' for value in values)} (std {np.std(values, ddof=1):.1f})"


def distance_table(results: FigureResults, result_rows: Sequence[ResultRow], quantity: str) -> TextTable:
    """Return the mean error by viewing distance, and relative to that of `b` with the same normals."""
    rows = {(row.label, row.feature_set): getattr(row, quantity) for row in last_rows(pooled_rows(result_rows))}
    lines: list[tuple[str, ...]] = []
    for label in results.models:
        mine = [rows[label, name] for name in FEATURE_SETS]
        lines.append((paper_name(label), *(number(error.mean, 3) for error in mine)))
        lines.append(("  95 % interval", *(interval(error.ci95, 3) for error in mine)))
        if label != BASELINE:
            gains = (_gain(results, label, ("recorded", name), quantity) for name in FEATURE_SETS)
            lines.append((f"  against {paper_name(BASELINE)}", *map(percent, gains)))
    names = (name if name == "hindsight" else f"{name} m" for name in FEATURE_SETS)
    about = "At recorded places; every model reads normals of the same set as its features."
    return TextTable(f"Mean {NAMES[quantity]} by distance", ("model", *names), lines, about)
