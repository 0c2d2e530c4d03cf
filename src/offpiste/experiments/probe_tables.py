"""What the probes found, as tables."""

from collections.abc import Sequence
from typing import Any

from rich.table import Table

from offpiste.conventions import FEATURE_SETS

Rows = Sequence[dict[str, Any]]


def distance_table(rows: Rows, title: str) -> Table:
    """R² and rank correlation by input and feature set."""
    table = Table("target", "trained on", "cells", "from", *FEATURE_SETS, title=f"{title}: R² (rank correlation)")
    lines: dict[tuple[str, ...], dict[str, str]] = {}
    for row in rows:
        if row["cells"] == "common" and row["input"] not in ("visual", "brightness"):
            continue  # true inputs hardly change with the cells
        key = tuple(row[name] for name in ("target", "trained", "cells", "input"))
        lines.setdefault(key, {})[row["feature_set"]] = f"{row['r2']:.2f} ({row['rank']:.2f})"
    for key, found in lines.items():
        table.add_row(*key, *(found.get(name, "") for name in FEATURE_SETS))
    return table


def flaw_table(rows: Rows) -> Table:
    """R² by flaw, probe and feature set."""
    sets = list(dict.fromkeys(row["feature_set"] for row in rows))
    names = ("target", "probe", "degrees", "axis", r"late \[ms]", *sets)
    table = Table(*names, title="Under flaws: R² (rank correlation)")
    lines: dict[tuple[str, ...], dict[str, str]] = {}
    for row in rows:
        numbers = (f"{row['degrees']:g}", str(row["direction"]), f"{1000 * row['late']:g}")
        key: tuple[str, ...] = (row["target"], row["probe"], *numbers)
        lines.setdefault(key, {})[row["feature_set"]] = f"{row['r2']:.2f} ({row['rank']:.2f})"
    for key, found in sorted(lines.items(), key=lambda item: item[0][:2]):
        table.add_row(*key, *(found.get(name, "") for name in sets))
    return table
