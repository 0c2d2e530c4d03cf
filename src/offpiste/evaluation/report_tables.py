"""Tables of an evaluation's report, and the one on the terminal."""

from collections.abc import Sequence

import numpy as np

from offpiste.dynamics.models import is_baseline
from offpiste.evaluation.errors import COMPONENTS, HORIZONS
from offpiste.evaluation.intervals import PairedDifference
from offpiste.evaluation.metrics import BandRow, Minus, ResultRow, pooled_rows
from offpiste.evaluation.result_rows import REFERENCE, by_reading
from offpiste.report.text_table import Cell, TextTable, interval, number

NAMES = {
    "distance_error_m": "distance [m]",
    "yaw_error_rad": "yaw [rad]",
    "vx_error_mps": "vx [m/s]",
    "vy_error_mps": "vy [m/s]",
    "yaw_rate_error_radps": "yaw rate [rad/s]",
    "loss": "loss",
}


def terminal_table(rows: Sequence[ResultRow]) -> TextTable:
    """Mean distance error by horizon and its difference to `kinematic`; a line per model, start and terrain lookup."""
    groups = by_reading(pooled_rows(list(rows)))
    windows = ", ".join(str(n) for n in sorted({group[-1].n for group in groups}))
    lines = []
    for group in groups:
        last = group[-1]
        minus = last.minus.get(REFERENCE)
        difference = minus.distance_error_m if minus else None
        lines.append(
            (
                last.label + (f" ({last.n_failed} failed)" if last.n_failed else ""),
                last.start,
                " ".join(filter(None, (last.lookup, last.feature_set))),
                *(number(row.distance_error_m.mean) for row in group),
                interval(last.distance_error_m.ci95),
                f"{number(difference.mean)} {interval(difference.ci95)}" if difference else "",
            )
        )
    levels = ", or ".join(dict.fromkeys(group[-1].levels.text() for group in groups))
    title = f"Mean distance error [m] on {windows} windows of the {rows[0].part} part, 95 % intervals: {levels}"
    horizons = [f"{seconds} s" for seconds in HORIZONS]
    return TextTable(title, ("model", "start", "lookup", *horizons, "at 5 s", f"minus {REFERENCE}"), lines, left=3)


def horizon_table(rows: Sequence[ResultRow]) -> TextTable:
    """Mean distance error by horizon: a line per model and terrain lookup, starts side by side."""
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
    """Mean errors of all components after 5 s."""
    lines: list[tuple[str | Cell, ...]] = [
        (row.reading_label, row.start, *(_mean(row, name, 3) for name in NAMES)) for row in _at_last_horizon(rows)
    ]
    about = f"Mean absolute errors with 95 % intervals; the loss is over all steps. {drawn_from(rows)}"
    return TextTable("All components after 5 s", ("model", "start", *NAMES.values()), lines, about, left=2)


def distribution_table(rows: Sequence[ResultRow]) -> TextTable:
    """Quantiles of the distance error after 5 s."""
    lines = []
    for row in _at_last_horizon(rows):
        error = row.distance_error_m
        numbers = (error.mean, error.q1, error.median, error.q3, error.p90)
        windows = f"{row.n}" + (f" ({row.n_failed} failed)" if row.n_failed else "")
        lines.append((row.reading_label, row.start, *map(number, numbers), windows))
    names = ("model", "start", "mean [m]", "25 % [m]", "median [m]", "75 % [m]", "90 % [m]", "windows")
    return TextTable("Distribution", names, lines, left=2)


