"""Tables of text for terminals, Markdown and HTML pages."""

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table


@dataclass(frozen=True)
class Cell:
    """Value with its interval.

    Attributes:
        bold: whether the value is emphasised on pages.
    """

    value: str
    interval: str = ""
    bold: bool = False

    def __str__(self) -> str:
        return f"{self.value} {self.interval}".strip()


@dataclass(frozen=True)
class TextTable:
    """Table of text.

    Attributes:
        names: of the columns.
        lines: text by column.
        about: description of the numbers.
        left: number of columns that name a line, which are aligned to the left.
        groups: headings over equal numbers of the other columns; empty: none.
    """

    title: str
    names: tuple[str, ...]
    lines: Sequence[Sequence[str | Cell]]
    about: str = ""
    left: int = 1
    groups: tuple[str, ...] = ()

    @property
    def group_width(self) -> int:
        """Number of columns under each group's heading; 0 without groups."""
        return (len(self.names) - self.left) // len(self.groups) if self.groups else 0

    def rich(self) -> Table:
        """Return the table for a terminal."""
        # Unescaped, rich takes a unit in brackets for a style.
        table = Table(title=escape(self.title), title_justify="left")
        for column, name in enumerate(self.names):
            grouped = bool(self.groups) and column >= self.left
            group = f"{self.groups[(column - self.left) // self.group_width]}: " if grouped else ""
            table.add_column(escape(group + name), justify="left" if column < self.left else "right", no_wrap=True)
        for line in self.lines:
            table.add_row(*(escape(str(cell)) for cell in line))
        return table

    def text(self, *, width: int = 120) -> str:
        """Return the table as plain text for a log."""
        console = Console(file=io.StringIO(), width=width, highlight=False, color_system=None)
        with console.capture() as capture:
            console.print(self.rich())
        return capture.get().rstrip("\n")

    def markdown(self) -> str:
        """Return the table in Markdown, below its title and description."""
        rows = [self.names, ("---",) * len(self.names), *self.lines]
        body = [f"| {' | '.join(map(str, row))} |" for row in rows]
        return "\n".join([f"## {self.title}", self.about, "", *body]) + "\n"


def number(value: float, digits: int = 2) -> str:
    """Format a number; a dash if it is not finite."""
    return f"{value:.{digits}f}" if np.isfinite(value) else "–"


def interval(bounds: tuple[float, float], digits: int = 2) -> str:
    """Format an interval; a dash if it is not finite."""
    low, high = bounds
    return f"[{number(low, digits)}, {number(high, digits)}]" if np.isfinite(low) and np.isfinite(high) else "–"
