"""Errors that a user can cause: what is wrong, where, and how to fix it, in one line; missing extras."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Final

_LONGEST: Final = 600
"""Longest message [characters]: a damaged file may hold a name of any length."""


class OffpisteError(Exception):
    """Base of every error that a user can cause; the command line prints it as one line and exits with 1.

    Args:
        what: what is wrong, without a full stop.
        where: the file, topic, row or key at fault.
        how: how to fix it.
    """

    def __init__(self, what: str, *, where: str | Path = "", how: str = "") -> None:
        self.what, self.where, self.how = what, str(where), how
        super().__init__(what, where, how)

    def __reduce__(self) -> tuple[Callable[[str], "OffpisteError"], tuple[str]]:
        return partial(type(self), where=self.where, how=self.how), (self.what,)

    def __str__(self) -> str:
        place = f"{self.where}: " if self.where else ""
        fix = f"; {self.how}" if self.how else ""
        return _one_line(f"{place}{self.what}{fix}")


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """A question that names what is spelled alike, to begin a remedy with: "did you mean 'dart'? "; "" for nothing."""
    near = get_close_matches(name, tuple(known), n=1)
    return f"did you mean '{near[0]}'? " if near else ""


def _one_line(text: str) -> str:
    """A text as one line of a terminal, whatever it quotes: no control characters, and not longer than `_LONGEST`."""
    line = "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in " ".join(text.split()))
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST * 3 // 4]} … {line[-_LONGEST // 5 :]}"


class LogError(OffpisteError):
    """A recorded log cannot be read, or lacks what is needed of it."""


class SeveralLogs(LogError):
    """A folder holds several recordings, each of which is a log.

    Attributes:
        logs, others: names of the recordings, and of everything else in the folder.
    """

    def __init__(
        self, what: str, *, where: str | Path = "", how: str = "", logs: Sequence[str] = (), others: Sequence[str] = ()
    ) -> None:
        super().__init__(what, where=where, how=how)
        self.logs, self.others = logs, others

    def __reduce__(self) -> tuple[Callable[[str], OffpisteError], tuple[str]]:
        make = partial(SeveralLogs, where=self.where, how=self.how, logs=self.logs, others=self.others)
        return make, (self.what,)


class TooLarge(LogError):
    """A file asks for more memory than anything of its kind needs (`core.limits`): it is damaged, or crafted."""


class NoClock(LogError):
    """A table has no column of stamps, or not the one that is asked for."""


class RigError(OffpisteError):
    """A rig file is wrong, or does not fit the log."""


class DatasetError(OffpisteError):
    """A dataset is missing, incomplete, or does not fit what reads it."""


class RunError(OffpisteError):
    """A training run is missing, broken, or does not fit the dataset or the vehicle it is used with."""


class TrainingError(OffpisteError):
    """Training cannot continue, e.g. a value that is not finite."""


class PerceptionError(OffpisteError):
    """An image, a calibration, a mask or a backbone is wrong or missing, or does not fit what it is used with."""


class MapError(OffpisteError):
    """A map's settings make no sense."""


class PlanningError(OffpisteError):
    """Plans cannot be made, e.g. with such settings."""


class NoPlan(PlanningError):
    """No plan can be made this time: no sampled trajectory has a finite cost. The next one may have."""


class CourseError(OffpisteError):
    """No stretch of a world's trails makes a course of the wanted kind."""


class TransportError(OffpisteError):
    """A robot cannot be reached, or a message type is not known."""


class LiveError(OffpisteError):
    """What is needed to drive a vehicle is missing or wrong: its messages, a course, limits, a process."""


class MissingExtra(OffpisteError):
    """A package that only an extra installs is not there."""


@contextmanager
def extra(name: str, *, otherwise: str = "") -> Iterator[None]:
    """Context for the imports of an extra's packages.

    Args:
        name: the extra in pyproject.toml.
        otherwise: what to do instead of installing it.

    Raises:
        MissingExtra: a package imported inside is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise missing(name, error.name or "a package", otherwise) from error


def require(name: str, module: str, *, otherwise: str = "") -> None:
    """Check that an extra is installed, before work that needs it at the end.

    Raises:
        MissingExtra: `module`, which the extra installs, is not there.
    """
    if not is_installed(module):
        raise missing(name, module, otherwise)


def is_installed(module: str) -> bool:
    """Whether a top-level module can be imported."""
    return find_spec(module) is not None


def installation_of(name: str) -> str:
    """Return how to install an extra. offpiste is on no package index, where anybody could take its name."""
    return f"in the checkout of offpiste: pip install '.[{name}]'"


def missing(name: str, module: str, otherwise: str = "") -> MissingExtra:
    """The error for an extra that is not installed."""
    how = installation_of(name) + (f", or {otherwise}" if otherwise else "")
    return MissingExtra(f"this needs the extra '{name}' ({module} is not installed)", how=how)
