"""Closed loop: planners compared on many courses, or under faults of their sensors."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from experiments.closed_loop_table.cards import write_driving
from experiments.closed_loop_table.drives import DEVELOPMENT, TEST, drive_all, entries, places
from experiments.closed_loop_table.faults import drive_faults
from experiments.closed_loop_table.table import write_table
from experiments.command import run
from offpiste.closed_loop.courses import KINDS as KINDS_OF_COURSE
from offpiste.closed_loop.courses import CourseSettings
from offpiste.closed_loop.drive_course import CourseDriveSettings
from offpiste.core.errors import OffpisteError
from offpiste.core.machine import usable_cores
from offpiste.runtime.planner import load_planner

logger = logging.getLogger("experiments")


@dataclass(frozen=True)
class ClosedLoop:
    """Drive seeded courses with every given run: a result per course and planner, then a table. Resumes."""

    runs: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN...")]
    """Run folders, one or more seeds each: parametric, b, dc, and a `df` on ground-truth features (the ceiling)."""
    pca: Path | None = None
    """PCA of runs with visual features."""
    courses: int = 60
    """Number of courses."""
    kinds: tuple[str, ...] = ("bends", "choices", "passages")
    """Kinds of courses, in turn."""
    test: bool = False
    """Courses of the test seeds (from 646; those before are used up) instead of those for development (from 1)."""
    out: Path = Path("closed-loop")
    """Folder of all outputs."""
    seconds: float = 60.0
    """Longest duration of a drive [s]."""
    speed: float = 7.0
    """Target speed along the courses [m/s]."""
    latencies: tuple[float, ...] = (0.0, 0.3)
    """Latencies of the first dc and the first ceiling, beside 0.1 [s]."""
    risks: tuple[str, ...] = ()
    """What counts in plans beside the prediction (spread:TIMES or cvar:SHARE), as rows of their own for the runs that
    have a spread."""
    keep_logs: bool = False
    """Keep the log of every drive: 150 MB each."""
    cards: bool = False
    """Write the driven cost against that of `b` into the cards of the runs that have one: models that ship."""
    faults: bool = False
    """Instead, drive each sensor fault once with every given run, while driving, standing and in reverse, into
    OUT/faults."""
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
        for kind in self.kinds:
            KINDS_OF_COURSE[kind]  # complains itself
        if not self.kinds:
            raise OffpisteError("no kind of course", where="--kinds", how=f"give {', '.join(KINDS_OF_COURSE)}")
        planners = [load_planner(run, self.pca) for run in self.runs]
        settings = CourseDriveSettings(
            seconds=self.seconds,
            course=CourseSettings(speed=self.speed),
            keep_log=self.keep_logs,
        )
        rows = entries(planners, self.latencies, self.risks)
        worlds = places(TEST if self.test else DEVELOPMENT, self.courses, self.kinds)
        processes = self.processes or usable_cores()
        if self.faults:
            logger.info(drive_faults(planners, worlds, self.out, settings, processes=processes))
            return
        results = drive_all(rows, worlds, self.out, settings, processes=processes)
        logger.info(write_table(results, self.out, self.seconds))
        if self.cards:
            write_driving(planners, results, self.seconds)


if __name__ == "__main__":
    run(ClosedLoop)
