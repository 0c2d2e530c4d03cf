"""Results of a control experiment as Markdown and JSON."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from offpiste.core.files import write_text
from offpiste.evaluation.intervals import PairedDifference
from offpiste.report.text_table import TextTable, interval, number


def write_control(folder: Path, tables: Sequence[TextTable], results: Mapping[str, Any]) -> Path:
    """Write control.md and control.json.

    Returns:
        control.md.
    """
    write_text(folder / "control.json", msgspec.json.format(msgspec.json.encode({"schema": 1, **results})).decode())
    write_text(folder / "control.md", "\n".join(table.markdown() for table in tables))
    return folder / "control.md"


def percent(difference: PairedDifference, digits: int = 1) -> str:
    """A relative difference with its interval."""
    low, high = (100 * bound for bound in difference.ci95)
    return f"{number(100 * difference.mean, digits)} % {interval((low, high), digits)}"
