"""The command line: one subcommand a stage, no logic."""

import os
import sys
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from offpiste.conventions import FEATURE_SETS
from offpiste.errors import OffpisteError, RigError, RunError
from offpiste.progress import tell
from offpiste.training.config import TrainConfig

Log = Annotated[str, tyro.conf.arg(metavar="LOG")]


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
        from offpiste.experiments.demo import DemoSettings, run_demo

        run_demo(self.out, DemoSettings(self.seconds, self.epochs, self.seed), tell=tell)
        return 0


@dataclass(frozen=True)
class Simulate:
    """Record a drive on the proving ground: an off-road vehicle in a world made from a seed, as an MCAP log."""

    out: Path = Path("drive.mcap")
    """The log; twins are written beside it."""
    world: str = "mojave"
    """mojave, halter-ranch, dunes, coastal-scrub, or uniform (where looks vary and grip does not)."""
    seconds: float = 60.0
    """A drive that rolls over or gets stuck ends early."""
    seed: int = 0
    """Of the world, the driver and all noise."""
    drive_seed: int | None = None
    """Another drive in the same world."""
    sensors: Literal["full", "light", "none"] = "light"
    """Four cameras and two LiDARs; one of each, slower; or none."""
    twins: int = 0
    """Further drives with the same start and commands on other ground."""
    grip_contrast: float = 1.0
    """1: ground as tables have it; 0: all ground drives alike."""
    appearance_noise: float = 1.0
    """How far looks vary without meaning anything for grip."""
    pose_noise: float = 0.0
    """White noise of recorded positions [m]."""
    pose_drift: float = 0.0
    """Drift of recorded poses in a minute [m and degrees]."""
    extrinsic_error: float = 0.0
    """Angle between recorded and true mountings of sensors [degrees]."""
    stamp_offset: float = 0.0
    """How much too late cameras and LiDARs are stamped [ms]."""

    def run(self) -> int:
        """Make a world, drive through it, record."""
        from offpiste.simulation.imperfections import Imperfections
        from offpiste.simulation.simulate import DriveSettings, simulate
        from offpiste.simulation.world import WorldSettings

        world = WorldSettings(self.world, self.seed, self.grip_contrast, self.appearance_noise)
        flaws = Imperfections(self.pose_noise, self.pose_drift, self.extrinsic_error, self.stamp_offset)
        seed = self.seed if self.drive_seed is None else self.drive_seed
        settings = DriveSettings(world, self.seconds, seed, self.sensors, imperfections=flaws)
        simulate(settings, self.out, twins=self.twins, tell=tell)
        return 0


@dataclass(frozen=True)
class Inspect:
    """What a careful engineer would find out first about a log; exit code 1 if it is unusable for training."""

    log: tyro.conf.Positional[str]
    """A .bag, .mcap, .db3, .csv, .parquet, a ROS 2 bag folder or a TartanDrive 2 folder."""
    rig: str | None = None
    """A preset's name or a rig file; without one, the log is judged by what it shows."""
    write_rig: Path | None = None
    """Write a first rig for this log to a new file."""
    json: bool = False
    """Print findings for machines."""

    def run(self) -> int:
        """Inspect, print, judge."""
        from json import dumps

        from offpiste.files import write_text
        from offpiste.logs import open_log
        from offpiste.logs.checks import draft_rig, inspect_log, missing, render
        from offpiste.rig import Clock, load_rig

        rig = load_rig(self.rig) if self.rig else None
        clock = rig.clock if rig else Clock()
        log = open_log(self.log, clock_column=clock.column, clock_unit=clock.unit)
        if self.write_rig and self.write_rig.exists():
            raise RigError("is there already", where=self.write_rig, how="give --write-rig a new name")
        if self.write_rig:
            drafted = draft_rig(log)
            write_text(self.write_rig, drafted)
            for line in (f"wrote {self.write_rig}", *(f"  missing: {what}" for what in missing(drafted))):
                print(line, file=sys.stderr)  # noqa: T201
        inspection = inspect_log(log, rig)
        if rig is not None and inspection.usable:
            from offpiste.perception.checks import check_sensors

            inspection = inspection.with_findings(check_sensors(log, rig))
        tell(dumps(inspection.as_dict(), indent=2) if self.json else render(inspection))
        return 0 if inspection.usable else 1


@dataclass(frozen=True)
class View:
    """Look at a log or a dataset: pictures, a Rerun recording of a log, and the report of a dataset's features."""

    path: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="LOG|DATASET")]
    """A drive with LiDARs, or what `extract` wrote."""
    rig: str | None = None
    """Of a log: a preset's name or a rig file."""
    pca: Path | None = None
    """Of a log: a file that `fit-pca` wrote; without one there are no features, and ground is grey."""
    out: Path = Path("view")
    """Folder of the pictures."""
    seconds: str = ""
    """Of a log: a stretch A:B, A: or :B, in seconds after the first pose."""
    rrd: bool = True
    """Of a log: also write drive.rrd for the Rerun viewer (needs the extra `view`)."""
    device: str = "cpu"
    """Where the backbone runs."""

    def run(self) -> int:
        """Play back or open, draw, write."""
        from offpiste.viewing.view import view

        written = view(
            self.path,
            self.out,
            rig=self.rig,
            pca=self.pca,
            seconds=self.seconds,
            rrd=self.rrd,
            device=self.device,
            tell=tell,
        )
        tell(f"wrote {', '.join(map(str, written))}")
        return 0


