"""Commands that need every stage: the demo, the paper's figures, a driven course."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class Demo:
    """The whole path on simulated drives with camera and LiDAR; ends with `b` against `dc`, and a course driven."""

    out: Path = Path("demo")
    """Folder for everything that it makes."""
    seconds: float = 60.0
    """Length of each of seven drives."""
    epochs: int = 12
    """Passes over the training windows."""
    seed: int = 0

    def run(self) -> int:
        """Simulate, inspect, look, extract, train, judge, drive."""
        from offpiste.demo import DemoSettings, run_demo

        run_demo(self.out, DemoSettings(self.seconds, self.epochs, self.seed))
        return 0


@dataclass(frozen=True)
class Reproduce:
    """The paper's figures: takes or simulates drives, trains, judges and draws; goes on where it stopped."""

    figure: tyro.conf.Positional[Literal["fig3", "fig4"]]
    """fig3: what features are worth in hindsight; fig4: with the distance they were seen from."""
    size: Literal["smoke", "laptop", "paper"] = "smoke"
    """Ten minutes, two hours, or as much as in the paper."""
    seconds: tuple[float, float, float] | None = None
    """Instead of the size's: of driving to train, validate and test on [s]."""
    seeds: int | None = None
    """Instead of the size's: runs of `b`, `cf` and `dc`."""
    out: Path = Path("results")
    """Folder for everything; both figures share it."""
    dataset: Path | None = None
    """With visual features: taken instead of simulating."""
    backbone: str = "filterbank"
    """As in `fit-pca`."""
    split: Literal["drives", "blocks"] = "drives"
    """Test on drives in worlds of their own, or on stretches of the same logs, as the paper does."""
    grip_contrast: float = 1.0
    """Of the simulated worlds: 0: all ground drives alike."""
    device: str = "cpu"
    processes: int = 0
    """Drives simulated or extracted, and runs trained or judged, at a time; 0: one a core."""

    def run(self) -> int:
        """Drive, extract, train, judge, draw."""
        from offpiste.reproduction.reproduce import reproduce
        from offpiste.reproduction.settings import Reproduction, sized

        asked = Reproduction(
            self.figure,
            sized(self.size, self.seconds, self.seeds),
            self.out,
            dataset=self.dataset,
            backbone=self.backbone,
            split=self.split,
            contrast=self.grip_contrast,
            device=self.device,
            processes=self.processes,
        )
        reproduce(asked)
        return 0


@dataclass(frozen=True)
class Drive:
    """Drive a course on the proving ground by the planner, with a trained model; simulated time, so a seed repeats."""

    run_folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
    """A folder that `train` wrote; trained on ground-truth features, it is told the ground's true properties."""
    world: str = "mojave"
    """mojave, halter-ranch, dunes or coastal-scrub."""
    seed: int = 0
    """Of the world, the course, the noise and the sampled controls."""
    seconds: float = 40.0
    """The drive ends then, or at the end of its course."""
    out: Path = Path("closed-loop")
    """Folder of drive.mcap, result.json and drive.png."""
    pca: Path | None = None
    """Of runs with visual features: the file that their dataset was extracted with."""
    speed: float = 7.0
    """Wanted along the course [m/s]; the course is chosen for it, so another speed may have another course."""
    latency: float = 0.1
    """From the data of a plan to its first control [s]."""
    fault: Literal["none", "camera-dropped", "lidar-dropped", "late-image", "nan-features", "map-empty"] = "none"
    """What goes wrong with the sensors."""
    fault_start: float = 10.0
    """When it does [s]."""
    recording: bool = False
    """Also write drive.rrd for the Rerun viewer (needs the extra `view`)."""

    def run(self) -> int:
        """Load, drive, judge, draw."""
        from offpiste.closed_loop.command import drive_and_show

        drive_and_show(
            self.run_folder,
            self.out,
            world=self.world,
            seed=self.seed,
            seconds=self.seconds,
            pca=self.pca,
            speed=self.speed,
            latency=self.latency,
            fault=self.fault,
            fault_start=self.fault_start,
            recording=self.recording,
        )
        return 0
