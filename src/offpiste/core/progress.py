"""What a person sees: progress bars with the time left on a terminal, log messages, results on standard output."""

import logging
from collections.abc import Callable, Generator, Iterable, Iterator, Sized
from contextlib import contextmanager
from typing import Protocol, TypeVar, runtime_checkable

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


@runtime_checkable
class Track(Protocol):
    """Shows progress over items, as `track`."""

    def __call__(self, items: Iterable[Item], description: str, /) -> Iterator[Item]:
        """Yield the items."""
        ...


def track(items: Iterable[Item], description: str, *, total: int | None = None) -> Generator[Item, None, None]:
    """Yield the items, with a progress bar on standard error while it is a terminal."""
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
def jobs_bar(total: int, description: str) -> Iterator[Callable[[int, float], None]]:
    """One progress bar over jobs that run side by side; the function it gives takes a job's number and share done."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda number, share: None
        return
    done = [0.0] * total
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task(description, total=float(total))

        def update(number: int, share: float) -> None:
            done[number] = share
            progress.update(task, completed=sum(done))

        yield update


def show(result: object) -> None:
    """Print a result on standard output: a line, or anything that rich can render."""
    if isinstance(result, str):
        print(result, flush=True)  # noqa: T201
        return
    console = Console(highlight=False)
    # A pipe has no width of its own, and 80 columns would break tables.
    (console if console.is_terminal else Console(highlight=False, width=120)).print(result)


def log_to_terminal() -> None:
    """Print offpiste's log messages; without this call the library stays silent."""
    logger = logging.getLogger("offpiste")
    logger.setLevel(logging.INFO)
    logger.propagate = False
    logger.handlers = [_TerminalHandler()]


class _TerminalHandler(logging.Handler):
    """Prints messages as results are printed, so that a logged table is drawn as a table."""

    def emit(self, record: logging.LogRecord) -> None:
        drawn = hasattr(record.msg, "__rich_console__")
        prefix = f"{record.levelname.lower()}: " if record.levelno >= logging.WARNING else ""
        show(record.msg if drawn else prefix + record.getMessage())
