"""Report of an evaluation: report.html with headlines, tables and figures, metrics.json, and the terminal table."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from offpiste.dynamics import MODELS
from offpiste.dynamics.models import is_baseline
from offpiste.evaluation.box_plots import colour_of
from offpiste.evaluation.errors import HORIZONS
from offpiste.evaluation.evaluate import Evaluation
from offpiste.evaluation.intervals import MIN_UNITS, Levels, PairedDifference
from offpiste.evaluation.metrics import (
    REFERENCE,
    BandRow,
    Headline,
    Metrics,
    Minus,
    ResultRow,
    by_reading,
    display,
    last_rows,
    pooled_rows,
    reading_label,
    run_rows,
    single_rows,
    write_metrics,
)
from offpiste.evaluation.report_figures import REPORT_FIGURES
from offpiste.report.page import Card, Page, Picture, Section, picture, write_page
from offpiste.report.text_table import Cell, TextTable, interval, number

UNFINISHED: Final = ".offpiste-report"
"""Hidden file that marks the folder of an unfinished report."""
REPORT_FILES: Final = (UNFINISHED, "metrics.json", "calibration.md")
"""Files that identify the folder of a report."""

MOST = 4
"""Largest number of differences to other models in the headlines."""

NAMES = {
    "distance_error_m": "distance [m]",
    "yaw_error_rad": "yaw [rad]",
    "vx_error_mps": "vx [m/s]",
    "vy_error_mps": "vy [m/s]",
    "yaw_rate_error_radps": "yaw rate [rad/s]",
    "loss": "loss",
}
"""Names of the errors in tables."""


def write_report(evaluation: Evaluation, folder: Path) -> None:
    """Write report.html, its figures as PNG files, and metrics.json, each whole or not at all."""
    write_page(report_page(evaluation.metrics, draw_figures(evaluation)), folder)
    write_metrics(folder / "metrics.json", evaluation.metrics)


def draw_figures(evaluation: Evaluation) -> dict[str, list[Picture]]:
    """Draw all registered figures that apply to an evaluation, by section heading."""
    pictures: dict[str, list[Picture]] = {}
    for name, registered in REPORT_FIGURES.items():
        drawn = registered.draw(evaluation)
        if drawn is not None:
            pictures.setdefault(registered.section, []).append(picture(name, drawn, registered.caption))
    return pictures


def report_page(metrics: Metrics, pictures: dict[str, list[Picture]]) -> Page:
    """Return the report as a page; sections without tables come last."""
    rows, runs = pooled_rows(metrics.results), run_rows(metrics.results)
    tables: dict[str, list[TextTable]] = {
        "Mean distance error by horizon": [horizon_table(rows)],
        "Growth of the error": [],
        "All components after 5 s": [component_table(rows)],
        "Paired differences after 5 s": [difference_table(rows)],
        "Each run after 5 s": [run_table(runs)] if runs else [],
        "Error by initial speed": [band_table(metrics.bands)] if len({row.band for row in metrics.bands}) > 1 else [],
        "Distribution": [],
        "Typical windows": [],
        "Worst windows": [],
    }
    sections = [Section(name, tables.get(name, []), pictures.get(name, [])) for name in {**tables, **pictures}]
    sections = [section for section in sections if section.tables or section.pictures]
    models = ", ".join(dict.fromkeys(display(headline.model) for headline in metrics.headlines)) or "baselines"
    return Page(
        f"{models} on {metrics.dataset.rstrip('/').rpartition('/')[2]}",
        headline_texts(metrics),
        _facts(metrics),
        [*sections, Section("How to read this", notes=list(_notes(metrics)))],
        result_cards(metrics),
    )


def _facts(metrics: Metrics) -> dict[str, str]:
    windows = metrics.windows
    failed = sum(row.n_failed for row in last_rows(single_rows(metrics.results)))
    facts = {
        "dataset": metrics.dataset,
        "split": f"{metrics.split}; evaluated on the {metrics.part} part",
        "windows": f"{windows.n} of 5 s, one every {windows.stride_s:g} s, in {windows.blocks} blocks of "
        f"{windows.block_s:g} s on {windows.drives} drive(s)",
        "driving": f"median {number(windows.median_distance_m, 1)} m in 5 s, "
        f"{number(windows.median_speed_mps, 1)} m/s at the start",
        "seen before": f"{number(100 * windows.driven_in_training, 0)} % of the path is within 5 m of training",
        **metrics.made.facts(),
        "assumptions": "; ".join(metrics.assumptions),
        "warnings": "; ".join(metrics.warnings),
        "failed": f"{failed} predictions are not finite; neither are the means that include them" if failed else "",
    }
    return {name: text for name, text in facts.items() if text}


def _notes(metrics: Metrics) -> Iterator[str]:
    """Yield explanations of the models, terms and numbers."""
    names = dict.fromkeys(row.model for row in metrics.results)
    known = [name for name in names if name in MODELS and MODELS[name].what]
    if known:
        yield f"Models: {'; '.join(f'{_explained(name)}: {MODELS[name].what}' for name in known)}."
    if metrics.headlines:
        yield f"Figures show windows of {display(metrics.headlines[0].model)}, the first model."
    map_reads = (
        "map reads it at the predicted place, as a planner does"
        if metrics.features
        else "map reads the slope of the later driven path nearest to the predicted place, which no planner has"
    )
    notes = Path(__file__).with_name("notes.txt").read_text("utf-8")
    filled = notes.format(
        map_reads=map_reads,
        block=metrics.windows.block_s,
        least=MIN_UNITS,
        reference=REFERENCE,
        units=", ".join(f"{name} {np.sqrt(scale):.3g}" for name, scale in metrics.loss.scale.items()),
        weights=", ".join(f"{name} {weight:g}" for name, weight in metrics.loss.weights.items()),
    )
    yield from filled.splitlines()


def _explained(name: str) -> str:
    """Return the display name of a model, with its registered name in brackets if they differ."""
    return name if display(name) == name else f"{display(name)} ({name})"


def headline_texts(metrics: Metrics) -> list[str]:
    """Return the main number of the first model, and its differences to other trained models."""
    deciding = deciding_headlines(metrics.headlines)
    if not deciding:
        return []
    differences = list(_differences(metrics, deciding[0]))
    more = [f"{len(differences) - MOST} more are below."] if len(differences) > MOST else []
    return [headline_text(deciding[0]), *differences[:MOST], *more]


def headline_text(headline: Headline) -> str:
    """Return a sentence with the main number."""
    text = f"{display(headline.model)}: {number(headline.distance_error_m)} m mean distance error after 5 s"
    return f"{', '.join(filter(None, (text, _comparison(headline))))} ({_conditions(headline)})"


def result_cards(metrics: Metrics) -> list[Card]:
    """Return a card for each trained model, and one for the reference."""
    deciding = deciding_headlines(metrics.headlines)
    about = "mean distance error after 5 s"
    cards = [
        Card(
            name=reading_label(headline.model, headline.lookup, headline.feature_set),
            value=f"{number(headline.distance_error_m)} m",
            about=about,
            comparison=_comparison(headline),
            tone="better" if headline.ci95[1] < 0 else "worse" if headline.ci95[0] > 0 else "",
            note=_conditions(headline),
            colour=colour_of(headline.model),
        )
        for headline in deciding
    ]
    for row in last_rows(pooled_rows(metrics.results)):
        if deciding and (row.label, row.start) == (deciding[0].other, deciding[0].start):
            value = f"{number(row.distance_error_m.mean)} m"
            cards.append(Card(row.reading_label, value, about, note="without training", colour=colour_of(row.label)))
    return cards


def deciding_headlines(headlines: Sequence[Headline]) -> list[Headline]:
    """Return one headline per model: with the first start and the deciding terrain lookup."""
    first = [headline for headline in headlines if headline.start == headlines[0].start]
    on_map = {headline.model for headline in first if headline.lookup == "map"}
    return [headline for headline in first if headline.lookup == "map" or headline.model not in on_map]


def _comparison(headline: Headline) -> str:
    """Describe the error relative to the reference; empty if it is not finite."""
    if not np.isfinite(headline.relative):
        return ""
    sign, side = (-1, "below") if headline.relative <= 0 else (1, "above")
    low, high = sorted(100 * sign * bound for bound in headline.ci95)
    bounds = f" {interval((low, high), 0)}" if np.isfinite(low) else ""
    return f"{100 * abs(headline.relative):.0f} %{bounds} {side} {headline.other}"


def _conditions(headline: Headline) -> str:
    lookup = headline.lookup and f"{headline.lookup} lookup"
    runs = f"mean of {headline.runs} runs" if headline.runs > 1 else ""
    return ", ".join(filter(None, (f"{headline.start} start", lookup, runs)))


def _differences(metrics: Metrics, headline: Headline) -> Iterator[str]:
    """Yield a sentence for each other trained model."""
    case = (headline.model, headline.start, headline.lookup, headline.feature_set)
    rows = last_rows(pooled_rows(metrics.results))
    trained = {row.label for row in rows if not is_baseline(row.model)}
    for row in rows:
        if (row.label, row.start, row.lookup, row.feature_set) == case:
            for other, minus in row.minus.items():
                if other in trained:
                    yield difference_text(display(row.label), display(other), minus.distance_error_m, row.levels)


def difference_text(model: str, other: str, difference: PairedDifference, levels: Levels) -> str:
    """Return a sentence on the difference between two models."""
    (low, high), mean = difference.ci95, difference.mean
    if not np.isfinite(mean):
        return f"{model} and {other} are not compared: predictions failed, see below."
    if not np.isfinite(low):
        return f"{model} minus {other}: {number(mean)} m {levels.caveat}"
    if low <= 0 <= high:
        return f"No difference between {model} and {other} is shown: {number(mean)} m {interval(difference.ci95)}."
    low, high = sorted((abs(low), abs(high)))
    side = "less" if mean < 0 else "more"
    return f"The error of {model} is {number(abs(mean))} m {interval((low, high))} {side} than that of {other}."


def terminal_table(rows: Sequence[ResultRow]) -> TextTable:
    """Return mean distance errors by horizon and their differences to `kinematic`, by model, start and lookup."""
    groups = by_reading(pooled_rows(rows))
    windows = ", ".join(str(n) for n in sorted({group[-1].n for group in groups}))
    lines = [
        (
            display(group[-1].label) + (f" ({group[-1].n_failed} failed)" if group[-1].n_failed else ""),
            group[-1].start,
            " ".join(filter(None, (group[-1].lookup, group[-1].feature_set))),
            *(number(row.distance_error_m.mean) for row in group),
            interval(group[-1].distance_error_m.ci95),
            _minus_reference(group[-1], 2),
        )
        for group in groups
    ]
    levels = ", or ".join(dict.fromkeys(group[-1].levels.text() for group in groups))
    title = f"Mean distance error [m] on {windows} windows of the {rows[0].part} part, 95 % intervals: {levels}"
    horizons = [f"{seconds} s" for seconds in HORIZONS]
    return TextTable(title, ("model", "start", "lookup", *horizons, "at 5 s", f"minus {REFERENCE}"), lines, left=3)


def horizon_table(rows: Sequence[ResultRow]) -> TextTable:
    """Return mean distance errors by horizon: a line per model and lookup, a group of columns per start."""
    starts = list(dict.fromkeys(row.start for row in rows))
    mean = {(row.reading_label, row.start, row.horizon_s): number(row.distance_error_m.mean) for row in rows}
    columns = [(start, horizon) for start in starts for horizon in HORIZONS]
    return TextTable(
        "Mean distance error by horizon",
        ("model", *(f"{horizon} s" for _, horizon in columns)),
        [
            (name, *(mean.get((name, start, float(horizon)), "") for start, horizon in columns))
            for name in dict.fromkeys(name for name, _, _ in mean)
        ],
        groups=tuple(f"{start} start [m]" for start in starts),
    )


def component_table(rows: Sequence[ResultRow]) -> TextTable:
    """Return mean errors of all components after 5 s, and quantiles of the distance error."""
    lines: list[tuple[str | Cell, ...]] = []
    for row in last_rows(rows):
        error, failed = row.distance_error_m, f" ({row.n_failed} failed)" if row.n_failed else ""
        quantiles = (number(value) for value in (error.q1, error.median, error.q3, error.p90))
        means = (_mean(row, name, 3) for name in NAMES)
        lines.append((row.reading_label, row.start, *means, *quantiles, f"{row.n}{failed}"))
    about = (
        "Mean absolute errors with 95 % intervals; the loss is over all steps, quantiles are of the distance [m]. "
        + drawn_from(rows)
    )
    names = ("model", "start", *NAMES.values(), "25 %", "median", "75 %", "90 %", "windows")
    return TextTable("All components after 5 s", names, lines, about, left=2)


def difference_table(rows: Sequence[ResultRow]) -> TextTable:
    """Return paired differences after 5 s: a line per pair of models, columns per start."""
    result: dict[tuple[str, str], dict[str, Minus]] = {}
    learned = [row for row in last_rows(rows) if not is_baseline(row.model)]
    order = list(dict.fromkeys(row.label for row in learned))
    for row in learned:
        for other, minus in row.minus.items():
            if other not in order or order.index(other) > order.index(row.label):
                result.setdefault((row.reading_label, other), {})[row.start] = minus
    starts = list(dict.fromkeys(row.start for row in rows))
    lines: list[tuple[str | Cell, ...]] = []
    for (name, other), by_start in result.items():
        minuses = [by_start[start] for start in starts]
        cells = [_difference(each) for minus in minuses for each in (minus.distance_error_m, minus.loss)]
        lines.append((f"{name} minus {display(other)}", *cells))
    names = ("", *(f"{start}: {what}" for start in starts for what in ("distance [m]", "loss")))
    about = (
        "On the same windows; negative values: the first model is better; bold: the 95 % interval excludes 0. "
        + drawn_from(learned)
    )
    return TextTable("Paired differences after 5 s", names, lines, about)


def drawn_from(rows: Sequence[ResultRow]) -> str:
    """Describe the numbers of drives, blocks and seeds behind the intervals, by model if they differ."""
    models: dict[str, list[str]] = {}
    for row in rows:
        models.setdefault(row.levels.text(), []).append(row.reading_label)
    if not models:
        return ""
    each = [f"{text} ({', '.join(dict.fromkeys(labels))})" for text, labels in models.items()]
    text = "; ".join(each) if len(each) > 1 else next(iter(models))
    bare = [row.distance_error_m.mean for row in rows if not np.isfinite(row.distance_error_m.ci95).all()]
    failed = "" if np.isfinite(bare).all() else "–: no mean or interval, since predictions failed."
    caveats = dict.fromkeys(row.levels.caveat for row in rows)
    return " ".join(filter(None, (f"Intervals are over {text}.", failed, *caveats)))


def band_table(rows: Sequence[BandRow]) -> TextTable:
    """Return mean distance errors after 5 s by initial speed: a line per model, start and lookup."""
    last = [row for row in rows if row.horizon_s == HORIZONS[-1]]
    bands = {row.band: row for row in last}
    cells = {(row.reading_label, row.start, row.band): _mean(row, "distance_error_m", 2) for row in last}
    lines: list[tuple[str | Cell, ...]] = [
        (name, start, *(cells.get((name, start, band), "") for band in bands))
        for name, start in dict.fromkeys((name, start) for name, start, _ in cells)
    ]
    windows = ", ".join(f"{row.n} {band}" for band, row in bands.items())
    caveats = (f"{band}: {row.levels.caveat}" for band, row in bands.items() if row.levels.caveat)
    about = " ".join((f"Windows: {windows}; with 95 % intervals.", *caveats))
    names = ("model", "start", *(f"{band} [m]" for band in bands))
    return TextTable("Distance error after 5 s by initial speed", names, lines, about, left=2)


def run_table(rows: Sequence[ResultRow]) -> TextTable:
    """Return errors of single runs after 5 s."""
    lines = [
        (
            row.reading_label,
            row.start,
            *("" if of is None else str(of) for of in (row.seed, row.fold)),
            _mean(row, "distance_error_m", 2),
            number(row.distance_error_m.median),
            number(row.loss.mean, 3),
            _minus_reference(row, 3),
            str(row.n),
        )
        for row in last_rows(rows)
    ]
    errors = ("distance [m]", "median [m]", "loss", f"minus {REFERENCE} [m]")
    names = ("model", "start", "seed", "fold", *errors, "windows")
    return TextTable("Each run after 5 s", names, lines, left=2)


def _mean(row: ResultRow | BandRow, name: str, digits: int) -> Cell:
    error = getattr(row, name)
    return Cell(number(error.mean, digits), interval(error.ci95, digits))


def _minus_reference(row: ResultRow, digits: int) -> str | Cell:
    minus = row.minus.get(REFERENCE)
    return "" if minus is None else _difference(minus.distance_error_m, digits)


def _difference(difference: PairedDifference, digits: int = 3) -> Cell:
    low, high = difference.ci95
    return Cell(number(difference.mean, digits), interval(difference.ci95, digits), bold=low > 0 or high < 0)
