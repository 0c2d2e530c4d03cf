"""Several drives recorded side by side, each whole or not at all."""

import io
import logging
from collections.abc import Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from offpiste.cluster import engine_at
from offpiste.core.parallel import Report, run_all, within_memory
from offpiste.simulation.simulate import DriveSettings, simulate

logger = logging.getLogger(__name__)


MEMORY: Final = {"none": 0.7e9, "light": 1.3e9, "full": 1.3e9}
"""Memory of a process that records a drive, by its sensors [bytes]: the largest measured, and a third more."""


@dataclass(frozen=True)
class Recording:
    """A drive to be simulated, and the path of its log."""

    settings: DriveSettings
    log: Path


def simulate_all(recordings: Sequence[Recording], processes: int, cluster: str = "") -> None:
    """Record the drives that are not there yet, `processes` at a time, or on a Ray cluster.

    Raises:
        OffpisteError: the first failure; drives that did not fail are recorded.
    """
    missing = [recording for recording in recordings if not recording.log.exists()]
    if kept := len(recordings) - len(missing):
        logger.warning(f"{kept} of {len(recordings)} drives are there, and stay as they were recorded")
    if not cluster and missing:
        wanted = min(processes, len(missing))
        processes = within_memory(wanted, max(MEMORY.get(one.settings.sensors, 0.0) for one in missing))
    failed = run_all(_record, missing, processes, "simulate", engine=engine_at(cluster))
    if failed:
        raise failed[0]


def simulate_once(settings: DriveSettings, log: Path) -> str:
    """Record a drive unless it is there; an interrupted one has another name and is begun again.

    Returns:
        Summary of the drive.
    """
    if log.exists():
        return f"{log}: there"
    partial = log.with_name(f"{log.stem}.partial{log.suffix}")
    partial.unlink(missing_ok=True)
    driven = simulate(settings, partial)[0]
    partial.rename(log)
    return str(driven).replace(partial.name, log.name)


def _record(recording: Recording, report: Report) -> str:
    with redirect_stderr(io.StringIO()):  # a bar of its own would run into those of others
        return simulate_once(recording.settings, recording.log)
