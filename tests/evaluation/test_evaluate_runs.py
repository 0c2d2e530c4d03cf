"""What `evaluate` proposes where a test part is too short for an interval."""

import shlex
from dataclasses import asdict
from pathlib import Path

import pytest
import tyro

from factories import circle_rows, small_rig
from feature_datasets import dataset_with_features, with_snapshots
from offpiste.cli.train import Train
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import Dataset, add_drive, create, open_dataset
from offpiste.evaluation.evaluate_runs import folds_command
from offpiste.training.checkpoint import save_json
from offpiste.training.config import TrainConfig, Weights


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    path, split = tmp_path_factory.mktemp("data") / "small.zarr", parse_split("blocks:0.7,0.1,0.2")
    create(path, small_rig(), split)
    add_drive(path, "circle", circle_rows(600), split, ())
    return open_dataset(path)


def test_all_of_the_driving_is_tested_by_a_command_that_can_be_pasted(dataset: Dataset, tmp_path: Path) -> None:
    run = tmp_path / "my run"
    run.mkdir()
    line = folds_command(run, "parametric", dataset, Path("data set.zarr")).partition("driving: ")[2]
    program, command, *rest = shlex.split(line)
    assert (program, command) == ("offpiste", "train")
    train = tyro.cli(Train, args=rest)
    assert (train.dataset, train.out, train.folds) == (Path("data set.zarr"), tmp_path / "my run-folds", 5)
    assert train.train.model == "parametric"


def test_folds_are_trained_with_the_settings_of_the_run(dataset: Dataset, tmp_path: Path) -> None:
    weights = Weights(yaw=0.5)
    settings = TrainConfig(model="b", epochs=7, refit_constants=True, min_speed=0.0, weights=weights, seed=3)
    save_json(tmp_path / "config.json", {"train": asdict(settings)})
    line = folds_command(tmp_path, "b", dataset, Path("data.zarr")).partition("driving: ")[2]
    assert tyro.cli(Train, args=shlex.split(line)[2:]).train == settings


def test_folds_and_models_that_ship_are_not_trained_again(dataset: Dataset, tmp_path: Path) -> None:
    (tmp_path / "cv" / "fold-0").mkdir(parents=True)
    assert folds_command(tmp_path / "cv", "b", dataset, dataset.path) == ""
    assert folds_command(Path("pretrained:proving-ground/b"), "b", dataset, dataset.path) == ""


def test_folds_are_not_proposed_where_the_map_was_kept_for_the_split(tmp_path: Path) -> None:
    dataset = dataset_with_features(tmp_path / "seen.zarr")
    assert "--folds 5" in folds_command(tmp_path, "b", dataset, dataset.path)
    snapped = with_snapshots(dataset, tmp_path / "snapshots", [100])
    assert folds_command(tmp_path, "b", snapped, dataset.path) == ""