def difference_table(rows: Sequence[ResultRow]) -> TextTable:
    """Paired differences after 5 s: a line per pair, each once; starts side by side."""
    result: dict[tuple[str, str], dict[str, Minus]] = {}
    learned = [row for row in _at_last_horizon(rows) if not is_baseline(row.model)]
    order = list(dict.fromkeys(row.label for row in learned))
    for row in learned:
        for other, minus in row.minus.items():
            if other not in order or order.index(other) > order.index(row.label):
                result.setdefault((row.reading_label, other), {})[row.start] = minus
    starts = list(dict.fromkeys(row.start for row in rows))
    lines: list[tuple[str | Cell, ...]] = []
    for (name, other), by_start in result.items():
        minuses = [by_start[start] for start in starts]
        cells = [cell for minus in minuses for cell in (_difference(minus.distance_error_m), _difference(minus.loss))]
        lines.append((f"{name} minus {other}", *cells))
    names = ("", *(f"{start}: {what}" for start in starts for what in ("distance [m]", "loss")))
    about = (
        "The same windows for both; negative: the first is better; bold: the 95 % interval does not hold 0. "
        + drawn_from(learned)
    )
    return TextTable("Paired differences after 5 s", names, lines, about)


def drawn_from(rows: Sequence[ResultRow]) -> str:
    """Sentences that say how many drives, blocks and seeds intervals are drawn from, with the models of each."""
    models: dict[str, list[str]] = {}
    for row in rows:
        models.setdefault(row.levels.text(), []).append(row.label)
    if not models:
        return ""
    each = [f"{text} ({', '.join(dict.fromkeys(labels))})" for text, labels in models.items()]
    text = "; ".join(each) if len(each) > 1 else next(iter(models))
    bare = [row.distance_error_m.mean for row in rows if not np.isfinite(row.distance_error_m.ci95).all()]
    failed = "" if np.isfinite(bare).all() else "–: no mean or interval, since predictions failed."
    caveats = dict.fromkeys(row.levels.caveat for row in rows)
    return " ".join(filter(None, (f"Intervals are over {text}.", failed, *caveats)))


def band_table(rows: Sequence[BandRow]) -> TextTable:
    """Mean distance error after 5 s by the speed at the start: a line per model, start and lookup."""
    last = [row for row in rows if row.horizon_s == HORIZONS[-1]]
    windows = {row.band: row.n for row in last}
    cells = {(row.reading_label, row.start, row.band): _mean(row, "distance_error_m", 2) for row in last}
    lines: list[tuple[str | Cell, ...]] = [
        (name, start, *(cells.get((name, start, band), "") for band in windows))
        for name, start in dict.fromkeys((name, start) for name, start, _ in cells)
    ]
    names = ("model", "start", *(f"{band} [m]" for band in windows))
    about = "Windows: " + ", ".join(f"{n} {band}" for band, n in windows.items()) + "; with 95 % intervals. "
    levels = {row.band: row.levels for row in last if row.levels is not None}
    about += " ".join(f"{band}: {one.caveat}" for band, one in levels.items() if one.caveat)
    return TextTable("Distance error after 5 s by the speed at the start", names, lines, about, left=2)


def run_table(rows: Sequence[ResultRow]) -> TextTable:
    """Errors of single runs after 5 s.

    Args:
        rows: of models with several runs (`metrics.run_rows`).
    """
    lines = []
    for row in _at_last_horizon(rows):
        minus = row.minus.get(REFERENCE)
        lines.append(
            (
                row.reading_label,
                row.start,
                "" if row.seed is None else str(row.seed),
                "" if row.fold is None else str(row.fold),
                _mean(row, "distance_error_m", 2),
                number(row.distance_error_m.median),
                number(row.loss.mean, 3),
                _difference(minus.distance_error_m) if minus else "",
                str(row.n),
            )
        )
    about_run = ("model", "start", "seed", "fold")
    numbers = ("distance [m]", "median [m]", "loss", f"minus {REFERENCE} [m]", "windows")
    return TextTable("Each run after 5 s", about_run + numbers, lines, left=2)


def _at_last_horizon(rows: Sequence[ResultRow]) -> list[ResultRow]:
    return [group[-1] for group in by_reading(rows)]


def _mean(row: ResultRow | BandRow, name: str, digits: int) -> Cell:
    error = getattr(row, name)
    return Cell(number(error.mean, digits), interval(error.ci95, digits))


def _difference(difference: PairedDifference) -> Cell:
    low, high = difference.ci95
    return Cell(number(difference.mean, 3), interval(difference.ci95, 3), bold=low > 0 or high < 0)


assert tuple(NAMES)[:-1] == COMPONENTS
