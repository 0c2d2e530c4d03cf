"""Epochs are chosen by the loss on the map at predicted places, as evaluation measures it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from feature_datasets import dataset_with_features, with_snapshots
from offpiste.core.errors import DatasetError
from offpiste.core.state import Trajectory
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Batch, Windows
from offpiste.dynamics import MODELS, Dynamics
from offpiste.training import losses as module
from offpiste.training.checkpoint import fold_folders
from offpiste.training.config import TrainConfig
from offpiste.training.distributed import ALONE, Group
from offpiste.training.losses import map_loss, summed_loss
from offpiste.training.prediction import predict_windows, roll_out
from offpiste.training.run import build, vehicle_of
from offpiste.training.train import train, train_folds

ROWS = tuple(range(20, 600, 40))
QUICK = TrainConfig(model="cf", epochs=1, bicycle_epochs=1, actuator_epochs=1, stride=50, batch=16)
ONE = torch.ones(5)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("data")
    return with_snapshots(dataset_with_features(folder / "seen.zarr"), folder / "snapshots", ROWS)


@pytest.fixture(scope="module")
def validation(dataset: Dataset) -> Windows:
    return Windows(dataset, "validation", horizon=25)


def loss(predicted: Trajectory, batch: Batch) -> Tensor:
    return summed_loss(predicted.state, batch.target, ONE, ONE)


@torch.no_grad()
def evaluated(dynamics: Dynamics, windows: Windows) -> float:
    """The mean loss on the map, as evaluation rolls out."""
    batch, predicted, _ = roll_out(dynamics, windows, windows.evaluation_indices(5), "map")
    return float(loss(predicted, batch).mean())


def test_it_is_the_loss_that_evaluation_measures_on_the_map(
    dataset: Dataset, validation: Windows, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "CORRIDOR", 1000.0)
    dynamics = build("dc", vehicle_of(dataset, TrainConfig(model="dc")), seed=0)
    measured = map_loss(validation, ALONE)
    assert measured is not None
    assert len(measured.index) == len(ROWS)
    wanted = evaluated(dynamics, validation)
    assert measured.of(dynamics, loss) == pytest.approx(wanted, rel=1e-6)
    # The maps are kept, the weights are not.
    with torch.no_grad():
        for parameter in dynamics.parameters():
            parameter *= 1.5
    assert measured.of(dynamics, loss) != pytest.approx(wanted, rel=1e-3)


def test_ground_is_kept_along_the_recorded_path(dataset: Dataset, validation: Windows) -> None:
    measured = map_loss(validation, ALONE)
    assert measured is not None
    _, maps = measured.kept
    whole, _ = validation.maps.of(measured.index)
    assert len(maps.features) < 0.5 * len(whole.features)
    dynamics = build("cf", vehicle_of(dataset, QUICK), seed=0)

    def along(predicted: Trajectory, batch: Batch) -> Tensor:
        away = predicted.state[..., :2] - batch.target[..., :2]
        return away.norm(dim=-1).amax(dim=1)

    furthest = measured.of(dynamics, along)
    assert 0 < furthest < 8
    assert measured.of(dynamics, loss) == pytest.approx(evaluated(dynamics, validation), rel=1e-6)


def test_processes_share_the_windows(dataset: Dataset, validation: Windows, monkeypatch: pytest.MonkeyPatch) -> None:
    dynamics = build("b", vehicle_of(dataset, QUICK), seed=0)
    monkeypatch.setattr(module, "MAP_WINDOWS", 5)

    def of(group: Group) -> float:
        measured = map_loss(validation, group)
        assert measured is not None
        return measured.of(dynamics, loss)

    alone = of(ALONE)
    # Without other processes: what each one adds to the sum.
    monkeypatch.setattr(Group, "sum", lambda self, value: value)
    assert sum(of(Group(rank, 8)) for rank in range(8)) == pytest.approx(alone, rel=1e-6)


def test_windows_without_a_snapshot_are_refused(dataset: Dataset) -> None:
    windows = Windows(dataset, "validation")
    model = MODELS["cf"](vehicle_of(dataset), seed=0)
    snapped = windows.maps.snapped
    with pytest.raises(DatasetError, match=r"\d+ of \d+ windows do not start with a snapshot of the map"):
        predict_windows(model, windows, "map")
    with pytest.raises(DatasetError, match="2 of 2 windows do not start with a snapshot of the map"):
        predict_windows(model, windows[np.flatnonzero(~snapped)[:2]], "map")
    chosen = windows.evaluation_indices(5)
    assert len(predict_windows(model, windows[chosen], "map").state) == len(chosen)


def test_training_chooses_on_the_map_if_there_are_snapshots_and_folds_at_recorded_places(
    dataset: Dataset, tmp_path: Path
) -> None:
    """One snapshot was once enough for a fold to choose on the map, unlike the next fold."""
    train(dataset, QUICK, tmp_path / "run")
    whole = dataset_with_features(tmp_path / "seen.zarr", ("train", "validation"), rows=3300, speeds=(2.5, 3.0))
    snapped = with_snapshots(whole, tmp_path / "snapshots", [200])
    train_folds(snapped, replace(QUICK, model="parametric", stride=200), tmp_path / "folds", folds=3)
    folders = fold_folders(tmp_path / "folds")
    assert len(folders) == 3
    for folder, place in ((tmp_path / "run", "map"), *((folder, "recorded") for folder in folders)):
        lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
        assert {line["validation_on"] for line in lines} == {place}
