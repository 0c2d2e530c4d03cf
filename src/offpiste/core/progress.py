"""Progress with the time left, log messages, and results on standard output."""

import logging
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Sized
from contextlib import contextmanager
from time import monotonic
from typing import Any, Final, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

Item = TypeVar("Item")
EVERY: Final = 15.0
"""Interval of progress lines if standard error is not a terminal [s]."""
FORETOLD: Final = 0.02
"""Completed share from which on progress lines show the time left; the start of work is slower."""


Track = Callable[[Iterable[Any], str], Iterator[Any]]
"""Function like `track`."""


def _lines(description: str, total: float | None, *, in_percent: bool) -> Callable[[float], None]:
    """Return a function that prints completed work on standard error every `EVERY` seconds, for output to a file."""
    begun = due = monotonic()

    def update(done: float) -> None:
        nonlocal due
        spent = (now := monotonic()) - begun
        if now < due + EVERY:
            return
        due = now
        what = f"{done:.0f}" if total is None else f"{done:.0f} of {total:.0f} ({done / total:.0%})"
        what = f"{done / total:.0%}" if in_percent and total else what
        left = f", {spent * (total / done - 1):.0f} s left" if total and done >= FORETOLD * total else ""
        print(f"{description}: {what} after {spent:.0f} s{left}", file=sys.stderr, flush=True)  # noqa: T201

    return update


@contextmanager
def _bar(description: str, total: float | None, *, in_percent: bool = False) -> Iterator[Callable[[float], None]]:
    """Give a function that shows completed work: on a bar on a terminal, else in occasional lines."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _lines(description, total, in_percent=in_percent)
        return
    count = TaskProgressColumn() if in_percent else MofNCompleteColumn()
    columns = (TextColumn("{task.description}"), BarColumn(), count, TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task(description, total=total)
        yield lambda done: progress.update(task, completed=done)


def track(items: Iterable[Item], description: str, *, total: int | None = None) -> Generator[Item, None, None]:
    """Yield the items and show progress on standard error."""
    if total is None and isinstance(items, Sized):
        total = len(items)
    with _bar(description, total) as update:
        for done, item in enumerate(items):
            update(done)
            yield item


@contextmanager
def jobs_bar(total: int, description: str) -> Iterator[Callable[[int, float], None]]:
    """Show the progress of parallel jobs; gives a function of the number and completed share of a job."""
    shares = [0.0] * total
    with _bar(description, float(total), in_percent=True) as update:

        def report(number: int, share: float) -> None:
            shares[number] = share
            update(sum(shares))

        yield report


def show(result: object) -> None:
    """Print a line or a rich renderable on standard output."""
    if isinstance(result, str):
        print(result, flush=True)  # noqa: T201
        return
    # The default of 80 columns for a pipe would wrap tables.
    width = None if sys.stdout.isatty() else 120
    Console(highlight=False, width=width).print(result)


def log_to_terminal() -> None:
    """Print log messages of offpiste; without this call the library is silent."""
    logger = logging.getLogger("offpiste")
    logger.setLevel(logging.INFO)
    logger.propagate = False
    logger.handlers = [_TerminalHandler()]


class _TerminalHandler(logging.Handler):
    """Handler that renders logged tables."""

    def emit(self, record: logging.LogRecord) -> None:
        drawn = hasattr(record.msg, "__rich_console__")
        prefix = f"{record.levelname.lower()}: " if record.levelno >= logging.WARNING else ""
        show(record.msg if drawn else prefix + record.getMessage())
