"""Errors that a user can cause, as one line with fault, location and fix; missing extras."""

import copyreg
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

_LONGEST: Final = 600
"""Longest message [characters]; names in damaged files may have any length."""


class OffpisteError(Exception):
    """Base of errors that a user can cause; the command line prints them as one line and exits with 1.

    Args:
        what: fault, without a full stop.
        where: file, topic, row or key at fault.
        how: fix.
    """

    def __init__(self, what: str, *, where: str | Path = "", how: str = "") -> None:
        self.what, self.where, self.how = what, str(where), how
        super().__init__(what, where, how)

    def __reduce__(self) -> tuple[Any, ...]:
        return copyreg.__newobj__, (type(self), *self.args), vars(self)  # type: ignore[attr-defined]

    def __str__(self) -> str:
        text = (f"{self.where}: " if self.where else "") + self.what + (f"; {self.how}" if self.how else "")
        line = "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in " ".join(text.split()))
        return line if len(line) <= _LONGEST else f"{line[: _LONGEST * 3 // 4]} … {line[-_LONGEST // 5 :]}"


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return "did you mean 'dart'? " with the known name of the most similar spelling; "" if none is similar."""
    near = get_close_matches(name, tuple(known), n=1)
    return f"did you mean '{near[0]}'? " if near else ""


class LogError(OffpisteError):
    """A log cannot be read, or lacks required data."""


class SeveralLogs(LogError):
    """A folder contains several logs.

    Attributes:
        logs, others: names of the logs, and of everything else in the folder.
    """

    def __init__(
        self, what: str, *, where: str | Path = "", how: str = "", logs: Sequence[str] = (), others: Sequence[str] = ()
    ) -> None:
        super().__init__(what, where=where, how=how)
        self.logs, self.others = logs, others


class TooLarge(LogError):
    """A damaged or crafted file needs more memory than `core.limits` allows."""


class NoClock(LogError):
    """A table has no column of stamps, or lacks the requested one."""


class RigError(OffpisteError):
    """A rig is invalid, or does not fit the log."""


class DatasetError(OffpisteError):
    """A dataset is missing, incomplete, or does not fit its use."""


class RunError(OffpisteError):
    """A training run is missing, damaged, or does not fit the dataset or vehicle."""


class TrainingError(OffpisteError):
    """Training cannot continue, e.g. because a value is not finite."""


class PerceptionError(OffpisteError):
    """An image, calibration, mask or backbone is invalid, missing or unsuitable."""


class MapError(OffpisteError):
    """The settings of a map are invalid."""


class PlanningError(OffpisteError):
    """Planning is impossible, e.g. because of its settings."""


class NoPlan(PlanningError):
    """No sampled trajectory of this plan has a finite cost; the next plan may succeed."""


class CourseError(OffpisteError):
    """No trail of a world contains a course of the requested kind."""


class TransportError(OffpisteError):
    """A robot cannot be reached, or a message type is unknown."""


class LiveError(OffpisteError):
    """Messages, course, limits or processes of a live drive are missing or invalid."""


class MissingExtra(OffpisteError):
    """A package of an extra is not installed."""


@contextmanager
def extra(name: str, *, otherwise: str = "") -> Iterator[None]:
    """Turn a failed import of an extra's packages into `MissingExtra`, which names an alternative (`otherwise`)."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise missing(name, error.name or "a package", otherwise) from error


def require(name: str, module: str, *, otherwise: str = "") -> None:
    """Raise `MissingExtra` unless `module` of an extra is installed, before long work that needs it at the end."""
    if not is_installed(module):
        raise missing(name, module, otherwise)


def is_installed(module: str) -> bool:
    """Return whether a top-level module is installed."""
    return find_spec(module) is not None


def installation_of(name: str) -> str:
    """Return the command that installs an extra; offpiste is not on a package index."""
    return f"in the checkout of offpiste: pip install '.[{name}]'"


def missing(name: str, module: str, otherwise: str = "") -> MissingExtra:
    """Return the error for an extra that is not installed."""
    how = installation_of(name) + (f", or {otherwise}" if otherwise else "")
    return MissingExtra(f"this needs the extra '{name}' ({module} is not installed)", how=how)
