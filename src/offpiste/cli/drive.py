"""`offpiste drive`."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.cli.next_steps import next_line
from offpiste.core.conventions import PERCEPTION_LATENCY

if TYPE_CHECKING:
    from rich.table import Table

logger = logging.getLogger(__name__)


@COMMANDS.register("drive")
@dataclass(frozen=True)
class Drive:
    """Drive a course on the proving ground with a trained model, in simulated time (needs the extra `sim`)."""

    run_folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
    """Folder written by `train`, or `pretrained:NAME`, e.g. pretrained:proving-ground/dc. Runs on ground-truth features
    read the true ground."""
    world: str = "mojave"
    """Name of a world, or a TOML file; an unknown name lists the available worlds."""
    seed: int = 0
    """Seed of world, course, noise and sampled controls."""
    seconds: float = 40.0
    """Longest duration [s]; the drive ends earlier at the end of the course."""
    out: Path = Path("closed-loop")
    """Folder of drive.mcap, result.json and drive.png."""
    pca: Path | None = None
    """PCA file of the run's dataset, for models with visual features; pretrained models have their own."""
    course: str = "bends"
    """Kind of course: bends, choices or passages."""
    speed: float = 7.0
    """Target speed [m/s]; the course depends on it."""
    latency: float = PERCEPTION_LATENCY
    """Time from the data of a plan to its first control [s]."""
    risk: str = "none"
    """Treatment of uncertainty in plans: none, spread:TIMES or cvar:SHARE. The latter need a spread: of a
    pretrained model, or by `offpiste calibrate`."""
    novelty: Literal["ignored", "missing"] = "ignored"
    """Treatment of ground unlike any in training; missing hides its features from the model, and needs a memory bank:
    that of a pretrained model, or by `offpiste calibrate`."""
    device: str = "cpu"
    """Device for encoding images and planning: cpu, or cuda (needs the extra `cuda`)."""
    against: bool = False
    """Start the vehicle in the opposite direction, so that it must turn around."""
    fault: Literal["none", "camera-dropped", "lidar-dropped", "late-image", "nan-features", "map-empty"] = "none"
    """Injected sensor fault."""
    fault_start: float = 10.0
    """Start of the fault [s]."""
    fault_when: Literal["time", "reversing"] = "time"
    """Begin the fault at its start time, or when the vehicle first reverses after it."""

    def run(self) -> int:
        """Drive, and write log, figure and result."""
        from offpiste.closed_loop.courses import CourseSettings
        from offpiste.closed_loop.drive_course import CourseDriveSettings, drive_course
        from offpiste.core.progress import show
        from offpiste.planning.caution import risk_of
        from offpiste.planning.gpu import require_device
        from offpiste.runtime.planner import load_planner
        from offpiste.runtime.settings import RuntimeSettings
        from offpiste.simulation.world.world import WorldSettings

        planner = load_planner(self.run_folder, self.pca, novelty=self.novelty, device=self.device)
        risk = risk_of(self.risk)
        require_device(self.device, planner.dynamics)
        settings = CourseDriveSettings(
            WorldSettings(self.world, self.seed),
            self.seconds,
            course=CourseSettings(self.course, self.speed),
            runtime=RuntimeSettings(latency=self.latency, risk=risk, device=self.device),
            against=self.against,
            fault=self.fault,
            fault_start=self.fault_start,
            fault_when=self.fault_when,
        )
        driven = drive_course(planner, settings, self.out)
        for table in drive_tables(driven.result):
            logger.info(table)
        logger.info(f"wrote {', '.join(str(self.out / name) for name in ('drive.mcap', 'drive.png', 'result.json'))}")
        show(next_line("view", self.out / "drive.mcap", "--rig", "proving_ground_gear"))
        return 0


def drive_tables(result: dict[str, Any]) -> "tuple[Table, Table]":
    """Return tables of mode changes and of wall-clock times of the runtime's stages."""
    from rich.table import Table

    # Without a backslash, rich parses brackets as a style.
    modes = Table(r"at \[s]", "mode", "reason", title="changes of mode")
    for time, mode, why in result["modes"]:
        modes.add_row(f"{time:.2f}", mode, why)
    stages = Table("stage", "count", r"median \[ms]", r"95 % \[ms]", r"total \[s]", title="wall-clock times")
    for stage, took in result["stages"].items():
        numbers = (f"{took[key]:.1f}" for key in ("median_ms", "p95_ms", "total_s"))
        stages.add_row(stage, f"{took['count']:.0f}", *numbers)
    return modes, stages
