"""What `evaluate` proposes where a test part is too short for an interval."""

import shlex
from dataclasses import asdict
from pathlib import Path

import tyro

from offpiste.cli.train import Train
from offpiste.evaluation.evaluate_runs import _folds
from offpiste.training.checkpoint import save_json
from offpiste.training.config import TrainConfig, Weights


def test_all_of_the_driving_is_tested_by_a_command_that_can_be_pasted(tmp_path: Path) -> None:
    run = tmp_path / "my run"
    run.mkdir()
    line = _folds(run, "parametric", Path("data set.zarr")).partition("driving: ")[2]
    program, command, *rest = shlex.split(line)
    assert (program, command) == ("offpiste", "train")
    train = tyro.cli(Train, args=rest)
    assert (train.dataset, train.out, train.folds) == (Path("data set.zarr"), tmp_path / "my run-folds", 5)
    assert train.train.model == "parametric"


def test_folds_are_trained_with_the_settings_of_the_run(tmp_path: Path) -> None:
    weights = Weights(yaw=0.5)
    settings = TrainConfig(model="b", epochs=7, refit_constants=True, min_speed=0.0, weights=weights, seed=3)
    save_json(tmp_path / "config.json", {"train": asdict(settings)})
    line = _folds(tmp_path, "b", Path("data.zarr")).partition("driving: ")[2]
    assert tyro.cli(Train, args=shlex.split(line)[2:]).train == settings


def test_folds_and_models_that_ship_are_not_trained_again(tmp_path: Path) -> None:
    (tmp_path / "cv" / "fold-0").mkdir(parents=True)
    assert _folds(tmp_path / "cv", "b", Path("data.zarr")) == ""
    assert _folds(Path("pretrained:proving-ground/b"), "b", Path("data.zarr")) == ""
