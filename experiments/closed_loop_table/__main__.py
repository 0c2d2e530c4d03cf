"""Command line of the closed loop's table, and of its faults."""

import logging
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from experiments.closed_loop_table.drives import DEVELOPMENT, TEST, drive_all, entries, places
from experiments.closed_loop_table.table import write_table
from experiments.command import run
from offpiste.closed_loop.courses import CourseSettings
from offpiste.closed_loop.drive_course import CourseDrive
from offpiste.closed_loop.faults import KINDS, Kind
from offpiste.closed_loop.planner import load_planner
from offpiste.errors import OffpisteError
from offpiste.parallel import usable_cores

logger = logging.getLogger("experiments")


@dataclass(frozen=True)
class ClosedLoop:
    """Drive seeded courses with every run given; a result per course and planner, then table.md. Resumes."""

    runs: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN...")]
    """Run folders: parametric, b, dc, and a `df` trained on ground-truth features (the ceiling)."""
    pca: Path | None = None
    """What runs with visual features were trained with."""
    courses: int = 20
    test: bool = False
    """Courses of the test seeds (from 201) instead of those for development (from 1)."""
    out: Path = Path("closed-loop")
    seconds: float = 40.0
    speed: float = 7.0
    """Wanted along the courses [m/s]."""
    latencies: tuple[float, ...] = (0.0, 0.3)
    """Of dc and the ceiling, beside 0.1 [s]."""
    keep_logs: bool = False
    """Of every drive: 150 MB each."""
    faults: bool = False
    """Instead: each fault once, with every run given, into OUT/faults."""

    processes: int = 0
    """Courses that are driven at a time; 0: one a core."""

    def run(self) -> None:
        """Drive, write, print.

        Raises:
            OffpisteError: nothing to drive, a setting is out of range, or a drive fails.
        """
        if not self.runs:
            raise OffpisteError("no run is given", where="--runs", how="give one run folder or more")
        if self.courses < 1:
            raise OffpisteError(f"{self.courses} courses", where="--courses", how="give 1 or more")
        planners = [load_planner(run, self.pca) for run in self.runs]
        asked = CourseDrive(seconds=self.seconds, course=CourseSettings(speed=self.speed), keep_log=self.keep_logs)
        worlds = places(TEST if self.test else DEVELOPMENT, self.courses)
        drive = partial(drive_all, worlds=worlds, processes=self.processes or usable_cores())
        if not self.faults:
            results = drive(entries(planners, self.latencies), out=self.out, asked=asked)
            logger.info(write_table(results, self.out, self.seconds))
            return
        kinds: tuple[Kind, ...] = tuple(kind for kind in KINDS if kind != "none")
        for kind in kinds:
            told = replace(asked, fault=kind)
            for result in drive(entries(planners, ()), out=self.out / "faults" / kind, asked=told):
                ending = ", ".join(f"{t} s {mode}: {why}" for t, mode, why in result["modes"])
                logger.info(f"  {kind}: {ending}; at the end {result['final_speed_mps']:.1f} m/s")


if __name__ == "__main__":
    run(ClosedLoop)
