"""Jobs that are killed and repeated: simulation, extraction, training, and driving."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

DURATIONS = {"metrics.jsonl": {"seconds"}, "result.json": {"stages"}}
"""Entries of files that contain durations."""


def simulate_drive(inputs: Path, out: Path) -> None:
    """A short drive with camera and LiDAR; the log of a killed process must be removed, as its message says."""
    from offpiste.simulation.simulate import DriveSettings, simulate
    from offpiste.simulation.world.world import WorldSettings

    (out / "drive.mcap").unlink(missing_ok=True)
    world = WorldSettings("mojave", seed=3, size=120.0, resolution=0.5)
    simulate(DriveSettings(world, 4.0, seed=1, sensors="light"), out / "drive.mcap")


def extract_drives(inputs: Path, out: Path) -> None:
    """Visual features of two drives, with snapshots."""
    from offpiste.inspection.extract import extract
    from offpiste.rig.rig import load_rig

    logs = [inputs / "one.mcap", inputs / "two.mcap"]
    split, pca = f"drives:{inputs / 'parts.txt'}", inputs / "pca.safetensors"
    extract(logs, load_rig("proving_ground"), out / "data.zarr", split=split, pca=pca, force=True)


def train_model(inputs: Path, out: Path) -> None:
    """All three stages of a model that reads features."""
    from offpiste.dataset.store import open_dataset
    from offpiste.training.config import TrainConfig
    from offpiste.training.train import train

    os.environ["OFFPISTE_CACHE"] = f"{out}-cache"  # each run fits its own actuators
    # Enough epochs that what the last ones gained depends on those before the kill.
    config = TrainConfig(model="dc", epochs=6, bicycle_epochs=5, actuator_epochs=5, stride=40, batch=32)
    train(open_dataset(inputs / "features.zarr"), config, out / "run", resume=True)


def drive_closed_loop(inputs: Path, out: Path) -> None:
    """A short drive with a plan; files of a killed process must be removed, as its message says."""
    from offpiste.closed_loop.courses import CourseSettings
    from offpiste.closed_loop.drive_course import CourseDriveSettings, drive_course
    from offpiste.runtime.planner import Planner
    from offpiste.simulation.world.world import WorldSettings
    from runtime.stream import parametric, settings

    for name in ("drive.mcap", "result.json"):
        (out / name).unlink(missing_ok=True)
    world = WorldSettings("mojave", seed=3, size=120.0, resolution=0.5)
    course = CourseSettings(speed=5.0, length=60.0, candidates=6)
    wanted = CourseDriveSettings(world, seconds=2.0, course=course, runtime=settings())
    drive_course(Planner("parametric", Path("nowhere"), parametric()), wanted, out)


WORK: dict[str, tuple[str, Callable[[Path, Path], None]]] = {
    "simulate": ("offpiste.simulation.simulate", simulate_drive),
    "extract": ("offpiste.inspection.extract", extract_drives),
    "train": ("offpiste.training.train", train_model),
    "drive": ("offpiste.closed_loop.drive_course", drive_closed_loop),
}
"""Jobs, and the module that each imports before it is ready."""


def make_inputs(inputs: Path, names: Iterable[str]) -> None:
    """Write the inputs of jobs: logs and a PCA to extract from, a dataset to train on."""
    if "extract" in names:
        logs_and_pca(inputs)
    if "train" in names:
        recorded_steering(inputs)


def logs_and_pca(inputs: Path) -> None:
    """Two logs of one drive, and a PCA."""
    from feature_datasets import random_pca
    from offpiste.perception.backbones import open_backbone
    from offpiste.perception.pca import save_pca

    simulate_drive(inputs, inputs)
    for name in ("one", "two"):
        shutil.copy(inputs / "drive.mcap", inputs / f"{name}.mcap")
    (inputs / "parts.txt").write_text("one train\ntwo test\n")
    save_pca(inputs / "pca.safetensors", random_pca(open_backbone("filterbank")))


def recorded_steering(inputs: Path) -> None:
    """A dataset of random features and of a steering angle, so that there are actuators to fit."""
    from factories import RIG
    from feature_datasets import empty_dataset, rows_with_features
    from offpiste.core.conventions import DT
    from offpiste.dataset.store import add_drive
    from offpiste.rig.rig import parse_rig

    rng = np.random.default_rng(0)
    channel = '[channels.steer_angle]\ntopic = "steering"\nfields = ["angle"]\n'
    rig = parse_rig(RIG.replace('"steer_angle", ', "") + channel, where="small.toml")
    parts = {"one": "train", "two": "validation", "three": "test"}
    split = empty_dataset(inputs / "features.zarr", parts, rig)
    for name in parts:
        rows = rows_with_features(700, rng, speed=float(rng.uniform(3, 6)))
        recorded = rows.actuators.copy()
        recorded[:, 1] = 0.3 * rows.control[:, 2]
        recorded[:, 2] = np.gradient(recorded[:, 1], DT)
        rows = replace(rows, actuators=recorded, actuators_causal=recorded)
        add_drive(inputs / "features.zarr", name, rows, split, ())


def contents(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of each file of a folder without entries that contain durations."""
    return {
        str(file.relative_to(folder)): hashlib.sha256(_timeless(file)).hexdigest()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


def _timeless(file: Path) -> bytes:
    durations = DURATIONS.get(file.name)
    if durations is None:
        return file.read_bytes()
    text = file.read_text("utf-8")
    documents = [json.loads(line) for line in text.splitlines()] if file.suffix == ".jsonl" else [json.loads(text)]
    kept = [{key: value for key, value in one.items() if key not in durations} for one in documents]
    return json.dumps(kept).encode()


def start(name: str, inputs: Path, out: Path) -> subprocess.Popen[str]:
    """Start a job in a new process and wait until it has imported its modules."""
    out.mkdir(parents=True, exist_ok=True)
    module, work = WORK[name]
    code = f"import sys, pathlib, {module}, kill; print('ready', flush=True)\n"
    code += f"kill.{work.__name__}(*map(pathlib.Path, sys.argv[1:]))"
    path = os.pathsep.join((str(Path(__file__).parent), *filter(None, sys.path)))
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(inputs), str(out)],
        env=os.environ | {"PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n", process.communicate()[1]
    return process


def finish(process: subprocess.Popen[str]) -> None:
    """Wait for a job to finish."""
    error = process.communicate()[1]
    assert process.returncode == 0, error


def kill_at(name: str, inputs: Path, out: Path, moment: float) -> None:
    """Start a job, kill it after `moment` seconds, and repeat it."""
    process = start(name, inputs, out)
    time.sleep(moment)
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    finish(start(name, inputs, out))


def differences(one: dict[str, str], other: dict[str, str]) -> list[str]:
    """Return the names of files that differ."""
    return sorted(name for name in one.keys() | other.keys() if one.get(name) != other.get(name))
