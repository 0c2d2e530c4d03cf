"""Faults of datasets, runs and settings, each of which ends in one line and exit code 1."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import zarr
from safetensors.torch import load_file

from factories import circle_rows, small_rig
from feature_datasets import dataset_with_features
from offpiste.cli import main
from offpiste.core.checksums import sha256_of, sha256_of_json, write_checksums
from offpiste.core.errors import RunError
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import add_drive, create, open_dataset
from offpiste.training.checkpoint import load_json, save_json, save_tensors
from offpiste.training.config import TrainConfig, Weights, refuse_impossible
from offpiste.training.run import build, save_run, vehicle_of

QUICK = ("--epochs", "1", "--bicycle-epochs", "1", "--actuator-epochs", "1", "--stride", "100", "--batch", "64")


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset with features by distance, and beside it runs `b` and `cf` whose weights are as they were drawn."""
    folder = tmp_path_factory.mktemp("refusals")
    dataset = dataset_with_features(folder / "good.zarr")
    for model in ("b", "cf"):
        config = TrainConfig(model=model)
        save_run(folder / model, build(model, vehicle_of(dataset), seed=0), config, dataset, torch.ones(5))
    return dataset.path


@pytest.fixture
def copied(good: Path, tmp_path: Path) -> Path:
    """A copy of the dataset to break."""
    return Path(shutil.copytree(good, tmp_path / "broken.zarr"))


