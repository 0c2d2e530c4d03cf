"""Examples on small data."""

import runpy
from pathlib import Path

import cv2
import pytest
import torch

from feature_datasets import dataset_with_features
from offpiste.training.config import TrainConfig
from offpiste.training.run import build, save_run, vehicle_of
from shared_drives import drive_with_sensors
from warm import run_warm

EXAMPLES = Path(__file__).parents[1] / "examples"


def run(name: str, *arguments: str | Path) -> str:
    """Run an example and return its output."""
    done = run_warm(EXAMPLES / name, *arguments)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_predict_and_plot(tmp_path: Path) -> None:
    dataset = dataset_with_features(tmp_path / "dataset.zarr")
    save_run(tmp_path / "dc", build("dc", vehicle_of(dataset), seed=0), TrainConfig(model="dc"), dataset, torch.ones(5))
    out = tmp_path / "dc.png"
    assert "m off after 5 s" in run("predict_and_plot.py", tmp_path / "dc", tmp_path / "dataset.zarr", "--out", out)
    assert cv2.imread(str(out)) is not None


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated drive of a few seconds."""
    return drive_with_sensors(tmp_path_factory.mktemp("drive") / "drive.mcap")


def test_plan_on_map(drive: Path, tmp_path: Path) -> None:
    out = tmp_path / "plan.png"
    said = run(
        "plan_on_map.py", "pretrained:proving-ground/dc", drive, "proving_ground", "--seconds", "2", "--out", out
    )
    away = float(said.split(" s ")[1].split(" m ")[0])
    assert away < 7, "10.8 m at the start"
    assert cv2.imread(str(out)) is not None


def test_map_from_bag(drive: Path, tmp_path: Path) -> None:
    said = run("map_from_bag.py", drive, "--rig", "proving_ground", "--out", tmp_path / "map.png")
    assert float(said.split(": ")[1].split(" m2")[0]) > 200
    assert cv2.imread(str(tmp_path / "map.png")) is not None


def test_pytorch_mppi_drives_with_our_model():
    pytest.importorskip("pytorch_mppi")
    example = runpy.run_path(str(EXAMPLES / "pytorch_mppi_with_offpiste.py"))
    states = example["drive"](steps=50)
    assert states.shape == (50, 6)
    assert states.isfinite().all()
    # Straight ahead it would be 0.4 m outside after 1 s.
    off = (torch.hypot(states[:, 0], states[:, 1]) - example["RADIUS"]).abs()
    assert off.max() < 0.3
    assert torch.equal(example["drive"](steps=6), states[:6])
