"""Report of a reproduced figure: tables beside the paper's claims, report.html, its figures, and metrics.json."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

import msgspec
import numpy as np

from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.files import write_text
from offpiste.dataset.store import Dataset
from offpiste.evaluation.evaluate import Reading
from offpiste.evaluation.evaluated_windows import share_driven_in_training
from offpiste.evaluation.intervals import PairedDifference
from offpiste.evaluation.metrics import LossUnits, ResultRow, provenance
from offpiste.report.page import Page, Picture, Section, picture, table_section, write_page
from offpiste.report.text_table import TextTable, interval, number
from offpiste.reproduction import figures
from offpiste.reproduction.figures import draw_same, predict_same
from offpiste.reproduction.results import (
    HINDSIGHT,
    MAP,
    FigureMetrics,
    FigureResults,
    last_rows,
    percent,
    seen_throughout,
)
from offpiste.reproduction.runs import PART, EvaluationData, driven_time
from offpiste.reproduction.settings import (
    BASELINE,
    PCA_SWEPT,
    FigureModel,
    ReproductionSettings,
    compression_sizes,
    feature_numbers,
)
from offpiste.reproduction.steps import format_duration, times_by_kind
from offpiste.training.losses import COMPONENTS
from offpiste.training.run import load_run
from offpiste.visualization.coverage_figures import coverage_sections
from offpiste.visualization.coverage_tables import FeatureCoverage, measure_coverage

SAME = "The same ten windows with features seen from every distance, read at recorded places. Up: ahead at the start."


def write_figure(settings: ReproductionSettings, data: EvaluationData, results: FigureResults) -> TextTable:
    """Write report.html, its figures and metrics.json, each whole or not at all.

    Returns:
        the paper's claims beside the results.
    """
    dataset, folder = data.dataset, settings.out / settings.figure
    stored, is_fig4 = len(dataset.features), settings.figure == "fig4"
    seen = measure_coverage(dataset) if is_fig4 else None
    metrics = _metrics(settings, data, results, seen)
    compared = fig4_claims(results) if is_fig4 else fig3_claims(results, stored)
    drawn = figures.fig4(results) if is_fig4 else figures.fig3(results, stored)
    pictures = [
        picture(name.replace(" ", "-"), figure, figures.caption(name, results)) for name, figure in drawn.items()
    ]
    sections = [table_section(compared, *pictures)]
    sections += [table_section(table) for table in _error_tables(results, metrics, dataset) if table.lines]
    if is_fig4:
        sections.append(Section("The same windows", pictures=[_same_windows(settings, data, results.models)]))
    if seen is not None:
        sections += coverage_sections(seen, ("rates", "differences"))
    title = f"offpiste reproduce {settings.figure} --size {settings.size.name}"
    headlines = sentences(results, "dc" if is_fig4 else "cf")
    write_page(Page(title, headlines, _facts(settings, data, metrics), sections), folder)
    write_text(folder / "metrics.json", msgspec.json.format(msgspec.json.encode(metrics), indent=2).decode() + "\n")
    return compared


def _error_tables(results: FigureResults, metrics: FigureMetrics, dataset: Dataset) -> list[TextTable]:
    common = [error_table(metrics.results), difference_table(results), seed_table(results)]
    if metrics.figure != "fig4":
        return common
    quantities = [name for name in NAMES if name != "vy_error_mps"]
    by_distance = [distance_table(results, metrics.results, name) for name in quantities]
    return [*common, *by_distance, seen_table(results, dataset)]


def _same_windows(settings: ReproductionSettings, data: EvaluationData, models: Sequence[FigureModel]) -> Picture:
    dynamics = {m.label: load_run(settings.runs / m.folder(0), device=settings.device).dynamics for m in models}
    return picture("same-windows", draw_same(predict_same(dynamics, data.windows)), SAME)


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
    """Return the coverage by feature set."""
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
    """Return the numbers of windows at recorded places, the same for all feature sets, and on the map."""
    kinds = {"recorded": "at recorded places", "map": "on the map"}
    return {kinds[reading.split()[0]]: number for reading, number in metrics.windows.items()}


def _seen_before(settings: ReproductionSettings, data: EvaluationData) -> str:
    if settings.dataset is None and settings.split == "drives":
        return "each drive in its own world, test drives in worlds without training"
    share = 100 * share_driven_in_training(data.dataset, PART)
    return f"{share:.0f} % of the test path lies within 5 m of the training path, by coordinates"


def verdict(difference: PairedDifference, limit: float = 0.0) -> str:
    """Say whether errors are below `limit` (-0.1: by 10 % and more), and whether the interval agrees."""
    if not np.isfinite(difference.mean):
        return "–"
    # A model that learned nothing equals b exactly.
    reached = "yes" if difference.mean <= limit and difference.mean < 0 else "no"
    low, high = difference.ci95
    sure = np.isfinite(high) and (high <= limit if reached == "yes" else low > limit or low >= 0)
    return reached if sure else f"{reached}, not certain"


VERDICTS = ("yes", "yes, not certain", "no, not certain", "no", "–")
"""Verdicts from certainly yes to certainly no."""


def above(difference: PairedDifference) -> str:
    """Say whether errors are above 0, and whether the interval agrees."""
    low, high = difference.ci95
    return verdict(PairedDifference(-difference.mean, (-high, -low)))


def _not(said: str) -> str:
    return said if said == "–" else VERDICTS[3 - VERDICTS.index(said)]


def fig3_claims(results: FigureResults, stored: int) -> TextTable:
    """Compare with the claims of figure 3: features help in hindsight, and neither n nor their number matters much."""
    by_label = {model.label: model for model in results.models}
    lines: list[tuple[str, ...]] = []
    for quantity, name, limit in (("loss", "summed loss", -0.10), ("vx_error_mps", "v_x error at 5 s", -0.08)):
        for reading in _present(results, (HINDSIGHT, MAP)):
            mine = results.compare(by_label["cf"], reading).relative[quantity]
            paper = f"{100 * limit:.0f} %" if reading == HINDSIGHT else f"{100 * limit:.0f} % (recorded)"
            lines.append((f"cf against b, mean {name}, {_place(reading)}", paper, percent(mine), verdict(mine, limit)))
    for reading in _present(results, (HINDSIGHT, MAP)):
        df, cf = (results.compare(by_label[name], reading).relative["distance_error_m"] for name in ("df", "cf"))
        apart = results.apart(by_label["df"], by_label["cf"], [reading])
        lines.append(
            (
                f"df at or slightly below cf, distance error, {_place(reading)}",
                "df slightly below",
                f"df {100 * df.mean:+.1f} %, cf {100 * cf.mean:+.1f} %, df minus cf {percent(apart)} of b",
                _not(above(apart)),
            )
        )
    for name, swept in (("n", compression_sizes(stored)), ("PCA features", feature_numbers(stored))):
        gains = {n: results.compare(model, HINDSIGHT).relative["distance_error_m"] for n, model in swept.items()}
        numbers = ", ".join(f"{n}: {percent(gain)}" for n, gain in gains.items())
        below = max((verdict(gain) for gain in gains.values()), key=VERDICTS.index)
        lines.append((f"robust to {name}, distance error against b", "all below b", numbers, below))
    return _table(lines)


def fig4_claims(results: FigureResults) -> TextTable:
    """Compare with the claims of figure 4: naive training fails with features seen from afar, `dc` does not."""
    by_label = {model.label: model for model in results.models}

    def gain(label: str, name: str) -> PairedDifference:
        return results.compare(by_label[label], ("recorded", name)).relative["distance_error_m"]

    lines: list[tuple[str, ...]] = []
    for label in ("df", "cf"):
        far = {name: gain(label, name) for name in ("20", "30", "40")}
        behind = min((above(value) for value in far.values()), key=VERDICTS.index)
        numbers = ", ".join(f"{name} m: {percent(value)}" for name, value in far.items())
        lines.append((f"{label} falls behind b far away", "behind", numbers, behind))
    ahead: list[Reading] = [("recorded", name) for name in ("10", "20", "30", "40")]
    apart = results.apart(by_label["df"], by_label["cf"], ahead)
    numbers = f"df minus cf, mean over 10 to 40 m: {percent(apart)} of b"
    lines.append(("df is more sensitive than cf", "df worse", numbers, above(apart)))
    for name in ("hindsight", "0", "10", "20", "30"):
        value = gain("dc", name)
        where = "in hindsight" if name == "hindsight" else f"at {name} m"
        lines.append((f"dc below b {where}", "below", percent(value), verdict(value)))
    for reading in _present(results, (MAP,)):
        value = results.compare(by_label["dc"], reading).relative["distance_error_m"]
        lines.append((f"dc below b, {_place(reading)} (decides)", "not in the paper", percent(value), verdict(value)))
    return _table(lines)


def sentences(results: FigureResults, label: str) -> list[str]:
    """Return sentences with a model's main numbers, the deciding terrain lookup first."""
    model = next(model for model in results.models if model.label == label)

    def sentence(reading: Reading) -> str:
        gains = results.compare(model, reading).relative
        numbers = f"distance error after 5 s {percent(gains['distance_error_m'])}, loss {percent(gains['loss'])}"
        return f"{label} against b, {_place(reading)}: {numbers}"

    return [sentence(reading) for reading in _present(results, (MAP, HINDSIGHT))]


