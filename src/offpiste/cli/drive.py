"""`offpiste drive`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from offpiste.cli.entry import COMMANDS
from offpiste.core.conventions import PERCEPTION_LATENCY


@COMMANDS.register("drive")
@dataclass(frozen=True)
class Drive:
    """Drive a course on the proving ground with a trained model, in simulated time (needs the extra `sim`)."""

    run_folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
    """A folder that `train` wrote, or `pretrained:NAME`, e.g. pretrained:proving-ground/dc;
    runs on ground-truth features are given the true ground."""
    world: str = "mojave"
    """Name of a world, or a TOML file of your own; an unknown name lists those there are."""
    seed: int = 0
    """Seed of the world, the course, the noise and the sampled controls."""
    seconds: float = 40.0
    """Longest drive [s]; it ends earlier at the end of its course."""
    out: Path = Path("closed-loop")
    """Folder of drive.mcap, result.json and drive.png."""
    pca: Path | None = None
    """For runs with visual features: the file that their dataset was extracted with; shipped models have theirs."""
    course: str = "bends"
    """Kind of course: bends, choices or passages; an unknown kind lists those there are."""
    speed: float = 7.0
    """Wanted along the course [m/s]; the course is chosen for it, so another speed may have another course."""
    latency: float = PERCEPTION_LATENCY
    """From the data of a plan to its first control [s]."""
    risk: str = "none"
    """What counts in plans beside the prediction: none, spread:TIMES or cvar:SHARE, which need a spread (models that
    ship have one, others by `offpiste calibrate`)."""
    novelty: Literal["ignored", "missing"] = "ignored"
    """What novel ground, unlike any in training, is to the model; missing needs features of training's (shipped with
    models that see the ground, for others by `offpiste calibrate`)."""
    device: str = "cpu"
    """Device on which images are encoded and plans are made: cpu, or cuda (needs the extra `cuda`)."""
    against: bool = False
    """Start the vehicle against its course: it turns round first, backwards and forwards."""
    fault: Literal["none", "camera-dropped", "lidar-dropped", "late-image", "nan-features", "map-empty"] = "none"
    """Fault of the sensors."""
    fault_start: float = 10.0
    """When the fault begins [s]."""
    fault_when: Literal["time", "reversing"] = "time"
    """reversing: it begins when the vehicle first drives backwards after that."""
    recording: bool = False
    """Also write drive.rrd for the Rerun viewer (needs the extra `view`)."""

    def run(self) -> int:
        """Load, drive, evaluate, draw."""
        from offpiste.closed_loop.command import run_drive

        run_drive(
            self.run_folder,
            self.out,
            world=self.world,
            seed=self.seed,
            seconds=self.seconds,
            pca=self.pca,
            course=self.course,
            speed=self.speed,
            latency=self.latency,
            risk=self.risk,
            novelty=self.novelty,
            device=self.device,
            against=self.against,
            fault=self.fault,
            fault_start=self.fault_start,
            fault_when=self.fault_when,
            recording=self.recording,
        )
        return 0
