"""What a control ends with: tables as Markdown for a person, JSON for a program, pictures beside them."""

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
from matplotlib.figure import Figure

from experiments.controls.errors import Gain
from offpiste.evaluation.intervals import PairedDifference
from offpiste.evaluation.tables import interval, number
from offpiste.files import write_bytes, write_text
from offpiste.visualization.coverage import TextTable


def markdown(table: TextTable) -> str:
    """A table with its title and what its numbers are."""
    lines = [table.names, ("---",) * len(table.names), *table.lines]
    return "\n".join([f"## {table.title}", table.about, "", *(f"| {' | '.join(line)} |" for line in lines)]) + "\n"


def write_control(
    folder: Path,
    tables: Sequence[TextTable],
    results: Mapping[str, Any],
    figures: Mapping[str, Figure] | None = None,
) -> Path:
    """Write control.md, control.json and pictures.

    Returns:
        control.md.
    """
    parts = [markdown(table) for table in tables]
    for name, figure in (figures or {}).items():
        content = io.BytesIO()
        figure.savefig(content, format="png", dpi=110)
        write_bytes(folder / f"{name}.png", content.getvalue())
        parts.append(f"![{name}]({name}.png)\n")
    write_text(folder / "control.json", msgspec.json.format(msgspec.json.encode({"schema": 1, **results})).decode())
    write_text(folder / "control.md", "\n".join(parts))
    return folder / "control.md"


def percent(difference: PairedDifference, digits: int = 1) -> str:
    """A relative difference with its interval."""
    low, high = (100 * bound for bound in difference.ci95)
    return f"{number(100 * difference.mean, digits)} % {interval((low, high), digits)}"


def gain_table(title: str, gains: Sequence[Gain], about: str) -> TextTable:
    """A line a gain."""
    lines = [
        (
            f"{g.model}, {g.case}" if g.case else g.model,
            " ".join(filter(None, (g.lookup, g.feature_set))),
            number(g.error_m),
            number(g.baseline_error_m),
            percent(g.distance),
            percent(g.loss),
            f"{g.n} x {g.seeds}" if g.seeds > 1 else f"{g.n}",
        )
        for g in gains
    ]
    names = ("model", "lookup", "error [m]", "baseline [m]", "distance error", "loss", "windows")
    return TextTable(title, names, tuple(lines), about)