def _present(results: FigureResults, wanted: Sequence[Reading]) -> Iterator[Reading]:
    return (reading for reading in wanted if reading in results.readings)


def _place(reading: Reading) -> str:
    return "map at predicted places" if reading == MAP else "recorded lookup in hindsight"


def _table(lines: Sequence[tuple[str, ...]]) -> TextTable:
    about = (
        "Relative to b on the same windows, over all seeds, with 95 % intervals over drives, blocks and seeds. The "
        "last column follows the mean; 'not certain': the interval includes the limit. A claim with several numbers "
        "is as certain as the deciding one."
    )
    return TextTable("What the paper says", ("claim", "paper", "here", "as in the paper"), tuple(lines), about)


NAMES = {
    "distance_error_m": "distance [m]",
    "vx_error_mps": "v_x [m/s]",
    "yaw_error_rad": "yaw [rad]",
    "vy_error_mps": "v_y [m/s]",
    "loss": "loss",
}


def error_table(rows: Sequence[ResultRow]) -> TextTable:
    """Return the mean errors after 5 s of every model and terrain lookup."""
    lines = [
        (
            row.reading_label,
            *(f"{number(getattr(row, key).mean, 3)} {interval(getattr(row, key).ci95, 3)}" for key in NAMES),
            number(row.distance_error_m.median),
            f"{row.n}" + (f" ({row.n_failed} failed)" if row.n_failed else ""),
            f"{row.levels.seeds}",
        )
        for row in last_rows(rows)
    ]
    about = (
        "Mean absolute errors over all seeds, with 95 % intervals bootstrapped over drives, blocks of 10 s within "
        "them, and seeds; the loss is over all steps. On the map, other windows are evaluated."
    )
    names = ("model", *NAMES.values(), "median [m]", "windows", "seeds")
    return TextTable("Errors after 5 s", names, tuple(lines), " ".join((about, *_caveats(rows))))