@pytest.fixture
def error_of(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs a command that must fail; gives its one line."""

    def run(*words: object) -> str:
        with pytest.raises(SystemExit) as exit_:
            main([str(word) for word in words])
        error = capsys.readouterr().err
        assert exit_.value.code == 1, error
        assert error.startswith("offpiste: ")
        assert error.count("\n") == 1, error
        return error

    return run


def change(path: Path, key: str, new: Callable[[np.ndarray], Any]) -> None:
    """Change an array of all drives; its checksum fits again."""
    for folder in path.glob(f"*/{key}"):
        with zarr.config.set({"array.write_empty_chunks": True}):
            array = zarr.open_array(folder, mode="r+")
            array[...] = new(np.array(array[...]))


def part_of(values: np.ndarray, value: float) -> np.ndarray:
    """Some rows replaced."""
    values[100:130] = value
    return values


def test_features_that_are_all_missing(copied: Path, good: Path, tmp_path: Path, error_of: Callable[..., str]) -> None:
    change(copied, "cells/valid", np.zeros_like)
    for model in ("cf", "dc"):
        line = error_of("train", copied, "--model", model, "--out", tmp_path / model, *QUICK)
        assert "all terrain features are missing" in line
        assert str(copied) in line
    line = error_of("evaluate", good.parent / "cf", "--dataset", copied, "--out", tmp_path / "report")
    assert "'cf' reads terrain features" in line
    assert not (tmp_path / "report").exists()


def test_one_drive(tmp_path: Path, good: Path, error_of: Callable[..., str]) -> None:
    alone = dataset_with_features(tmp_path / "one.zarr", ("train",)).path
    assert "the validation part has no window of 5 s, and no row" in error_of(
        "train", alone, "--out", tmp_path / "run", *QUICK
    )
    line = error_of("evaluate", good.parent / "b", "--dataset", alone)
    assert "the test part has no window of 5 s, and no row" in line
    assert "1 drive" in line


def test_fewer_windows_than_a_batch(good: Path, tmp_path: Path, error_of: Callable[..., str]) -> None:
    line = error_of("train", good, "--out", tmp_path / "run", "--batch", 5000)
    assert "fewer than a batch of 5000" in line
    assert not (tmp_path / "run").exists(), "a folder that cannot be filled is not begun"


def test_rows_that_are_not_finite(copied: Path, good: Path, tmp_path: Path, error_of: Callable[..., str]) -> None:
    change(copied, "state_causal", lambda values: part_of(values, np.nan))
    train = ("train", copied, "--out", tmp_path / "run", *QUICK)
    for command in (train, ("evaluate", good.parent / "b", "--dataset", copied)):
        line = error_of(*command)
        assert (
            "drive 'circle-0' cannot be read ('state_causal' is not finite in 30 rows marked complete, the first"
            in line
        )
        assert "row 100" in line


def test_features_that_are_not_finite(copied: Path, tmp_path: Path, error_of: Callable[..., str]) -> None:
    change(copied, "cells/features", lambda values: np.full_like(values, np.nan))
    line = error_of("train", copied, "--model", "cf", "--out", tmp_path / "run", *QUICK)
    assert "terrain features of the dataset are not finite" in line
    assert "extract it again" in line


@pytest.mark.parametrize("height", [2.0, np.nan])
def test_normals_that_are_neither_unit_vectors_nor_unknown(
    copied: Path, tmp_path: Path, error_of: Callable[..., str], height: float
) -> None:
    change(
        copied, "normal", lambda values: np.concatenate((values[..., :2], np.full_like(values[..., 2:], height)), -1)
    )
    line = error_of("train", copied, "--model", "cf", "--out", tmp_path / "run", *QUICK)
    assert "surface normals of the dataset are not unit vectors" in line
    assert "extract it again" in line


@pytest.mark.parametrize(("key", "left"), [("cells/features", 50), ("state", 0), ("part", None)])
def test_a_store_cut_short(copied: Path, good: Path, error_of: Callable[..., str], key: str, left: int | None) -> None:
    if left is None:
        shutil.rmtree(copied / "circle-3" / key)
    else:
        chunk = next(c for c in (copied / "circle-3" / key / "c").rglob("*") if c.is_file())
        chunk.write_bytes(chunk.read_bytes()[:left])
    line = error_of("evaluate", good.parent / "b", "--dataset", copied)
    assert "drive 'circle-3' cannot be read" in line
    assert f"delete {copied / 'circle-3'} and run `offpiste extract` again" in line


def test_a_drive_without_its_cells(copied: Path, good: Path, error_of: Callable[..., str]) -> None:
    drive = copied / "circle-3"
    shutil.rmtree(drive / "cells")
    write_checksums(drive, drive.rglob("zarr.json"))
    assert "none of the features" in error_of("evaluate", good.parent / "b", "--dataset", copied)


def test_a_run_evaluated_on_what_it_was_trained_on(copied: Path, good: Path, error_of: Callable[..., str]) -> None:
    change(copied, "part", lambda values: np.full_like(values, 2))
    assert "was trained on 18 s of the test part of drive 'circle-0'" in error_of(
        "evaluate", good.parent / "b", "--dataset", copied
    )


@pytest.fixture(scope="module")
def featureless(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset without features, whose logs have neither brake nor engine."""
    path, split = tmp_path_factory.mktemp("blind") / "blind.zarr", parse_split("blocks:0.5,0.25,0.25")
    create(path, small_rig(), split)
    add_drive(path, "one", circle_rows(4000), split, ())
    return path


def test_a_dataset_without_the_features_of_a_model(
    good: Path, featureless: Path, tmp_path: Path, error_of: Callable[..., str]
) -> None:
    line = error_of("train", featureless, "--model", "dc", "--out", tmp_path / "run", *QUICK)
    assert "reads terrain features and the dataset has none" in line
    line = error_of("evaluate", good.parent / "cf", "--dataset", featureless)
    assert "reads 5 terrain features; the dataset has 0" in line


def test_absent_channels(good: Path, tmp_path: Path, error_of: Callable[..., str]) -> None:
    path, split = tmp_path / "fewer.zarr", parse_split("blocks:0.5,0.25,0.25")
    rig = small_rig()
    dataset = open_dataset(good)
    create(path, rig, split)
    add_drive(path, "one", circle_rows(4000), split, ())
    attributes = zarr.open_group(path, mode="r+").attrs
    attributes["rig"] = {**attributes["rig"], "channels": {
        name: source for name, source in attributes["rig"]["channels"].items() if name != "throttle"
    }, "absent": [*attributes["rig"].get("absent", ()), "throttle"]}  # fmt: skip
    write_checksums(path, [path / "zarr.json"])
    assert "throttle" in vehicle_of(dataset).control
    line = error_of("evaluate", good.parent / "b", "--dataset", path)
    assert "was trained with control throttle, " in line
    assert "evaluate it on a dataset whose rig has the same channels" in line


def test_another_pca(copied: Path, good: Path, error_of: Callable[..., str], tmp_path: Path) -> None:
    run = Path(shutil.copytree(good.parent / "cf", tmp_path / "cf"))
    save_json(run / "model.json", {**load_json(run / "model.json"), "pca": "one"})
    zarr.open_group(copied, mode="r+").attrs["pca"] = "other"
    write_checksums(copied, [copied / "zarr.json"])
    line = error_of("evaluate", run, "--dataset", copied)
    assert "reads features of the PCA one; the dataset's are of other" in line


def test_features_of_other_names(copied: Path, good: Path, error_of: Callable[..., str]) -> None:
    attributes = zarr.open_group(copied, mode="r+").attrs
    attributes["features"] = ["other", *attributes["features"][1:]]
    write_checksums(copied, [copied / "zarr.json"])
    line = error_of("evaluate", good.parent / "cf", "--dataset", copied)
    assert re.search("reads the terrain features (.*), (.*) …; the dataset has other, \\2 …", line)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--codes", "100000"), "--codes is 100000; give a number from 1 to 256"),
        (("--pca", "6"), "reads 6 terrain features; the dataset has 5"),
        (("--learning-rate", "nan"), "--learning-rate is nan; give a number above 0"),
    ],
)
def test_settings_out_of_range(
    good: Path, tmp_path: Path, error_of: Callable[..., str], words: tuple[str, str], why: str
) -> None:
    assert why in error_of("train", good, "--model", "cf", "--out", tmp_path / "run", *words)


