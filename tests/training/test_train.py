"""Training from a dataset to a run: repeatable, resumable, and refused in one line if it cannot be right."""

import inspect
import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
import torch
import zarr
from safetensors.torch import load_file

from factories import circle_rows, stored_dataset
from offpiste.core.conventions import CONTROL
from offpiste.core.errors import DatasetError, OffpisteError, RunError, TrainingError
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import Dataset, StoredDrive, open_dataset
from offpiste.dataset.windows import Batch, Windows
from offpiste.dynamics import Hybrid, Parametric
from offpiste.rig.channels import ChannelSource
from offpiste.training import loop, prediction
from offpiste.training.checkpoint import fold_folders, load_json, load_tensors, save_json, save_tensors
from offpiste.training.config import TrainConfig
from offpiste.training.prediction import Lookup, predict_batch, predict_windows, roll_out
from offpiste.training.run import check_device, load_run, predict, refuse_seen
from offpiste.training.train import train, train_folds

QUICK = TrainConfig(model="b", epochs=2, bicycle_epochs=1, stride=200, batch=64)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Two circles: enough for every part of the split."""
    drives = {f"drive{number}": circle_rows(4000, speed=4.0 + 2 * number, seed=number) for number in range(2)}
    return stored_dataset(tmp_path_factory.mktemp("data") / "dataset.zarr", drives, "blocks:0.6,0.2,0.2")


@pytest.fixture(scope="module")
def run(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "b"
    train(dataset, QUICK, folder)
    return folder


class Killed(BaseException):
    """Substitute for a kill: nothing in the program catches it."""


def kill_after(epochs: int, monkeypatch: pytest.MonkeyPatch) -> None:
    real, seen = loop.train_epoch, []

    def train_epoch(*arguments: object) -> float:
        if len(seen) == epochs:
            raise Killed
        seen.append(1)
        return real(*arguments)

    monkeypatch.setattr(loop, "train_epoch", train_epoch)


def test_a_stage_minimises_its_loss(dataset: Dataset, tmp_path: Path) -> None:
    torch.manual_seed(0)
    line, windows, lines = torch.nn.Linear(1, 1), Windows(dataset, "train"), []

    def misfit(batch: Batch) -> torch.Tensor:
        speed = batch.state[:, 3:4]
        return (line(speed) - 2 * speed + 1)[:, 0].square()

    stage = loop.Stage("line", line, misfit, 60)
    loop.run_stage(stage, windows, windows, replace(QUICK, learning_rate=0.1), tmp_path, lines.append)
    assert lines[-1]["validation_loss"] < 0.01 * lines[0]["validation_loss"]
    assert torch.equal(load_file(tmp_path / "line.safetensors")["weight"], line.weight)


def test_a_stage_whose_loss_increases_keeps_the_initial_weights(dataset: Dataset, tmp_path: Path) -> None:
    line, windows = torch.nn.Linear(1, 1), Windows(dataset, "train")
    before = line.weight.item()

    def misfit(batch: Batch) -> torch.Tensor:  # training moves the weight, as an overfitting network does
        wanted = before + torch.is_grad_enabled()
        return (line.weight[0] - wanted).square().expand(len(batch.state))

    loop.run_stage(loop.Stage("line", line, misfit, 3), windows, windows, QUICK, tmp_path, lambda record: None)
    assert line.weight.item() == load_file(tmp_path / "line.safetensors")["weight"].item() == before


def test_every_epoch_is_recorded_and_constants_stay_as_fitted_to_the_bicycle_alone(run: Path) -> None:
    fitted, whole = load_file(run / "bicycle.safetensors"), load_file(run / "model.safetensors")
    assert torch.equal(whole["bicycle.raw"], fitted["bicycle.raw"])
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert [(line["stage"], line["epoch"]) for line in lines] == [("bicycle", 1), ("model", 1), ("model", 2)]
    assert all(line["train_loss"] > 0 and line["validation_loss"] > 0 for line in lines)
    assert {line["validation_on"] for line in lines} == {"recorded"}


def test_weights_depend_on_the_seed_alone_and_are_loaded_as_trained(
    dataset: Dataset, run: Path, tmp_path: Path
) -> None:
    trained, loaded = train(dataset, QUICK, tmp_path / "same"), load_run(run)
    batch = Windows(dataset, "test").gather(np.arange(3))
    with torch.no_grad():
        assert torch.equal(predict_batch(trained, batch).state, predict_batch(loaded.dynamics, batch).state)
    assert (loaded.model, loaded.seed, loaded.split) == ("b", 0, "blocks:0.6,0.2,0.2")
    train(dataset, replace(QUICK, seed=1), tmp_path / "other")
    first, same, other = (load_file(f / "model.safetensors") for f in (run, tmp_path / "same", tmp_path / "other"))
    assert all(torch.equal(first[name], same[name]) for name in first)
    assert any(not torch.equal(first[name], other[name]) for name in first)


@pytest.mark.parametrize("epochs", [0, 2])
def test_a_killed_run_resumes_to_the_same_weights(
    dataset: Dataset, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, epochs: int
) -> None:
    with monkeypatch.context() as patch:
        kill_after(epochs, patch)
        with pytest.raises(Killed):
            train(dataset, QUICK, tmp_path / "run")
    with pytest.raises(RunError, match="training has not finished"):
        load_run(tmp_path / "run")
    train(dataset, QUICK, tmp_path / "run", resume=True)
    uninterrupted, resumed = load_file(run / "model.safetensors"), load_file(tmp_path / "run" / "model.safetensors")
    assert all(torch.equal(uninterrupted[name], resumed[name]) for name in uninterrupted)


def test_a_run_predicts_windows_in_one_call(dataset: Dataset, run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    windows, loaded = Windows(dataset, "test"), load_run(run)
    with torch.no_grad():
        wanted = predict_batch(loaded.dynamics, windows.gather(np.arange(10))).state
    predicted = predict(loaded, windows[:10])
    assert not predicted.state.requires_grad
    torch.testing.assert_close(predicted.state, wanted)
    torch.testing.assert_close(predict(loaded, windows[3]).state, wanted[3:4], atol=1e-5, rtol=1e-5)
    monkeypatch.setattr(prediction, "AT_ONCE", 4)
    torch.testing.assert_close(predict(loaded, windows[:10]).state, wanted, atol=1e-5, rtol=1e-5)
    assert predict(loaded, windows[:3], lookup="map").state.shape == wanted[:3].shape


def test_impossible_predictions_and_settings_are_refused_in_one_line(
    dataset: Dataset, run: Path, tmp_path: Path
) -> None:
    windows, loaded = Windows(dataset, "test"), load_run(run)
    channels = {name: source for name, source in dataset.rig.channels.items() if name != "brake"}
    other = replace(dataset, rig=msgspec.structs.replace(dataset.rig, channels=channels))
    with pytest.raises(RunError, match="was trained with control throttle, brake, steer; the dataset has throttle"):
        predict(loaded, Windows(other, "test")[:2])
    with pytest.raises(RunError, match=r"no model 'bb'; did you mean 'b'\? available: ctrv"):
        train(dataset, replace(QUICK, model="bb"), tmp_path / "run")
    with pytest.raises(RunError, match="no loss 'square'; did you mean 'squared'"):
        train(dataset, replace(QUICK, loss="square"), tmp_path / "run")
    with pytest.raises(RunError, match="3 or more"):
        train_folds(dataset, QUICK, tmp_path / "run", folds=2)
    assert not (tmp_path / "run").exists()
    with pytest.raises(OffpisteError, match="no lookup 'maps'; did you mean 'map'"):
        inspect.unwrap(predict_windows)(loaded.dynamics, windows[:3], "maps")
    with pytest.raises(DatasetError, match="no window to predict"):
        predict(loaded, windows[:0])
    with pytest.raises(DatasetError, match="no part 'tst'; did you mean 'test'"):
        Windows(dataset, "tst")


@pytest.mark.parametrize("lookup", ["recorded", "map"])
def test_a_gear_unknown_to_a_run_is_ignored(dataset: Dataset, run: Path, lookup: Lookup) -> None:
    gear = ChannelSource(fields=("gear",))
    rig = msgspec.structs.replace(dataset.rig, channels={**dataset.rig.channels, "gear": gear})

    def geared(drive: StoredDrive) -> StoredDrive:
        columns = {
            name: np.column_stack((values, np.full(len(values), -1.0, np.float32)))
            for name, values in (("control", drive.rows.control), ("control_causal", drive.rows.control_causal))
        }
        return replace(drive, rows=replace(drive.rows, **columns))

    other = replace(dataset, rig=rig, drives=tuple(map(geared, dataset.drives)))
    loaded = load_run(run)
    one, two = (predict(loaded, Windows(each, "test")[:3], lookup) for each in (dataset, other))
    torch.testing.assert_close(one.state, two.state, rtol=0, atol=0)
    vehicle = replace(loaded.dynamics.vehicle, control=(*CONTROL, "gear"))
    knows = Parametric(vehicle)
    batch, _, _ = roll_out(knows, Windows(dataset, "test")[:3], np.arange(3), lookup)
    assert (batch.control[..., 3] == 1).all()
    assert (batch.history.control[..., 3] == 1).all()
    batch, _, _ = roll_out(knows, Windows(other, "test")[:3], np.arange(3), lookup)
    assert (batch.control[..., 3] == -1).all()


def test_a_value_that_is_not_finite_stops_training_and_keeps_the_last_checkpoint(
    dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = loop.train_epoch

    def poisoned(stage: loop.Stage, *rest: object) -> float:
        if stage.name == "model" and rest[-2] == 1:
            assert isinstance(stage.module, Hybrid)
            with torch.no_grad():
                stage.module.compensator.output[-1].bias[0] = torch.nan
        return real(stage, *rest)

    monkeypatch.setattr(loop, "train_epoch", poisoned)
    said = r"model, epoch 2, batch 1: the predicted vx is not finite from step 1 \(0\.02"
    with pytest.raises(TrainingError, match=said):
        train(dataset, QUICK, tmp_path / "run")
    kept = load_file(tmp_path / "run" / "model.checkpoint.safetensors")
    assert all(torch.isfinite(value).all() for value in kept.values())


def test_a_gradient_that_is_not_finite_is_named(dataset: Dataset, tmp_path: Path) -> None:
    module = torch.nn.Linear(1, 1)
    windows = Windows(dataset, "train")
    # sqrt(0) is finite, its gradient is not.
    stage = loop.Stage("root", module, lambda batch: torch.sqrt(module.weight[0] * 0).expand(len(batch.state)), 1)
    with pytest.raises(TrainingError, match="root, epoch 1, batch 1: the gradient of 'weight' is not finite"):
        loop.run_stage(stage, windows, windows, QUICK, tmp_path, lambda line: None)


def test_a_folder_with_other_files_is_neither_trained_into_nor_changed(dataset: Dataset, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / ".rows.zarr.1.partial").mkdir()  # of a command that may still run
    for begin in (lambda: train(dataset, QUICK, tmp_path), lambda: train_folds(dataset, QUICK, tmp_path, folds=3)):
        with pytest.raises(RunError, match="holds files that are not of a run; give another folder as --out"):
            begin()
        assert {path.name for path in tmp_path.iterdir()} == {"notes.txt", ".rows.zarr.1.partial"}


def test_a_folder_with_a_run_is_not_overwritten(dataset: Dataset, run: Path) -> None:
    with pytest.raises(RunError, match="holds a run already"):
        train(dataset, QUICK, run)
    for resume, how in ((True, "resume with the same, or choose another --out"), (False, "choose another --out")):
        with pytest.raises(RunError, match=r"begun with other settings \(batch 64 then, 4 now\)") as error:
            train(dataset, replace(QUICK, batch=4), run, resume=resume)
        assert error.value.how == how


def test_a_run_is_not_resumed_on_a_dataset_that_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, listed, run = tmp_path / "data.zarr", tmp_path / "parts.txt", tmp_path / "run"
    config = replace(QUICK, model="parametric")

    def made(speed: float = 4.0, others: str = "validation", more: str = "", brake: float = 0.0) -> Dataset:
        shutil.rmtree(path, ignore_errors=True)
        listed.write_text(f"one train\ntwo validation\nthree test\nfour {others}\n")
        rows = circle_rows(1500, speed=speed)
        rows = replace(rows, control=rows.control + np.float32([0, brake, 0]))  # which no metadata have
        return stored_dataset(path, dict.fromkeys(("one", "two", "three", *more.split()), rows), f"drives:{listed}")

    with monkeypatch.context() as patch:
        kill_after(0, patch)
        with pytest.raises(Killed):
            train(made(), config, run)
    for changed in ({"speed": 4.1}, {"others": "test"}, {"more": "four"}, {"brake": 0.1}):
        with pytest.raises(RunError, match="holds a run that was begun before the dataset changed"):
            train(made(**changed), config, run, resume=True)
    control = zarr.open_group(made().path)["one/control"]
    control[0, 1] = 0.5  # in place, with its checksum
    with pytest.raises(RunError, match="holds a run that was begun before the dataset changed"):
        train(open_dataset(path), config, run, resume=True)
    train(made(), config, run, resume=True)


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        ({}, r"model.json: cannot be used \(Object missing required field `model`"),
        ({"weights_sha256": None}, "cannot be used .* `\\$.weights_sha256`"),
        ({"model": "lstm"}, "do not fit the model"),
        ({"schema": 1}, "schema 1, this offpiste reads 2"),
    ],
)
def test_a_run_of_other_entries_ends_in_one_line(run: Path, tmp_path: Path, entries: dict, said: str) -> None:
    (tmp_path / "model.safetensors").write_bytes((run / "model.safetensors").read_bytes())
    save_json(tmp_path / "model.json", load_json(run / "model.json") | entries if entries else {})
    with pytest.raises(RunError, match=said) as error:
        load_run(tmp_path)
    assert "\n" not in str(error.value)


def test_a_run_is_not_evaluated_on_what_it_was_trained_on_under_any_name(dataset: Dataset, run: Path) -> None:
    loaded, split = load_run(run), parse_split("blocks:0.2,0.2,0.6")
    renamed = replace(dataset, drives=tuple(replace(drive, name=f"new {drive.name}") for drive in dataset.drives))
    for data, name in ((dataset, "drive0"), (renamed, r"new drive0 \(there: drive0\)")):
        refuse_seen(loaded, data, "test")
        with pytest.raises(RunError, match=f"was trained on .* of the test part of drive '{name}'"):
            refuse_seen(loaded, data.relabelled(split), "test")


def test_folds_refit_everything_on_their_own_parts(
    dataset: Dataset, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    config = replace(QUICK, model="parametric", epochs=1, stride=100_000)  # beyond all windows: every one is used
    train_folds(dataset, config, tmp_path / "cv", folds=3)
    assert "another --out, with --split" not in caplog.text
    folders = fold_folders(tmp_path / "cv")
    assert [folder.name for folder in folders] == ["fold-0", "fold-1", "fold-2"]
    runs = [load_run(folder) for folder in folders]
    assert [run.split for run in runs] == ["fold:0/3", "fold:1/3", "fold:2/3"]
    for run in runs:
        refuse_seen(run, dataset.relabelled(parse_split(run.split)), "test")
    assert not torch.equal(runs[0].scale, runs[1].scale)


def test_files_of_weights_have_the_same_bytes_each_time(tmp_path: Path) -> None:
    tensors = {name: torch.arange(3.0) for name in "abcdef"}
    for number in range(5):
        save_tensors(tmp_path / f"{number}.safetensors", tensors, epoch=1, best_score=float("inf"), names=["a"])
    assert len({(tmp_path / f"{number}.safetensors").read_bytes() for number in range(5)}) == 1
    assert load_tensors(tmp_path / "0.safetensors")[1] == {"epoch": 1, "best_score": float("inf"), "names": ["a"]}


def test_lstms_on_a_gpu_compute_in_float32(monkeypatch):
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", True)
    assert check_device("cpu") == torch.device("cpu")
    assert torch.backends.cudnn.allow_tf32
    gpu = torch.device("cuda", 1)
    monkeypatch.setattr(torch, "zeros", lambda *size, device: SimpleNamespace(device=gpu, item=lambda: 0.0))
    assert check_device("cuda") == gpu
    assert not torch.backends.cudnn.allow_tf32