@dataclass(frozen=True)
class Extract:
    """Bring logs to 50 Hz, split them once, and write a dataset."""

    logs: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="LOG...")]
    """Logs of one vehicle."""
    rig: str
    """A preset's name or a rig file."""
    out: Path
    """The dataset, e.g. dataset.zarr; drives that it holds already are kept."""
    split: str = "blocks:0.7,0.1,0.2"
    """blocks:TRAIN,VALIDATION,TEST by time, fold:K/N, places:METRES, or drives:FILE."""
    features: Literal["none", "ground-truth", "ground-kind"] = "none"
    """What is known of the ground under the wheels. `ground-truth`: a simulator's friction and resistance, for oracles;
    `ground-kind`: what the ground is of."""
    pca: Path | None = None
    """Visual features: a file that `fit-pca` wrote. The log needs cameras and LiDARs, and the rig must name them."""
    device: str = "cpu"
    """Where the backbone runs."""
    frame_metres: float = 0.5
    """An image is looked at when its camera has come so far since the last one [m]; 0 looks at all."""
    min_hindsight: float = 0.5
    """Windows of which a smaller share of the ground was ever seen are left out; 0 keeps all."""
    snapshot_seconds: float = 0.5
    """The map is kept for windows that validate and test, at most once in so long [s]."""
    processes: int = 0
    """Drives extracted at a time; 0: one a core, or one where the backbone runs on a GPU."""
    flat: bool = False
    """Leave out the slope of the driven path: all ground is flat (an ablation)."""

    def run(self) -> int:
        """Read, resample, write."""
        from offpiste.dataset.make import make_dataset
        from offpiste.dataset.snapshots import SnapshotSettings
        from offpiste.mapping.replay import ReplaySettings
        from offpiste.rig import load_rig

        rig = load_rig(self.rig)
        make_dataset(
            self.logs,
            rig.without_slope() if self.flat else rig,
            self.out,
            split=self.split,
            features=self.features,
            pca=self.pca,
            device=self.device,
            min_hindsight=self.min_hindsight,
            snapshots=SnapshotSettings(self.snapshot_seconds),
            replay=ReplaySettings(self.frame_metres),
            processes=self.processes,
            tell=tell,
        )
        return 0


@dataclass(frozen=True)
class FitPca:
    """Fit the PCA of patch features on images of the training stretches of logs."""

    logs: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="LOG...")]
    """Logs with cameras and LiDARs."""
    rig: str
    """A preset's name or a rig file."""
    out: Path = Path("pca.safetensors")
    """The file to write."""
    split: str = "blocks:0.7,0.1,0.2"
    """As `extract` will be told: nothing outside of the training part is looked at."""
    backbone: str = "facebook/dinov2-small"
    """A ViT by name or folder, or `filterbank`: colours and edges, without weights or download."""
    images: int | Path = 175
    """How many are looked at, chosen for diversity of ground and light; or a file that lists them, such as the
    .images.txt that is written beside the PCA."""
    components: int = 40
    """How many are kept."""
    seed: int = 0
    device: str = "cpu"

    def run(self) -> int:
        """Choose, look, fit, write."""
        from offpiste.dataset.fit_pca import fit_pca
        from offpiste.dataset.image_list import read_image_list, write_image_list
        from offpiste.dataset.splits import parse_split
        from offpiste.perception.backbone import open_backbone
        from offpiste.perception.pca_file import save_pca
        from offpiste.rig import load_rig

        images = read_image_list(self.images) if isinstance(self.images, Path) else self.images
        fitted = fit_pca(
            self.logs,
            load_rig(self.rig),
            parse_split(self.split),
            open_backbone(self.backbone, device=self.device),
            images=images,
            components=self.components,
            seed=self.seed,
            tell=tell,
        )
        pca = fitted.pca
        save_pca(self.out, pca)
        write_image_list(self.out.with_suffix(".images.txt"), fitted.images)
        tell(f"{self.out}: {pca.components} components, {pca.variance.sum() / pca.total_variance:.1%} of the variance")
        return 0


