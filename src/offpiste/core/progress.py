"""Progress with the time left, log messages, and results on standard output."""

import logging
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Sized
from contextlib import contextmanager
from time import monotonic
from typing import Final, Protocol, TypeVar, runtime_checkable

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)

Item = TypeVar("Item")
EVERY: Final = 15.0
"""Interval of progress lines if standard error is not a terminal [s]."""
FORETOLD: Final = 0.02
"""Completed share from which on progress lines show the time left; the start of work is slower."""


@runtime_checkable
class Track(Protocol):
    """Function like `track`."""

    def __call__(self, items: Iterable[Item], description: str, /) -> Iterator[Item]:
        """Yield the items."""
        ...


class _Lines:
    """Progress lines on standard error, for output to a file."""

    def __init__(self, description: str) -> None:
        self._description, self._begun = description, monotonic()
        self._next = self._begun + EVERY

    def update(self, done: float, total: float | None, *, in_percent: bool = False) -> None:
        """Print a line every `EVERY` seconds."""
        now = monotonic()
        if now < self._next:
            return
        self._next, spent = now + EVERY, now - self._begun
        what = f"{done:.0f}" if total is None else f"{done:.0f} of {total:.0f} ({done / total:.0%})"
        what = f"{done / total:.0%}" if in_percent and total else what
        left = f", {spent * (total / done - 1):.0f} s left" if total and done >= FORETOLD * total else ""
        print(f"{self._description}: {what} after {spent:.0f} s{left}", file=sys.stderr, flush=True)  # noqa: T201


def track(items: Iterable[Item], description: str, *, total: int | None = None) -> Generator[Item, None, None]:
    """Yield the items and show progress on standard error: a bar on a terminal, else occasional lines."""
    console = Console(stderr=True)
    if total is None and isinstance(items, Sized):
        total = len(items)
    if not console.is_terminal:
        lines = _Lines(description)
        for done, item in enumerate(items):
            lines.update(done, total)
            yield item
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        yield from progress.track(items, total=total, description=description)


@contextmanager
def jobs_bar(total: int, description: str) -> Iterator[Callable[[int, float], None]]:
    """Show the progress of parallel jobs; gives a function of the number and completed share of a job."""
    console = Console(stderr=True)
    done = [0.0] * total
    if not console.is_terminal:
        lines = _Lines(description)

        def report(number: int, share: float) -> None:
            done[number] = share
            lines.update(sum(done), total, in_percent=True)

        yield report
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task(description, total=float(total))

        def update(number: int, share: float) -> None:
            done[number] = share
            progress.update(task, completed=sum(done))

        yield update


def show(result: object) -> None:
    """Print a line or a rich renderable on standard output."""
    if isinstance(result, str):
        print(result, flush=True)  # noqa: T201
        return
    console = Console(highlight=False)
    # The default of 80 columns for a pipe would wrap tables.
    (console if console.is_terminal else Console(highlight=False, width=120)).print(result)


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
