"""Closed loop: planners compared on many courses, or under faults of their sensors."""

import logging
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from experiments.closed_loop_table.cards import write_driving
from experiments.closed_loop_table.drives import DEVELOPMENT, TEST, drive_all, entries, places
from experiments.closed_loop_table.table import write_table
from experiments.command import run
from offpiste.closed_loop.courses import CourseSettings
from offpiste.closed_loop.drive_course import CourseDriveSettings
from offpiste.closed_loop.faults import KINDS, Kind
from offpiste.closed_loop.planner import load_planner
from offpiste.errors import OffpisteError
from offpiste.parallel import usable_cores
from offpiste.planning.caution import risk_of
from offpiste.runtime.settings import RuntimeSettings

logger = logging.getLogger("experiments")


@dataclass(frozen=True)
class ClosedLoop:
    """Drive seeded courses with every given run: a result per course and planner, then table.md. Resumes."""

    runs: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN...")]
    """Run folders, one or more seeds each: parametric, b, dc, and a `df` on ground-truth features (the ceiling)."""
    pca: Path | None = None
    """PCA of runs with visual features."""
    courses: int = 20
    """Number of courses."""
    test: bool = False
    """Courses of the test seeds (from 201) instead of those for development (from 1)."""
    out: Path = Path("closed-loop")
    """Folder of all outputs."""
    seconds: float = 40.0
    """Longest duration of a drive [s]."""
    speed: float = 7.0
    """Target speed along the courses [m/s]."""
    latencies: tuple[float, ...] = (0.0, 0.3)
    """Latencies of the first dc and the first ceiling, beside 0.1 [s]."""
    risk: str = "none"
    """What counts in plans beside the prediction: none, spread:TIMES or cvar:SHARE; all runs then need a spread."""
    keep_logs: bool = False
    """Keep the log of every drive: 150 MB each."""
    cards: bool = False
    """Write the driven cost against that of `b` into the cards of the runs that have one: models that ship."""
    faults: bool = False
    """Instead, drive each sensor fault once with every given run, into OUT/faults."""

    processes: int = 0
    """Number of courses at a time; 0: one per core."""

    def run(self) -> None:
        """Drive, write and show the table.

        Raises:
            OffpisteError: nothing to drive, a setting is out of range, or a drive fails.
        """
        if not self.runs:
            raise OffpisteError("no run is given", where="--runs", how="give one run folder or more")
        if self.courses < 1:
            raise OffpisteError(f"{self.courses} courses", where="--courses", how="give 1 or more")
        planners = [load_planner(run, self.pca) for run in self.runs]
        settings = CourseDriveSettings(
            seconds=self.seconds,
            course=CourseSettings(speed=self.speed),
            runtime=RuntimeSettings(risk=risk_of(self.risk)),
            keep_log=self.keep_logs,
        )
        worlds = places(TEST if self.test else DEVELOPMENT, self.courses)
        drive = partial(drive_all, worlds=worlds, processes=self.processes or usable_cores())
        if not self.faults:
            results = drive(entries(planners, self.latencies), out=self.out, settings=settings)
            logger.info(write_table(results, self.out, self.seconds))
            if self.cards:
                write_driving(planners, results, self.seconds)
            return
        kinds: tuple[Kind, ...] = tuple(kind for kind in KINDS if kind != "none")
        for kind in kinds:
            faulty = replace(settings, fault=kind)
            for result in drive(entries(planners, ()), out=self.out / "faults" / kind, settings=faulty):
                ending = ", ".join(f"{t} s {mode}: {why}" for t, mode, why in result["modes"])
                logger.info(f"  {kind}: {ending}; at the end {result['final_speed_mps']:.1f} m/s")


if __name__ == "__main__":
    run(ClosedLoop)
