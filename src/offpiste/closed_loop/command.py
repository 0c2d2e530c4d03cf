"""The work of `offpiste drive`: drive a course with a trained run, print tables, and record it for Rerun."""

import logging
from pathlib import Path
from shlex import join
from typing import Any

from rich.table import Table

from offpiste.closed_loop.courses import CourseSettings
from offpiste.closed_loop.drive_course import CourseDriveSettings, Driven, drive_course
from offpiste.closed_loop.faults import Kind, When
from offpiste.closed_loop.planner import load_planner
from offpiste.core.errors import require
from offpiste.planning.caution import risk_of
from offpiste.planning.gpu import require_device
from offpiste.runtime.settings import RuntimeSettings
from offpiste.simulation.world.world import WorldSettings
from offpiste.uncertainty.novelty import Novelty

logger = logging.getLogger(__name__)


def run_drive(
    run: Path,
    out: Path,
    *,
    world: str,
    seed: int,
    seconds: float,
    pca: Path | None,
    course: str,
    speed: float,
    latency: float,
    risk: str,
    novelty: Novelty,
    device: str,
    against: bool,
    fault: Kind,
    fault_start: float,
    fault_when: When,
    recording: bool,
) -> Driven:
    """Drive a course with a trained run (options as in `cli.drive.Drive`), and log the outcome.

    Raises:
        OffpisteError: no such run or world, a setting out of range, or `out` holds a drive already.
    """
    if recording:
        require("view", "rerun", otherwise="leave out --recording")
    planner, caution = load_planner(run, pca, novelty=novelty, device=device), risk_of(risk)
    require_device(device, planner.dynamics)
    settings = CourseDriveSettings(
        WorldSettings(world, seed),
        seconds,
        course=CourseSettings(course, speed),
        runtime=RuntimeSettings(latency=latency, risk=caution, device=device),
        against=against,
        fault=fault,
        fault_start=fault_start,
        fault_when=fault_when,
    )
    driven = drive_course(planner, settings, out)
    logger.info(modes_table(driven.result))
    logger.info(stages_table(driven.result))
    written = ["drive.mcap", "drive.png", "result.json"]
    if recording:
        from offpiste.closed_loop.recording import record_drive

        record_drive(driven, out / "drive.rrd")
        written.append("drive.rrd")
    logger.info(f"wrote {', '.join(str(out / name) for name in written)}")
    logger.info(f"next: {join(['offpiste', 'view', str(out / 'drive.mcap'), '--rig', 'proving_ground_gear'])}")
    return driven


def modes_table(result: dict[str, Any]) -> Table:
    """Changes of mode, with time and reason."""
    table = Table(r"at \[s]", "mode", "why", title="changes of mode")
    for time, mode, why in result["modes"]:
        table.add_row(f"{time:.2f}", mode, why)
    return table


def stages_table(result: dict[str, Any]) -> Table:
    """Wall-clock times of the stages of the run time."""
    # Without a backslash, rich takes brackets for a style.
    names = ("stage", "times", r"median \[ms]", r"95 % \[ms]", r"all \[s]")
    table = Table(*names, title="what it took, by the wall clock")
    for stage, took in result["stages"].items():
        numbers = (f"{took[key]:.1f}" for key in ("median_ms", "p95_ms", "total_s"))
        table.add_row(stage, f"{took['count']:.0f}", *numbers)
    return table
