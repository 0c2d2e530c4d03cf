"""The whole path on the proving ground: simulate, inspect, look, extract, train, judge, and drive a course."""

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from offpiste.conventions import FEATURE_SETS
from offpiste.dataset.fit_pca import fit_pca
from offpiste.dataset.image_list import write_image_list
from offpiste.dataset.make import make_dataset
from offpiste.dataset.snapshots import SnapshotSettings
from offpiste.dataset.splits import parse_split, write_drives
from offpiste.dataset.store import Dataset
from offpiste.experiments.claimed import claim_folder
from offpiste.experiments.closed_loop.courses import CourseSettings
from offpiste.experiments.closed_loop.drive_course import CourseDrive, described, drive_course
from offpiste.experiments.closed_loop.planner import load_planner
from offpiste.experiments.demo_result import tell_result
from offpiste.experiments.judge_runs import judge_runs
from offpiste.experiments.recorded import Recording, simulate_all
from offpiste.experiments.shared_stages import reuse_stages
from offpiste.logs import open_log
from offpiste.logs.checks import inspect_log, render
from offpiste.parallel import usable_cores
from offpiste.perception.backbone import open_backbone
from offpiste.perception.pca_file import save_pca
from offpiste.rig import Rig, load_rig
from offpiste.simulation.simulate import DriveSettings
from offpiste.simulation.world import WorldSettings
from offpiste.training.config import TrainConfig
from offpiste.training.train import train

MODELS = ("b", "dc")
WORLD = "mojave"
BACKBONE = "filterbank"

PCA_DRIVES = 2
"""So many drives that train are enough for the PCA."""

STEPS = 8

Tell = Callable[[object], None]


@dataclass(frozen=True)
class DemoSettings:
    """How much is simulated and trained: so little that it ends within ten minutes on two cores.

    Attributes:
        seconds: of each drive.
        epochs: passes over the training windows.
        seed: of everything.
        size, resolution: of the worlds [m].
        images: that the PCA is fitted on.
        batch: windows a step; small, so that there are some steps.
        snapshot_seconds: a window is judged at most once in so long [s].
        parts: of the drives, each in a world of its own.
        course_seconds: until the driven course ends, wherever the vehicle is.
        course_speed: wanted along it [m/s].
    """

    seconds: float = 60.0
    epochs: int = 12
    seed: int = 0
    size: float = 200.0
    resolution: float = 0.25
    images: int = 60
    batch: int = 64
    snapshot_seconds: float = 0.5
    parts: tuple[str, ...] = ("train", "train", "train", "train", "validation", "test", "test")
    course_seconds: float = 30.0
    course_speed: float = 6.0


def run_demo(out: Path, settings: DemoSettings, *, processes: int = 0, tell: Tell) -> None:
    """Make everything in `out`; what is there already from an earlier demo with the same settings is used again.

    Args:
        processes: drives that are simulated or extracted at a time; 0: one a core.

    Raises:
        OffpisteError: as the stages do; e.g. `out` holds a demo of other settings.
    """
    claim_folder(out, {"demo": asdict(settings)})
    rig, processes = load_rig("proving_ground"), processes or usable_cores()
    recordings = _recordings(out, settings)
    logs = [recording.log for recording in recordings]
    tell(
        f"1/{STEPS}  offpiste simulate: {len(logs)} drives of {settings.seconds:g} s (no real vehicle),"
        " each in a world of its own, with one camera and one LiDAR"
    )
    simulate_all(recordings, processes, tell=tell)
    tell(f"2/{STEPS}  offpiste inspect {logs[0]} --rig proving_ground")
    tell(render(inspect_log(open_log(logs[0]), rig)))
    dataset = _extracted(logs, rig, out, settings, processes, tell)
    runs = [_trained(name, dataset, out, settings, tell) for name in MODELS]
    report, named = out / "report", " ".join(map(str, runs))
    tell(f"6/{STEPS}  offpiste evaluate {named} --dataset {dataset.path} --feature-set all --out {report}")
    evaluation = judge_runs(runs, dataset.path, report, starts=("causal",), feature_sets=FEATURE_SETS)
    tell(f"7/{STEPS}  what the ground ahead is worth: dc reads its features, b does not")
    tell_result(evaluation, dataset, report, tell=tell)
    _drive(runs[-1], out, settings, tell)