def test_impossible_settings() -> None:
    refuse_impossible(TrainConfig(codes=1, pca=0, weights=Weights(yaw=0.0)))
    for settings, why in (
        ({"codes": 0}, "--codes is 0; give a number from 1 to 256"),
        ({"pca": -1}, "--pca is -1; give 0 or more"),
        ({"batch": 0}, "--batch is 0"),
        ({"stride": 0}, "--stride is 0"),
        ({"epochs": 0}, "--epochs is 0"),
        ({"seed": -1}, "--seed is -1"),
        ({"weights": Weights(yaw=-1.0)}, "weights of the loss"),
        ({"weights": Weights(0.0, 0.0, 0.0, 0.0, 0.0)}, "weights of the loss"),
    ):
        with pytest.raises(RunError, match=why):
            refuse_impossible(TrainConfig(**settings))


def test_an_unknown_feature_set_is_wrong_usage(good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as exit_:
        main(["evaluate", str(good.parent / "cf"), "--dataset", str(good), "--feature-set", "15"])
    assert exit_.value.code == 2
    assert "hindsight" in capsys.readouterr().err


def broken_run(run: Path, how: str) -> None:
    weights = run / "model.safetensors"
    if how == "no model.json":
        (run / "model.json").unlink()
    elif how == "unfinished":
        (run / "model.json").rename(run / "config.json")
    elif how == "half a model.json":
        (run / "model.json").write_text('{"model')
    elif how == "no weights":
        weights.unlink()
    elif how == "cut weights":
        weights.write_bytes(weights.read_bytes()[:200])
    elif how == "zeros":
        weights.write_bytes(bytes(4000))
    else:
        save_tensors(weights, {name: value * float("nan") for name, value in load_file(weights).items()})
        save_json(run / "model.json", {**load_json(run / "model.json"), "weights_sha256": sha256_of(weights)})


@pytest.mark.parametrize(
    ("how", "why"),
    [
        ("no model.json", "model.json: not a run"),
        ("unfinished", "training has not finished; resume it with `offpiste train --resume`"),
        ("half a model.json", "model.json: not a run"),
        ("no weights", "model.safetensors: cannot be read"),
        ("cut weights", "model.safetensors: is damaged: its checksum differs"),
        ("zeros", "model.safetensors: is damaged: its checksum differs"),
        ("not finite", "are not finite"),
    ],
)
def test_a_broken_run(good: Path, tmp_path: Path, error_of: Callable[..., str], how: str, why: str) -> None:
    run = Path(shutil.copytree(good.parent / "cf", tmp_path / "cf"))
    broken_run(run, how)
    assert why in error_of("evaluate", run, "--dataset", good)


@pytest.mark.parametrize(
    ("entry", "key", "value", "why"),
    [
        ("loss", "weights", {"yaw": "text"}, "Expected `float`, got `str` - at `$.loss.weights.yaw`"),
        ("loss", "scale", {"yaw": 1.0}, "loss.scale is impossible"),
        ("vehicle", "mass", float("inf"), "vehicle.mass is impossible"),
        ("vehicle", "codes", 1 << 31, "vehicle.codes is impossible"),
        ("vehicle", "control", ["wings"], "vehicle.control is impossible"),
    ],
)
def test_a_run_that_states_the_impossible(
    good: Path, tmp_path: Path, error_of: Callable[..., str], entry: str, key: str, value: Any, why: str
) -> None:
    run = Path(shutil.copytree(good.parent / "cf", tmp_path / "cf"))
    about = json.loads((run / "model.json").read_text())
    about[entry][key] = value
    about["sha256"] = sha256_of_json({name: content for name, content in about.items() if name != "sha256"})
    (run / "model.json").write_text(json.dumps(about))
    assert f"{run / 'model.json'}: cannot be used ({why}" in error_of("evaluate", run, "--dataset", good)


@pytest.mark.parametrize(
    ("key", "new", "why"),
    [
        ("time", lambda values: values[::-1], "'time' does not rise"),
        ("cells/index", lambda values: np.full_like(values, -7), "'cells/index' "),
        ("part", lambda values: np.full_like(values, 9), "'part' holds no parts"),
        ("cells/index", lambda values: np.full_like(values, 10_000_000), "'cells/index' exceeds the cells"),
    ],
)
def test_arrays_that_do_not_fit_together(
    copied: Path, good: Path, error_of: Callable[..., str], key: str, new: Callable[..., Any], why: str
) -> None:
    change(copied, key, new)
    assert f"drive 'circle-0' cannot be read ({why}" in error_of("evaluate", good.parent / "b", "--dataset", copied)


@pytest.mark.parametrize("key", ["state", "cells/valid"])
def test_arrays_of_another_shape(copied: Path, good: Path, error_of: Callable[..., str], key: str) -> None:
    drive = copied / "circle-0"
    values = np.array(zarr.open_array(drive / key, mode="r")[...])
    folder, name = (drive / key).parent, (drive / key).name
    zarr.open_group(folder, mode="r+").create_array(name, data=values[..., :-1], overwrite=True)
    write_checksums(drive, drive.rglob("zarr.json"))
    line = error_of("evaluate", good.parent / "b", "--dataset", copied)
    assert "drive 'circle-0' cannot be read (" in line
    assert line.endswith("circle-0 and run `offpiste extract` again\n")
