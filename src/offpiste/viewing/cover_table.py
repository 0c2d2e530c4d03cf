"""The report of a dataset's features as rows of text, for the terminal and for the page alike."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from rich.markup import escape
from rich.table import Table

from offpiste.conventions import FEATURE_SETS
from offpiste.dataset.coverage import HINDSIGHT, PAPER_RATES
from offpiste.evaluation.table import number
from offpiste.viewing.covered import Covered, Rates


@dataclass(frozen=True)
class TextTable:
    """A table of text; the first column names the lines.

    Attributes:
        about: what its numbers are.
    """

    title: str
    names: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]
    about: str = ""

    def rich(self) -> Table:
        """For the terminal."""
        # Unescaped, rich takes a unit in brackets for a style.
        table = Table(title=escape(self.title), title_justify="left")
        for column, name in enumerate(self.names):
            table.add_column(escape(name), justify="right" if column else "left", no_wrap=True)
        for line in self.lines:
            table.add_row(*map(escape, line))
        return table


def tables(found: Covered) -> tuple[TextTable, ...]:
    """All of them, in the order in which they are read."""
    counted = (_contacts(found),) if len(found.contacts) else ()
    return (_rates(found), _distances(found), _matrix(found), _neighbours(found), *counted)


def _rates(found: Covered) -> TextTable:
    def line(name: str, rates: np.ndarray) -> tuple[str, ...]:
        return (name, *(number(rate) for rate in rates))

    def lines_of(rates: Rates) -> list[tuple[str, ...]]:
        name = f"{rates.name} ({rates.cells} cells)"
        return [
            line(name, rates.share),
            line("  of those valid in hindsight", rates.of_hindsight),
            line("  of those within reach", rates.in_reach),
        ]

    drives = found.drives if len(found.drives) > 1 else ()
    body = [line for rates in (*drives, found.whole) for line in lines_of(rates)]
    about = (
        "Share of cells under the wheels that have features, each counted once a pass. Within reach: only cells that "
        "the vehicle was at the set's distance from on that pass, ± 5 m; the start of a drive was never seen from 40 m."
    )
    names = ("valid rate by distance [m]", *FEATURE_SETS)
    return TextTable("Valid rates", names, (*body, line("paper", np.array(PAPER_RATES))), about)


def _distances(found: Covered) -> TextTable:
    lines = [
        (name, *(number(value, 1) for value in column))
        for name, column in zip(("25 %", "median", "75 %"), found.quartiles.T, strict=True)
    ]
    about = (
        "From the sensor to the ground when the features were observed. The map keeps the closest observation, so what "
        "lies behind the vehicle was seen just before it was driven over, unless a camera looks back."
    )
    names = ("observation distance [m]", *FEATURE_SETS)
    return TextTable("Achieved observation distances", names, tuple(lines), about)


def _matrix(found: Covered) -> TextTable:
    length = found.apart.length
    lines = [(name, *(number(v) for v in row)) for name, row in zip(FEATURE_SETS, length, strict=True)]
    about = (
        "Mean l2 norm of the difference of the same cells' features between two sets, where both are valid, divided by "
        "the l2 norm of the features' ranges (1st to 99th percentile of all cells in hindsight). Two cells that have "
        f"nothing to do with each other differ by {number(found.unrelated)}."
    )
    return TextTable("Differences between sets", ("l2 difference / range", *FEATURE_SETS), tuple(lines), about)


def _neighbours(found: Covered) -> TextTable:
    pairs = [f"{a}/{b}" for a, b in pairwise(FEATURE_SETS[1:])]
    lines = []
    for name, differences in (("1 to 99 %", found.apart), ("total", found.apart_of_total)):
        each = differences.neighbours()
        known = np.isfinite(each).any(axis=1)
        for what, reduce in (("mean", np.nanmean), ("largest", np.nanmax)):
            values = np.full(len(each), np.nan)
            if known.any():
                values[known] = reduce(each[known], axis=1)
            lines.append((f"{what} of all features, range {name}", *(number(v) for v in values)))
    about = (
        "Mean absolute difference of each feature between distances next to each other, divided by that feature's own "
        "range. The paper finds 0.3 of the total range of values."
    )
    return TextTable("Differences of single features", ("difference / range", *pairs), tuple(lines), about)


def _contacts(found: Covered) -> TextTable:
    share = found.contacts / found.contacts.sum()
    names = [f"pass {n + 1}" for n in range(len(share))]
    line = ("contacts", *(f"{c} ({s:.0%})" for c, s in zip(found.contacts, share, strict=True)))
    about = "A wheel on a cell at a row, by how often that place was passed before: later passes have seen it nearby."
    return TextTable("Rows by pass", ("wheels at rows", *names), (line,), about)


def headline(found: Covered) -> str:
    """One sentence with the main numbers."""
    rates = ", ".join(
        f"{name} {number(rate)}" for name, rate in zip(FEATURE_SETS, found.whole.share, strict=True) if rate == rate
    )
    far = found.apart.length[HINDSIGHT]
    most = number(np.nanmax(far)) if np.isfinite(far).any() else "–"
    return f"valid by distance: {rates}; features differ from hindsight's by up to {most} of their range"
