"""Demo of shipped models in a new world: `offpiste demo`.

A vehicle with a camera and a LiDAR is driven for some seconds. Every half second, the blind model (`b`) and the visual
model (`dc`) predict the next 5 s on the map of that time. Then each model drives the same course.
"""

import io
import json
import logging
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextlib import redirect_stderr
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

from offpiste.closed_loop.courses import CourseSettings
from offpiste.closed_loop.drive_course import CourseDriveSettings, drive_course
from offpiste.core.files import write_text
from offpiste.core.parallel import Report, at_a_time, run_all
from offpiste.core.shipped import PREFIX, run_folder
from offpiste.dataset.map_snapshots import SnapshotSettings
from offpiste.dataset.splits import write_drives
from offpiste.dataset.store import drive_names, open_dataset
from offpiste.demo.comparison import NAMES, closing_words, comparison_table, demo_picture, ending, predict
from offpiste.inspection.extract import extract
from offpiste.logs import read_drive
from offpiste.report.figure import write_png
from offpiste.reproduction.steps import claim_folder
from offpiste.rig.rig import load_rig
from offpiste.runtime.planner import load_planner
from offpiste.simulation.simulate import DriveSettings, simulate_once
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import WorldSettings

logger = logging.getLogger(__name__)

Item = TypeVar("Item")

FAMILY, RIG, DRIVE = "proving-ground", "proving_ground", "drive"
MODELS: Final = ("b", "dc")
FIRST_WORLD: Final = 5000
"""Seed of the first world; trainings, tests and courses of the project use smaller seeds."""


NEXT: Final = {
    f"offpiste drive {PREFIX}{FAMILY}/dc --world dunes --seed 7": "another course, with a shipped model",
    "offpiste inspect YOUR_LOG": "check a log of your own vehicle",
    "offpiste reproduce fig4 --out trained": "all stages: simulate, extract, train, evaluate",
}
"""Commands to try next."""


@dataclass(frozen=True)
class FirstMinuteSettings:
    """Settings of the demo."""

    seed: int = 0  # offset of the world's seed from `FIRST_WORLD`
    world: str = "mojave"  # preset
    seconds: float = 20.0  # length of the predicted drive [s]
    snapshot_seconds: float = 0.5  # time between predictions [s]
    course_seconds: float = 20.0  # time limit of the course [s]
    course_speed: float = 7.0  # target speed [m/s]
    course_length: float = 90.0  # longest course [m]
    size: float = 180.0  # extent of the world [m]
    resolution: float = 0.25  # cell size of the world [m]

    @property
    def place(self) -> WorldSettings:
        """The world."""
        return WorldSettings(self.world, FIRST_WORLD + self.seed, size=self.size, resolution=self.resolution)


def run_first_minute(out: Path, settings: FirstMinuteSettings, *, processes: int = 0) -> None:
    """Drive, predict, compare and draw in `out`; finished steps with the same settings are reused.

    Args:
        processes: number of parallel drives; 0: one per core.
    """
    claim_folder(out, {"demo": asdict(settings)})
    place, processes = settings.place, at_a_time(processes)
    logger.info(
        f"1/3  In a world unseen in training ({place.preset}, seed {place.seed}): a drive with camera and LiDAR, and"
        " a course\n     driven twice, with the visual model (dc) and with the blind model (b)."
    )
    work = partial(do_part, out=out, settings=settings)
    run_all(work, (DRIVE, *reversed(MODELS)), processes, "drive").checked()
    logger.info(f"2/3  Both models predict 5 s ahead from every {settings.snapshot_seconds:g} s of the first drive.")
    dataset = open_dataset(out / "dataset.zarr")
    predictions = predict(dataset, {model: run_folder(shipped(model)) for model in MODELS})
    logger.info("3/3  Results.\n")
    title = f"offpiste demo: {place.preset}, seed {place.seed}, a world unseen in training"
    rig = load_rig(RIG)
    logs = {model: out / model / "drive.mcap" for model in MODELS}
    courses = {model: read_drive(log, rig) for model, log in logs.items()}
    write_png(out / "demo.png", demo_picture(make_world(place), dataset, predictions, _log(out), courses, title))
    results = {model: _result(out, model) for model in MODELS}
    errors = {model: float(predictions.errors(model).mean()) for model in MODELS}
    outcome = {"moments": len(predictions.row), "error_m": errors, "courses": results}
    write_text(out / "demo.json", json.dumps(outcome, indent=1, allow_nan=False) + "\n")
    logger.info(comparison_table(predictions, results, settings.course_speed).text())
    files = f"picture: {out / 'demo.png'}", f"logs (ROS 2): {', '.join(map(str, (_log(out), *logs.values())))}"
    commands = (f"  {command:<66} {what}" for command, what in NEXT.items())
    for line in (*closing_words(predictions), "", *files, "", "Next:", *commands):
        logger.info(line)


def do_part(part: str, report: Report, *, out: Path, settings: FirstMinuteSettings) -> str:
    """Record and extract the drive, or drive the course with a model, unless done already."""
    with redirect_stderr(io.StringIO()):  # progress bars would overlap
        return _drive(out, settings) if part == DRIVE else _course(part, report, out, settings)


def _drive(out: Path, settings: FirstMinuteSettings) -> str:
    """Record the drive and extract it as a test dataset."""
    log, dataset = _log(out), out / "dataset.zarr"
    log.parent.mkdir(exist_ok=True)
    summary = simulate_once(DriveSettings(settings.place, settings.seconds, settings.seed, sensors="light"), log)
    if not dataset.exists() or not drive_names(dataset):
        split = write_drives(out / "parts.txt", [(log.stem, "test")])
        pca, snapshots = Path(f"{PREFIX}{FAMILY}"), SnapshotSettings(settings.snapshot_seconds)
        extract([log], load_rig(RIG), dataset, split=split, pca=pca, snapshots=snapshots, processes=1, force=True)
    return f"     {summary}"


def _course(model: str, report: Report, out: Path, settings: FirstMinuteSettings) -> str:
    """Drive the course with a model."""
    folder = out / model
    if not (folder / "result.json").exists():
        shutil.rmtree(folder, ignore_errors=True)  # left by an interrupted drive
        course = CourseSettings(speed=settings.course_speed, length=settings.course_length)
        drive = CourseDriveSettings(settings.place, settings.course_seconds, course=course)
        drive_course(load_planner(Path(shipped(model))), drive, folder, track=partial(_reported, report=report))
    result = _result(out, model)
    return f"     {NAMES[model]}: {ending(result)}, mean path error {result['mean_path_error_m']:.2f} m"


def _reported(items: Iterable[Item], description: str, *, report: Report) -> Iterator[Item]:
    """Yield items and report the finished share."""
    listed: Sequence[Item] = list(items)
    for number, item in enumerate(listed):
        report(number / len(listed))
        yield item


def shipped(model: str) -> str:
    """Return the name of a shipped model on the command line."""
    return f"{PREFIX}{FAMILY}/{model}"


def _log(out: Path) -> Path:
    return out / "logs" / f"{DRIVE}.mcap"


def _result(out: Path, model: str) -> dict[str, Any]:
    return dict(json.loads((out / model / "result.json").read_text("utf-8")))