def _caveats(rows: Sequence[ResultRow]) -> list[str]:
    """Return the numbers of drives and blocks by lookup, and the caveats of the intervals."""
    counts = {row.lookup or "": row.levels for row in last_rows(rows)}
    each = [f"{name}: {levels.drives} drives, {levels.blocks} blocks" for name, levels in counts.items()]
    caveats = dict.fromkeys(levels.caveat for levels in counts.values() if levels.caveat)
    return [f"{'; '.join(each)}.", *caveats]


def difference_table(results: FigureResults) -> TextTable:
    """Compare every model with `b`, with the same terrain lookup on the same windows."""
    lines = []
    for model in results.models:
        for reading in results.readings:
            if model.label != BASELINE:
                against = results.compare(model, reading)
                name = f"{model.label} · {' '.join(filter(None, reading))}"
                seeds = str(against.levels.seeds if against.levels else 0)
                lines.append((name, *(percent(against.relative[key]) for key in NAMES), str(against.n), seeds))
    about = (
        f"Mean error of the model relative to that of {BASELINE}; negative: the model is better. Both on the same "
        "draws of drives, blocks and seeds."
    )
    names = ("model", *(name.partition(" [")[0] for name in NAMES.values()), "windows", "seeds")
    return TextTable("Against b", names, tuple(lines), about)


