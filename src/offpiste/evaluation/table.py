"""The result as a table on the terminal."""

from collections.abc import Sequence

import numpy as np
from rich.table import Table

from offpiste.evaluation.judge import HORIZONS
from offpiste.evaluation.results import ResultRow, pooled_rows
from offpiste.evaluation.tabulate import REFERENCE


def number(value: float, digits: int = 2) -> str:
    """A number, or a dash where it is not finite."""
    return f"{value:.{digits}f}" if np.isfinite(value) else "–"


def interval(bounds: tuple[float, float], digits: int = 2) -> str:
    """An interval, or a dash where there is none."""
    low, high = bounds
    return f"[{number(low, digits)}, {number(high, digits)}]" if np.isfinite(low) and np.isfinite(high) else "–"


def by_way(rows: Sequence[ResultRow]) -> list[list[ResultRow]]:
    """Rows that differ only in the horizon, together, in ascending order of it."""
    found: dict[tuple[object, ...], list[ResultRow]] = {}
    for row in rows:
        key = (row.model, row.variant, row.seed, row.fold, row.start, row.feature_set, row.lookup)
        found.setdefault(key, []).append(row)
    return [sorted(group, key=lambda row: row.horizon_s) for group in found.values()]


def render_table(rows: Sequence[ResultRow]) -> Table:
    """Mean distance error by horizon, and the difference to `kinematic`; one line a model, start and lookup."""
    pooled = pooled_rows(list(rows))
    last_of = [group[-1] for group in by_way(pooled)]
    windows = ", ".join(str(n) for n in sorted({row.n for row in last_of}))
    table = Table(
        title=rf"Mean distance error \[m] on {windows} windows of the {rows[0].part} part, 95 % intervals by blocks",
        title_justify="left",
    )
    for name in ("model", "start", "lookup"):
        table.add_column(name, no_wrap=True)
    for seconds in HORIZONS:
        table.add_column(f"{seconds} s", justify="right", no_wrap=True)
    table.add_column("at 5 s", no_wrap=True)
    table.add_column(f"minus {REFERENCE}", justify="right", no_wrap=True)
    for group in by_way(pooled):
        last = group[-1]
        error = last.distance_error_m
        against = last.minus.get(REFERENCE)
        difference = against.distance_error_m if against else None
        table.add_row(
            last.label + (f" ({last.n_failed} failed)" if last.n_failed else ""),
            last.start,
            " ".join(filter(None, (last.lookup, last.feature_set))),
            *(number(row.distance_error_m.mean) for row in group),
            interval(error.ci95),
            f"{number(difference.mean)} {interval(difference.ci95)}" if difference else "",
        )
    return table
