"""What a control ends with: tables as Markdown for a person, JSON for a program, pictures beside them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
from matplotlib.figure import Figure

from offpiste.core.files import write_text
from offpiste.evaluation.intervals import PairedDifference
from offpiste.report.figure import write_png
from offpiste.report.text_table import TextTable, interval, number


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
    parts = [table.markdown() for table in tables]
    for name, figure in (figures or {}).items():
        write_png(folder / f"{name}.png", figure, dpi=110)
        parts.append(f"![{name}]({name}.png)\n")
    write_text(folder / "control.json", msgspec.json.format(msgspec.json.encode({"schema": 1, **results})).decode())
    write_text(folder / "control.md", "\n".join(parts))
    return folder / "control.md"


def percent(difference: PairedDifference, digits: int = 1) -> str:
    """A relative difference with its interval."""
    low, high = (100 * bound for bound in difference.ci95)
    return f"{number(100 * difference.mean, digits)} % {interval((low, high), digits)}"
