"""Drives simulated and extracted in portions: logs are removed, results are reused."""

from pathlib import Path

import numpy as np
import pytest

from offpiste.dataset.ground_truth_features import LAYERS
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import drive_names, open_dataset
from offpiste.reproduction import data
from offpiste.reproduction.data import data_steps, opened, planned_drives
from offpiste.reproduction.settings import ReproductionSettings, Size
from offpiste.training.config import TrainConfig

TINY = Size(
    "tiny",
    (16.0, 8.0, 8.0),
    longest=8.0,
    shortest=8.0,
    images=10,
    snapshot_seconds=2.0,
    train=TrainConfig(min_speed=0.0),
    world_size=160.0,
    world_resolution=0.5,
    first_seed=9_000_000,
    manoeuvres=True,
    portion=2,
)


@pytest.fixture
def steps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(data, "MIX", {"mojave": 1.0})
    settings = ReproductionSettings("fig4", TINY, tmp_path, processes=1)
    return settings, data_steps(settings)


def test_portions_leave_a_dataset_and_no_logs(steps, monkeypatch: pytest.MonkeyPatch):
    settings, (simulating, fitting, *portions) = steps
    drives = planned_drives(TINY)
    assert len(drives) == 4
    assert len(portions) == 2
    for step in (simulating, fitting, portions[0]):
        assert not step.done()
        step.do()
        assert step.done()
    assert not portions[1].done()
    there = set(drive_names(settings.data))
    assert len(there) == 2
    assert not {log.stem for log in (settings.out / "logs").glob("*.mcap")} & there

    steps = data_steps(settings)
    assert [step.done() for step in steps] == [True, True, True, False], "extracted drives are not simulated again"
    steps[-1].do()
    assert not list((settings.out / "logs").iterdir())
    dataset = open_dataset(settings.data)
    truth = open_dataset(settings.truth)
    for made in (dataset, truth):
        assert {(drive.name, tuple(np.unique(drive.part))) for drive in made.drives} == {
            (drive.name, (PARTS.index(drive.part),)) for drive in drives
        }
    assert truth.features == LAYERS["ground-truth"]
    assert "gear" in dataset.rig.channels
    assert dataset.min_speed > opened(settings).min_speed == 0
    monkeypatch.setattr(data, "simulate_all", None)
    assert all(step.done() for step in data_steps(settings))
