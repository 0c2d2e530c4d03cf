"""Errors that a user can cause: what is wrong, where, and how to fix it, in one line."""

from collections.abc import Callable
from functools import partial
from pathlib import Path


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
        return " ".join(f"{place}{self.what}{fix}".split())


class LogError(OffpisteError):
    """A recorded log cannot be read, or lacks what is needed of it."""


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
    """A plan cannot be made, e.g. no sampled trajectory has a finite cost."""
