"""Picture and table of the probes' scores."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.table import Table

from offpiste.core.conventions import FEATURE_SETS
from offpiste.report.figure import png

Rows = Sequence[dict[str, Any]]

_STYLES = {
    "ground": ("#8c8c8c", ":", "true kind and wetness"),
    "kind": ("#000000", "-", "true kind (ceiling)"),
    "visual": ("#0072b2", "-", "visual features"),
    "averaged": ("#56b4e9", "--", "the same, averaged over 0.8 s"),
    "colour": ("#009e73", "--", "mean colour"),
    "brightness": ("#d55e00", "-", "brightness (floor)"),
    "world": ("#cc79a7", ":", "which world"),
}
"""Colour, line and name of each input."""

_LOWEST = -0.5
"""R² below this is drawn at the lower border."""


def distance_picture(rows: Rows, *, title: str) -> bytes:
    """R² and rank correlation by feature set for both targets, trained on hindsight; PNG."""
    targets = list(dict.fromkeys(row["target"] for row in rows))
    figure = Figure(figsize=(11, 3.6 * len(targets)), dpi=120, layout="constrained")
    axes = figure.subplots(len(targets), 2, squeeze=False)
    for (left, right), target in zip(axes, targets, strict=True):
        mine = [r for r in rows if r["target"] == target and r["trained"] == "hindsight" and r["cells"] == "valid"]
        for plot, quantity, label in ((left, "r2", "R²"), (right, "rank", "rank correlation")):
            _lines(plot, mine, quantity)
            plot.set(ylabel=f"{target.replace('_', ' ')}: {label}", xlabel="seen from [m]")
    axes[0, 1].legend(frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(1.0, 0.3))
    figure.suptitle(
        f"{title}: probes trained on hindsight, tested on other drives; 95 % intervals over drives and blocks"
    )
    return png(figure)


def _lines(plot: Axes, rows: Rows, quantity: str) -> None:
    _bare(plot)
    for name, (colour, line, label) in _STYLES.items():
        mine = {row["feature_set"]: row for row in rows if row["input"] == name}
        at = [n for n, feature_set in enumerate(FEATURE_SETS) if feature_set in mine]
        result = [mine[FEATURE_SETS[n]] for n in at]
        value = np.array([row[quantity] for row in result], float)
        if not np.isfinite(value).any():
            continue
        plot.plot(at, value.clip(_LOWEST), line, color=colour, marker="o", markersize=4, label=label)
        low, high = np.array([row[f"{quantity}_ci95"] for row in result], float).T
        if name in ("visual", "brightness", "kind"):
            plot.fill_between(at, low.clip(_LOWEST), high.clip(_LOWEST), color=colour, alpha=0.12, linewidth=0)
    plot.set_xticks(range(len(FEATURE_SETS)), FEATURE_SETS)
    plot.set_ylim(_LOWEST - 0.03, 1.03)


def _bare(plot: Axes) -> None:
    plot.spines[["top", "right"]].set_visible(False)
    plot.grid(axis="y", color="#dddddd", linewidth=0.6)
    plot.axhline(0, color="#999999", linewidth=0.8)


def distance_table(rows: Rows, title: str) -> Table:
    """R² and rank correlation by input and feature set."""
    table = Table("target", "trained on", "cells", "from", *FEATURE_SETS, title=f"{title}: R² (rank correlation)")
    lines: dict[tuple[str, ...], dict[str, str]] = {}
    for row in rows:
        if row["cells"] == "common" and row["input"] not in ("visual", "brightness"):
            continue  # true inputs hardly change with the cells
        key = tuple(row[name] for name in ("target", "trained", "cells", "input"))
        lines.setdefault(key, {})[row["feature_set"]] = f"{row['r2']:.2f} ({row['rank']:.2f})"
    for key, result in lines.items():
        table.add_row(*key, *(result.get(name, "") for name in FEATURE_SETS))
    return table
