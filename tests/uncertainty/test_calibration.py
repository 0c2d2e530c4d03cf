"""`offpiste calibrate` from end to end: stored spreads, reports, refusals."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cli.command import refusal
from cli.command import run as offpiste
from feature_datasets import FEATURES, dataset_with_features, with_snapshots
from offpiste.core.errors import DatasetError, OffpisteError, RunError
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.training.checkpoint import WEIGHTS, load_json, load_tensors, save_json, save_tensors
from offpiste.training.config import TrainConfig
from offpiste.training.run import Run, load_run, predict
from offpiste.training.train import train
from offpiste.uncertainty.calibration import calibrate, evaluate_kept_spreads, kept_or_fitted
from offpiste.uncertainty.fit import FILE, SpreadSettings, load_spread, predict_with_spread, residuals_on_maps
from offpiste.uncertainty.novelty import SIZE, features_at_starts, keep_memory_bank, load_memory_bank
from offpiste.visualization.predicted_regions import view_regions

QUICK = SpreadSettings(windows=64, steps=20, batch=32)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return dataset_with_features(tmp_path_factory.mktemp("calibrate") / "dataset.zarr")


@pytest.fixture(scope="module")
def trained(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trained") / "dc"
    config = TrainConfig(model="dc", epochs=1, bicycle_epochs=1, actuator_epochs=1, batch=64, stride=80)
    train(dataset, config, folder)
    return folder


@pytest.fixture
def run(trained: Path, tmp_path: Path) -> Run:
    return load_run(Path(shutil.copytree(trained, tmp_path / "dc")))


def change_weights(run: Run) -> None:
    weights, about = load_tensors(run.folder / WEIGHTS)
    save_tensors(run.folder / WEIGHTS, {name: value + 1 for name, value in weights.items()}, **about)


def test_a_spread_is_stored_with_its_run_and_belongs_to_its_weights(dataset: Dataset, run: Run) -> None:
    spread = kept_or_fitted(run, dataset, QUICK)
    windows = Windows(dataset, "test")
    residuals = residuals_on_maps(run, windows, np.arange(3))
    again = load_spread(run)
    assert np.array_equal(spread(residuals.inputs), again(residuals.inputs))
    assert residuals.inputs.isfinite().all()
    change_weights(run)
    with pytest.raises(RunError, match="belongs to other weights"):
        load_spread(run)
    (run.folder / FILE).unlink()
    with pytest.raises(RunError, match=r"has no spread.*offpiste calibrate"):
        load_spread(run)


def test_a_memory_bank_is_stored_with_its_run_and_belongs_to_its_weights(dataset: Dataset, run: Run) -> None:
    with pytest.raises(RunError, match=r"has no memory bank to detect novel ground.*offpiste calibrate"):
        load_memory_bank(run)
    bank = keep_memory_bank(run, dataset)
    assert bank.kept.shape == (SIZE, FEATURES)
    found = features_at_starts(dataset, "test", 50)
    assert found.isfinite().all()
    assert torch.equal(load_memory_bank(run).distance(found), bank.distance(found))
    change_weights(run)
    with pytest.raises(RunError, match="belongs to other weights"):
        load_memory_bank(run)


def test_predictions_have_regions_that_contain_the_vehicle(dataset: Dataset, run: Run) -> None:
    kept_or_fitted(run, dataset, QUICK)
    windows = Windows(dataset, "test")[:7]
    found = predict_with_spread(run, windows)
    assert torch.equal(found.trajectory.state, predict(run, windows, "map").state)
    half, most = found.region(0.5), found.region(0.95)
    assert half.shape == (7, 25, 2)
    assert (half > 0).all()
    assert (half < most).all()
    recorded = predict_with_spread(run, windows, "recorded")
    assert torch.equal(recorded.trajectory.state, predict(run, windows, "recorded").state)
    windows = Windows(replace(dataset, features=tuple(f"other{k}" for k in range(FEATURES))), "test")[:2]
    with pytest.raises(RunError, match="reads the terrain features pca0, pca1"):
        predict_with_spread(run, windows)


def test_runs_in_folders_of_the_same_name_are_distinguished(dataset: Dataset, run: Run, tmp_path: Path) -> None:
    kept_or_fitted(run, dataset, QUICK)
    folders = [Path(shutil.copytree(run.folder, tmp_path / seed / "dc")) for seed in ("s0", "s1")]
    assert list(evaluate_kept_spreads(folders, dataset.path).within) == ["s0/dc", "s1/dc"]


def test_a_spread_is_not_evaluated_on_data_it_was_fitted_to(dataset: Dataset, run: Run, tmp_path: Path) -> None:
    """The run itself was trained on other data."""
    about = load_json(run.folder / "model.json")
    save_json(run.folder / "model.json", about | {"seen": []})
    stranger = load_run(run.folder)
    kept_or_fitted(stranger, dataset, QUICK)
    assert evaluate_kept_spreads([run.folder], dataset.path) is not None
    again = dataset_with_features(tmp_path / "again.zarr", ("test", "train", "validation", "train"))
    with pytest.raises(RunError, match=r"spread\.safetensors: was fitted to .* of the test part of drive"):
        evaluate_kept_spreads([run.folder], again.path)


def test_impossible_calibrations_are_refused_before_anything_is_fitted_or_written(
    dataset: Dataset, run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "none" in refusal(capsys, "calibrate", tmp_path / "none", "--dataset", dataset.path)
    untested = dataset_with_features(tmp_path / "untested.zarr", ("train", "validation", "train"))
    with pytest.raises(DatasetError, match="test part has no window"):
        calibrate([run.folder], untested.path, tmp_path / "out", QUICK)
    (tmp_path / "file").touch()
    with pytest.raises(OffpisteError, match="file: is a file; give a folder as --out"):
        calibrate([run.folder], dataset.path, tmp_path / "file", QUICK)
    assert not (run.folder / FILE).exists()
    assert not (tmp_path / "out").exists()


def test_map_snapshots_are_read(dataset: Dataset, run: Run, tmp_path: Path) -> None:
    snapped = with_snapshots(dataset, tmp_path / "snapshots", [200, 300])
    windows = Windows(replace(snapped, min_speed=0.0), "test")
    index = windows.evaluation_indices(5)
    assert len(index) == 2
    on_slope = residuals_on_maps(run, windows, index)
    assert on_slope.inputs.shape[:2] == (2, 25)
    assert on_slope.inputs[..., 3].abs().max() > 0.01, "the snapshots' ground slopes"


def test_the_command_writes_table_numbers_and_picture(dataset: Dataset, run: Run, tmp_path: Path) -> None:
    kept_or_fitted(run, dataset, QUICK)
    out = tmp_path / "out"
    assert offpiste("calibrate", run.folder, "--dataset", dataset.path, "--out", out) == 0
    rows = json.loads((out / "calibration.json").read_text("utf-8"))["rows"]
    assert [row["horizon"] for row in rows if row["windows"] == "all"] == [1.0, 3.0, 5.0]
    for row in rows:
        assert sorted(row["coverage"]) == row["coverage"], "larger regions hold more"
        assert 0 < row["crps_m"] < row["error_m"]
    of_bands = [row["n"] for row in rows if row["windows"] != "all" and row["horizon"] == 5]
    assert sum(of_bands) == next(row["n"] for row in rows)
    assert (out / "calibration.png").stat().st_size > 5000
    kept = evaluate_kept_spreads([run.folder], dataset.path)
    assert kept.write(tmp_path / "again") == tmp_path / "again" / "calibration.md"
    again = json.loads((tmp_path / "again" / "calibration.json").read_text("utf-8"))["rows"]
    assert [row["coverage"] for row in again] == [row["coverage"] for row in rows]
    view_regions(run.folder, dataset, out)
    assert (out / "regions.png").stat().st_size > 5000
    (run.folder / FILE).unlink()
    assert evaluate_kept_spreads([run.folder], dataset.path) is None
    with pytest.raises(RunError, match=r"has no spread.*offpiste calibrate"):
        view_regions(run.folder, dataset, out)
    assert load_memory_bank(run).novel(features_at_starts(dataset, "validation", 100)).float().mean() < 0.1
