"""What a person sees while they wait: bars with the time left on a terminal, lines and tables everywhere."""

import logging
from collections.abc import Callable, Iterable, Iterator, Sized
from contextlib import contextmanager
from typing import TypeVar

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


def track(items: Iterable[Item], description: str, *, total: int | None = None) -> Iterator[Item]:
    """The same items, with a bar on standard error while they are worked on."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield from items
        return
    if total is None and isinstance(items, Sized):
        total = len(items)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        yield from progress.track(items, total=total, description=description)


@contextmanager
def shares(total: int, description: str) -> Iterator[Callable[[int, float], None]]:
    """A bar over `total` jobs, done side by side; it is told the number of a job and its share that is done."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda number, share: None
        return
    done = [0.0] * total
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task(description, total=float(total))

        def show(number: int, share: float) -> None:
            done[number] = share
            progress.update(task, completed=sum(done))

        yield show


def show(result: object) -> None:
    """Print a result on standard output: a line, or anything that rich can draw."""
    if isinstance(result, str):
        print(result, flush=True)  # noqa: T201
        return
    console = Console(highlight=False)
    # A pipe has no width of its own, and 80 columns would break tables.
    (console if console.is_terminal else Console(highlight=False, width=120)).print(result)


def log_to_terminal() -> None:
    """Show what offpiste logs to the person at the terminal; without this a library stays silent."""
    logger = logging.getLogger("offpiste")
    logger.setLevel(logging.INFO)
    logger.propagate = False
    logger.handlers = [_Terminal()]


class _Terminal(logging.Handler):
    """Shows messages as results are shown, so that tables that were logged are drawn as tables."""

    def emit(self, record: logging.LogRecord) -> None:
        drawn = hasattr(record.msg, "__rich_console__")
        prefix = f"{record.levelname.lower()}: " if record.levelno >= logging.WARNING else ""
        show(record.msg if drawn else prefix + record.getMessage())
