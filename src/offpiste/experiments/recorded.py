"""Simulated drives that an experiment needs, made once, several at a time."""

import io
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass
from pathlib import Path

from offpiste.parallel import Report, run_all
from offpiste.simulation.simulate import DriveSettings, simulate


@dataclass(frozen=True)
class PlannedDrive:
    """A drive to be simulated.

    Attributes:
        part: that it is for; empty where each drive is cut into all of them.
    """

    settings: DriveSettings
    part: str

    @property
    def name(self) -> str:
        """World and seed."""
        return f"{self.settings.world.preset}-{self.settings.seed}"


@dataclass(frozen=True)
class Recording:
    """A drive, and the log that it is recorded to."""

    settings: DriveSettings
    log: Path


def simulate_all(recordings: Sequence[Recording], processes: int, *, tell: Callable[[str], None]) -> None:
    """Record the drives that are not there yet, `processes` at a time.

    Raises:
        OffpisteError: why the first of those failed that did; the others are recorded.
    """
    missing = [recording for recording in recordings if not recording.log.exists()]
    failed = run_all(_record, missing, processes, "simulate", tell)
    if failed:
        raise failed[0]


def simulate_once(settings: DriveSettings, log: Path, *, tell: Callable[[str], None]) -> None:
    """Record a drive unless it is there; what an interruption leaves has another name and is begun again."""
    if log.exists():
        return
    partial = log.with_name(f"{log.stem}.partial{log.suffix}")
    partial.unlink(missing_ok=True)
    driven = simulate(settings, partial)[0]
    partial.rename(log)
    tell(str(driven).replace(partial.name, log.name))


def _record(recording: Recording, report: Report) -> str:
    said: list[str] = []
    with redirect_stderr(io.StringIO()):  # a bar of its own would run into those of others
        simulate_once(recording.settings, recording.log, tell=said.append)
    return "; ".join(said) or f"{recording.log}: there"
