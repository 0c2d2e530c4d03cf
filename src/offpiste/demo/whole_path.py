"""Demo of all stages on simulated drives: simulate, inspect, extract, train, evaluate, drive a course."""

import json
import logging
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path

from offpiste.closed_loop.courses import CourseSettings
from offpiste.closed_loop.drive_course import CourseDriveSettings, described, drive_course
from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.parallel import at_a_time
from offpiste.dataset.fit_pca import fit_pca, write_image_list
from offpiste.dataset.map_snapshots import SnapshotSettings
from offpiste.dataset.splits import parse_split, write_drives
from offpiste.dataset.store import Dataset
from offpiste.evaluation.evaluate_runs import evaluate_runs
from offpiste.evaluation.report import headline_texts
from offpiste.inspection.extract import extract
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.render import render
from offpiste.logs import open_log
from offpiste.perception.backbones import open_backbone
from offpiste.perception.pca import save_pca
from offpiste.reproduction.runs import reuse_stages
from offpiste.reproduction.steps import claim_folder
from offpiste.rig.rig import Rig, load_rig
from offpiste.runtime.planner import load_planner
from offpiste.simulation.simulate import DriveSettings, Recording, simulate_all
from offpiste.simulation.world.world import WorldSettings
from offpiste.training.config import TrainConfig
from offpiste.training.train import train

logger = logging.getLogger(__name__)

MODELS, WORLD, BACKBONE = ("dc", "b"), "mojave", "filterbank"
PCA_DRIVES, STEPS = 2, 8
"""Numbers of training drives for fitting the PCA, and of steps in the log."""


@dataclass(frozen=True)
class DemoSettings:
    """Settings of the demo; the defaults take ten minutes on two cores."""

    seconds: float = 60.0  # length of each drive [s]
    epochs: int = 12  # passes over the training windows
    seed: int = 0  # random seed
    size: float = 200.0  # extent of the worlds [m]
    resolution: float = 0.25  # cell size of the worlds [m]
    images: int = 60  # number of images for fitting the PCA
    batch: int = 64  # windows per step
    snapshot_seconds: float = 0.5  # shortest time between evaluated windows [s]
    # part of the split for each drive, each in its own world
    parts: tuple[str, ...] = ("train", "train", "train", "train", "validation", "test", "test")
    course_seconds: float = 30.0  # time limit of the course [s]
    course_speed: float = 6.0  # target speed [m/s]

    def world(self, seed: int) -> WorldSettings:
        """Return the settings of a world."""
        return WorldSettings(WORLD, seed, size=self.size, resolution=self.resolution)


def run_demo(out: Path, settings: DemoSettings, *, processes: int = 0) -> None:
    """Run the demo in `out`; finished steps with the same settings are reused.

    Args:
        processes: number of drives simulated or extracted in parallel; 0: one per core.

    Raises:
        OffpisteError: a stage failed, or `out` holds a demo with other settings.
    """
    claim_folder(out, {"demo": asdict(settings)})
    rig, processes = load_rig("proving_ground"), at_a_time(processes)
    seeds = range(settings.seed, settings.seed + len(settings.parts))
    logs = [out / "logs" / f"{WORLD}-{seed}.mcap" for seed in seeds]
    drives = [DriveSettings(settings.world(seed), settings.seconds, seed, sensors="light") for seed in seeds]
    logger.info(
        f"1/{STEPS}  offpiste simulate: {len(logs)} drives of {settings.seconds:g} s, each in its own world, with a"
        " camera and a LiDAR"
    )
    simulate_all(list(map(Recording, drives, logs)), processes)
    logger.info(f"2/{STEPS}  offpiste inspect {logs[0]} --rig proving_ground")
    logger.info(render(inspect_log(open_log(logs[0]), rig)))
    dataset = _extracted(logs, rig, out, settings, processes)
    runs = [_trained(name, dataset, out, settings) for name in reversed(MODELS)][::-1]
    report, named = out / "report", " ".join(map(str, runs))
    logger.info(f"6/{STEPS}  offpiste evaluate {named} --dataset {dataset.path} --feature-set all --out {report}")
    evaluation = evaluate_runs(runs, dataset.path, report, starts=("causal",), feature_sets=FEATURE_SETS)
    logger.info(f"7/{STEPS}  visual (dc) reads features of the terrain ahead, blind (b) does not:")
    for sentence in headline_texts(evaluation.metrics):
        logger.info(sentence)
    logger.info("With more driving: `offpiste reproduce fig4 --size laptop` (hours); see docs/results.md for results.")
    _drive(runs[0], out, settings)


def _extracted(logs: list[Path], rig: Rig, out: Path, settings: DemoSettings, processes: int) -> Dataset:
    """Fit the PCA on training drives and extract the dataset."""
    parts, pca, path = out / "parts.txt", out / "pca.safetensors", out / "dataset.zarr"
    split = write_drives(parts, ((log.stem, part) for log, part in zip(logs, settings.parts, strict=True)))
    pca_logs = [log for log, part in zip(logs, settings.parts, strict=True) if part == "train"][:PCA_DRIVES]
    names = " ".join(map(str, pca_logs))
    logger.info(
        f"3/{STEPS}  offpiste fit-pca {names} --rig proving_ground --backbone {BACKBONE} --split {split} --out {pca}"
    )
    if not pca.exists():
        fitted = fit_pca(pca_logs, rig, parse_split(split), open_backbone(BACKBONE), images=settings.images)
        write_image_list(pca.with_suffix(".images.txt"), fitted.images)
        save_pca(pca, fitted.pca)
    logger.info(
        f"4/{STEPS}  offpiste extract {out}/logs/*.mcap --rig proving_ground --pca {pca} --split {split} --out {path}"
    )
    kept = SnapshotSettings(settings.snapshot_seconds)
    return extract(logs, rig, path, split=split, pca=pca, snapshots=kept, processes=processes, force=True)


def _trained(model: str, dataset: Dataset, out: Path, settings: DemoSettings) -> Path:
    """Train a model and return its folder; shared stages are fitted once."""
    folder = out / "runs" / f"{model}-{settings.seed}"
    logger.info(f"5/{STEPS}  offpiste train {dataset.path} --model {model} --out {folder}")
    reuse_stages(folder.parent, folder, settings.seed)
    epochs, half = settings.epochs, max(1, settings.epochs // 2)
    shared = {"bicycle_epochs": epochs, "actuator_epochs": half, "batch": settings.batch, "seed": settings.seed}
    config = TrainConfig(model=model, epochs=epochs, **shared)
    if not (folder / "model.json").exists():
        train(dataset, config, folder, resume=(folder / "config.json").exists())
    return folder


def _drive(run: Path, out: Path, settings: DemoSettings) -> None:
    """Drive a course in a new world with the model."""
    folder, pca = out / "course", out / "pca.safetensors"
    seed = settings.seed + len(settings.parts)
    logger.info(
        f"8/{STEPS}  offpiste drive {run} --pca {pca} --world {WORLD} --seed {seed}"
        f" --seconds {settings.course_seconds:g} --speed {settings.course_speed:g} --out {folder}"
    )
    if (result := folder / "result.json").exists():
        logger.info(described(json.loads(result.read_text("utf-8"))))
    else:
        shutil.rmtree(folder, ignore_errors=True)  # left by an interrupted drive
        course = CourseSettings(speed=settings.course_speed)
        drive = CourseDriveSettings(settings.world(seed), settings.course_seconds, course=course)
        drive_course(load_planner(run, pca), drive, folder)
    logger.info(f"picture: {folder / 'drive.png'}")