@dataclass(frozen=True)
class Train:
    """Train a model on a dataset."""

    dataset: tyro.conf.Positional[Path]
    out: Path
    """Folder of the run."""
    train: Annotated[TrainConfig, tyro.conf.arg(name="")] = field(default_factory=TrainConfig)
    resume: bool = False
    """Go on after the last whole epoch of an interrupted run."""
    folds: int = 0
    """Blocked cross-validation: that many runs in OUT/fold-K, each with its own split, everything fitted anew."""
    tensorboard: bool = False
    """Also write TensorBoard files (needs the extra `tensorboard`)."""
    ddp: bool = False
    """One of several processes: `torchrun --nproc-per-node 2 -m offpiste train ... --ddp`. The batch is shared out."""

    def run(self) -> int:
        """Open, train, save."""
        from offpiste.dataset.store import open_dataset
        from offpiste.training.folds import train_folds
        from offpiste.training.processes import ALONE, joined
        from offpiste.training.train import train

        dataset = open_dataset(self.dataset)
        if self.folds:
            if self.ddp:
                raise RunError("--folds and --ddp do not go together", how="train the folds one after the other")
            train_folds(dataset, self.train, self.out, folds=self.folds, resume=self.resume, tell=tell)
            return 0
        with joined(self.train.device) if self.ddp else nullcontext(ALONE) as group:
            train(
                dataset,
                self.train,
                self.out,
                resume=self.resume,
                tensorboard=self.tensorboard,
                group=group,
                tell=tell,
            )
        return 0


@dataclass(frozen=True)
class Evaluate:
    """Judge runs on the test part of a dataset; writes metrics.json, pictures and report.html."""

    runs: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="RUN...")]
    """Run folders; a folder of folds counts as its folds."""
    dataset: Path
    """The dataset they were trained on, or another one."""
    out: Path = Path("report")
    """Folder of the report."""
    lookup: Literal["recorded", "map", "both"] = "both"
    """Where models read the ground: under the recorded wheels, or where they predict to be, as a planner does."""
    feature_set: Literal["hindsight", "-20", "-10", "0", "10", "20", "30", "40", "all"] = "hindsight"
    """Views that are read at recorded places: from how far ahead [m], or the last there were."""
    device: str = "cpu"

    def run(self) -> int:
        """Load, judge, report."""
        from offpiste.experiments.judge_runs import judge_runs

        lookups: tuple[Literal["recorded", "map"], ...] = ("recorded", "map")
        judge_runs(
            self.runs,
            self.dataset,
            self.out,
            lookups=lookups if self.lookup == "both" else (self.lookup,),
            feature_sets=FEATURE_SETS if self.feature_set == "all" else (self.feature_set,),
            device=self.device,
            tell=tell,
        )
        return 0


@dataclass(frozen=True)
class Reproduce:
    """The paper's figures: takes or simulates drives, trains, judges and draws; goes on where it stopped."""

    figure: tyro.conf.Positional[Literal["fig3", "fig4"]]
    """fig3: what features are worth in hindsight; fig4: with the distance they were seen from."""
    size: Literal["smoke", "laptop", "paper"] = "smoke"
    """Ten minutes, two hours, or as much as in the paper."""
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
        from offpiste.experiments.reproduce.reproduce import reproduce
        from offpiste.experiments.reproduce.settings import SIZES, Reproduction

        asked = Reproduction(
            self.figure,
            SIZES[self.size],
            self.out,
            dataset=self.dataset,
            backbone=self.backbone,
            split=self.split,
            contrast=self.grip_contrast,
            device=self.device,
            processes=self.processes,
        )
        reproduce(asked, tell=tell)
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
    """Wanted along the course [m/s]."""
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
        from offpiste.experiments.closed_loop.command import drive_and_show

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
            tell=tell,
        )
        return 0


COMMANDS: dict[str, Callable[..., Any]] = {
    "demo": Demo,
    "simulate": Simulate,
    "inspect": Inspect,
    "fit-pca": FitPca,
    "view": View,
    "extract": Extract,
    "train": Train,
    "evaluate": Evaluate,
    "reproduce": Reproduce,
    "drive": Drive,
}


def main(arguments: list[str] | None = None) -> None:
    """Run one command: exit 0 when done, 1 when the input or the run failed (one line on stderr), 2 on wrong usage."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in arguments
    arguments = [a for a in arguments if a != "--debug"]
    try:
        command = tyro.extras.subcommand_cli_from_dict(
            COMMANDS,
            prog="offpiste",
            description="Learns how an off-road vehicle will move on the ground ahead. --debug shows tracebacks.",
            args=arguments,
            config=(tyro.conf.FlagCreatePairsOff,),
        )
        sys.exit(command.run())
    except OffpisteError as error:
        if debug:
            raise
        print(f"offpiste: {error}", file=sys.stderr)  # noqa: T201
        sys.exit(1)
    except KeyboardInterrupt:
        print("offpiste: interrupted; what was finished is kept", file=sys.stderr)  # noqa: T201
        sys.exit(1)
    except BrokenPipeError:
        # Whoever read what was printed has stopped, e.g. `head`; Python would complain when it flushes at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