def _recordings(out: Path, settings: DemoSettings) -> list[Recording]:
    """The drives; no two have the same seed."""
    found = []
    for seed in range(settings.seed, settings.seed + len(settings.parts)):
        world = WorldSettings(WORLD, seed, size=settings.size, resolution=settings.resolution)
        drive = DriveSettings(world, settings.seconds, seed, sensors="light")
        found.append(Recording(drive, out / "logs" / f"{WORLD}-{seed}.mcap"))
    return found


def _extracted(logs: list[Path], rig: Rig, out: Path, settings: DemoSettings, processes: int, tell: Tell) -> Dataset:
    """The dataset; the PCA looks at drives that train only."""
    parts, pca, path = out / "parts.txt", out / "pca.safetensors", out / "dataset.zarr"
    split = write_drives(parts, ((log.stem, part) for log, part in zip(logs, settings.parts, strict=True)))
    looked_at = [log for log, part in zip(logs, settings.parts, strict=True) if part == "train"][:PCA_DRIVES]
    names = " ".join(map(str, looked_at))
    tell(f"3/{STEPS}  offpiste fit-pca {names} --rig proving_ground --backbone {BACKBONE} --split {split} --out {pca}")
    if not pca.exists():
        fitted = fit_pca(looked_at, rig, parse_split(split), open_backbone(BACKBONE), images=settings.images, tell=tell)
        write_image_list(pca.with_suffix(".images.txt"), fitted.images)
        save_pca(pca, fitted.pca)
    tell(f"4/{STEPS}  offpiste extract {out}/logs/*.mcap --rig proving_ground --pca {pca} --split {split} --out {path}")
    kept = SnapshotSettings(settings.snapshot_seconds)
    return make_dataset(logs, rig, path, split=split, pca=pca, snapshots=kept, processes=processes, tell=tell)


def _trained(model: str, dataset: Dataset, out: Path, settings: DemoSettings, tell: Tell) -> Path:
    """The folder of a run. What is the same for all models is fitted with the first."""
    folder = out / "runs" / f"{model}-{settings.seed}"
    tell(f"5/{STEPS}  offpiste train {dataset.path} --model {model} --out {folder}")
    reuse_stages(folder.parent, folder, settings.seed)
    config = TrainConfig(
        model=model,
        epochs=settings.epochs,
        bicycle_epochs=settings.epochs,
        actuator_epochs=max(1, settings.epochs // 2),
        batch=settings.batch,
        seed=settings.seed,
    )
    if not (folder / "model.json").exists():
        train(dataset, config, folder, resume=(folder / "config.json").exists(), tell=tell)
    return folder


def _drive(run: Path, out: Path, settings: DemoSettings, tell: Tell) -> None:
    """A course in a world that no drive has been in, planned with the model."""
    folder, pca = out / "course", out / "pca.safetensors"
    seed = settings.seed + len(settings.parts)
    tell(
        f"8/{STEPS}  offpiste drive {run} --pca {pca} --world {WORLD} --seed {seed}"
        f" --seconds {settings.course_seconds:g} --speed {settings.course_speed:g} --out {folder}"
    )
    if not (folder / "result.json").exists():
        shutil.rmtree(folder, ignore_errors=True)  # what an interrupted drive left
        world = WorldSettings(WORLD, seed, size=settings.size, resolution=settings.resolution)
        course = CourseSettings(speed=settings.course_speed)
        asked = CourseDrive(world, settings.course_seconds, course=course)
        drive_course(load_planner(run, pca), asked, folder)
    tell(described(json.loads((folder / "result.json").read_text("utf-8"))))
    tell(f"picture: {folder / 'drive.png'}")