def seed_table(results: FigureResults) -> TextTable:
    """Compare each run with the `b` of the same seed, for models with several runs."""
    lines = []
    for model in results.models:
        for reading in results.readings:
            runs = results.compare_seeds(model, reading)
            if model.label != BASELINE and len(runs) > 1 and reading[1] in (None, "hindsight"):
                gains = [100 * run.relative["distance_error_m"].mean for run in runs]
                losses = [100 * run.relative["loss"].mean for run in runs]
                name = f"{model.label} · {' '.join(filter(None, reading))}"
                lines.append((name, _spread(gains), _spread(losses)))
    about = "Each run relative to the b of the same seed, and their standard deviation."
    return TextTable("Seeds", ("model", "distance error [%]", "loss [%]"), tuple(lines), about)


def distance_table(results: FigureResults, result_rows: Sequence[ResultRow], quantity: str) -> TextTable:
    """Return the mean error by viewing distance, and relative to that of `b` with the same normals."""
    sets = [name for name in FEATURE_SETS if ("recorded", name) in results.readings]
    rows = {row.reading_label: row for row in last_rows(result_rows)}
    lines = []
    for model in results.models:
        mine = [rows[_reading_label(model.label, name)] for name in sets]
        lines.append((model.label, *(number(getattr(row, quantity).mean, 3) for row in mine)))
        lines.append(("  95 % interval", *(interval(getattr(row, quantity).ci95, 3) for row in mine)))
        if model.label != BASELINE:
            gains = [results.compare(model, ("recorded", name)).relative[quantity] for name in sets]
            lines.append(("  against b", *(percent(gain) for gain in gains)))
    about = "At recorded places; every model, b included, reads normals of the same set as its features."
    return TextTable(f"Mean {NAMES[quantity]} by distance", ("model", *_metres(sets)), tuple(lines), about)


def seen_table(results: FigureResults, dataset: Dataset) -> TextTable:
    """Return distance errors against `b` in windows without missing features."""
    sets = [name for name in FEATURE_SETS if ("recorded", name) in results.readings]
    windows = results.over_seeds(results.baseline, ("recorded", sets[0]))
    seen = {name: seen_throughout(dataset, name, windows) for name in sets}
    lines: list[tuple[str, ...]] = [("windows", *(str(int(s.sum())) for s in seen.values()))]
    for model in results.models:
        if model.label != BASELINE:
            gains = [results.compare(model, ("recorded", name), seen[name]).relative for name in sets]
            lines.append((model.label, *(percent(gain["distance_error_m"]) for gain in gains)))
    about = "Distance error against b, only on windows with features of the set under all wheels throughout."
    return TextTable("Windows valid throughout", ("model", *_metres(sets)), tuple(lines), about)


def _reading_label(label: str, feature_set: str) -> str:
    return f"{label} · recorded" + ("" if feature_set == "hindsight" else f" {feature_set} m")


def _metres(sets: Sequence[str]) -> list[str]:
    return [name if name == "hindsight" else f"{name} m" for name in sets]


def _spread(values: Sequence[float]) -> str:
    return f"{', '.join(f'{value:+.1f}' for value in values)} (std {np.std(values, ddof=1):.1f})"
