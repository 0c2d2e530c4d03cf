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

from cli.command import refusal, run
from factories import circle_dataset, circle_rows
from feature_datasets import dataset_with_features
from offpiste.core.checksums import sha256_of, sha256_of_json, write_checksums
from offpiste.core.errors import RunError
from offpiste.dataset.store import open_dataset
from offpiste.training.checkpoint import load_json, save_json, save_tensors
from offpiste.training.config import TrainConfig, Weights, refuse_impossible
from offpiste.training.run import build, save_run, vehicle_of

Fault = Callable[[Path], object]
TRAIN = "train {data} --out {out} --epochs 1 --bicycle-epochs 1 --actuator-epochs 1 --stride 100 --batch 64"
TRAIN_CF, TRAIN_DC = f"{TRAIN} --model cf", f"{TRAIN} --model dc"
EVALUATE, EVALUATE_CF = "evaluate {runs}/b --dataset {data}", "evaluate {runs}/cf --dataset {data}"


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset with features by distance, and beside it runs `b` and `cf` whose weights are as they were drawn."""
    folder = tmp_path_factory.mktemp("refusals")
    path = dataset_with_features(folder / "good.zarr").path
    zarr.open_group(path, mode="r+").attrs["pca"] = "ours"
    write_checksums(path, [path / "zarr.json"])
    dataset = open_dataset(path)
    for model in ("b", "cf"):
        config = TrainConfig(model=model)
        save_run(folder / model, build(model, vehicle_of(dataset), seed=0), config, dataset, torch.ones(5))
    return path


def changed(key: str, new: Callable[[np.ndarray], Any]) -> Fault:
    """Change an array of all drives; its checksum fits again."""

    def fault(path: Path) -> None:
        for folder in path.glob(f"*/{key}"):
            with zarr.config.set({"array.write_empty_chunks": True}):
                array = zarr.open_array(folder, mode="r+")
                array[...] = new(np.array(array[...]))

    return fault


def narrower(key: str) -> Fault:
    """Drop the last column of an array."""

    def fault(path: Path) -> None:
        array = path / "circle-0" / key
        values = np.array(zarr.open_array(array, mode="r")[...])
        zarr.open_group(array.parent, mode="r+").create_array(array.name, data=values[..., :-1], overwrite=True)
        write_checksums(path / "circle-0", (path / "circle-0").rglob("zarr.json"))

    return fault


def without_cells(path: Path) -> None:
    shutil.rmtree(path / "circle-3" / "cells")
    write_checksums(path / "circle-3", (path / "circle-3").rglob("zarr.json"))


def renamed_feature(path: Path) -> None:
    attributes = zarr.open_group(path, mode="r+").attrs
    attributes["features"] = ["other", *attributes["features"][1:]]
    write_checksums(path, [path / "zarr.json"])


def one_drive(path: Path) -> None:
    shutil.rmtree(path)
    dataset_with_features(path, ("train",))


def featureless(path: Path) -> None:
    """A dataset without features, whose log has neither brake nor engine."""
    shutil.rmtree(path)
    circle_dataset(path, circle_rows(4000))


def without_throttle(path: Path) -> None:
    featureless(path)
    attributes = zarr.open_group(path, mode="r+").attrs
    channels = {name: source for name, source in attributes["rig"]["channels"].items() if name != "throttle"}
    attributes["rig"] |= {"channels": channels, "absent": [*attributes["rig"].get("absent", ()), "throttle"]}
    write_checksums(path, [path / "zarr.json"])


def rows_replaced(values: np.ndarray) -> np.ndarray:
    values[100:130] = np.nan
    return values


def tilted(height: float) -> Fault:
    up = lambda values: np.concatenate((values[..., :2], np.full_like(values[..., 2:], height)), -1)  # noqa: E731
    return changed("normal", up)


NO_FEATURES = changed("cells/valid", np.zeros_like)
NOT_FINITE = (
    r"drive 'circle-0' cannot be read \('state_causal' is not finite in 30 rows marked complete, the first.*row 100"
)
UNREADABLE = r"drive 'circle-0' cannot be read \("


@pytest.mark.parametrize(
    ("fault", "command", "why"),
    [
        (NO_FEATURES, TRAIN_CF, "{data}.*all terrain features are missing"),
        (NO_FEATURES, TRAIN_DC, "{data}.*all terrain features are missing"),
        (NO_FEATURES, f"{EVALUATE_CF} --out {{out}}", "'cf' reads terrain features"),
        (one_drive, TRAIN, "the validation part has no window of 5 s, and no row"),
        (one_drive, EVALUATE, "the test part has no window of 5 s, and no row.*1 drive"),
        (changed("state_causal", rows_replaced), TRAIN, NOT_FINITE),
        (changed("state_causal", rows_replaced), EVALUATE, NOT_FINITE),
        (
            changed("cells/features", lambda values: np.full_like(values, np.nan)),
            TRAIN_CF,
            "terrain features of the dataset are not finite.*extract it again",
        ),
        (tilted(2.0), TRAIN_CF, "surface normals of the dataset are not unit vectors.*extract it again"),
        (tilted(np.nan), TRAIN_CF, "surface normals of the dataset are not unit vectors.*extract it again"),
        (without_cells, EVALUATE, "none of the features"),
        (
            changed("part", lambda values: np.full_like(values, 2)),
            EVALUATE,
            "was trained on 18 s of the test part of drive 'circle-0'",
        ),
        (featureless, TRAIN_DC, "reads terrain features and the dataset has none"),
        (featureless, EVALUATE_CF, "reads 5 terrain features; the dataset has 0"),
        (
            without_throttle,
            EVALUATE,
            "was trained with control throttle, .*evaluate it on a dataset whose rig has the same channels",
        ),
        (renamed_feature, EVALUATE_CF, r"reads the terrain features (.*), (.*) …; the dataset has other, \2 …"),
        (changed("time", lambda values: values[::-1]), EVALUATE, rf"{UNREADABLE}'time' does not rise"),
        (changed("cells/index", lambda values: np.full_like(values, -7)), EVALUATE, rf"{UNREADABLE}'cells/index' "),
        (changed("part", lambda values: np.full_like(values, 9)), EVALUATE, rf"{UNREADABLE}'part' holds no parts"),
        (
            changed("cells/index", lambda values: np.full_like(values, 10_000_000)),
            EVALUATE,
            rf"{UNREADABLE}'cells/index' exceeds the cells",
        ),
        (narrower("state"), EVALUATE, rf"{UNREADABLE}.*circle-0 and run `offpiste extract` again$"),
        (narrower("cells/valid"), EVALUATE, rf"{UNREADABLE}.*circle-0 and run `offpiste extract` again$"),
    ],
)
def test_a_fault_of_a_dataset(good, tmp_path, capsys, fault, command, why):
    places = {"data": shutil.copytree(good, tmp_path / "broken.zarr"), "runs": good.parent, "out": tmp_path / "out"}
    fault(tmp_path / "broken.zarr")
    line = refusal(capsys, *command.format(**places).split())
    assert re.search(why.replace("{data}", str(places["data"])), line), line
    assert command.startswith("train") or not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("--model cf --pca 6", "reads 6 terrain features; the dataset has 5"),
        ("--batch 5000", "fewer than a batch (5000)"),
    ],
)
def test_settings_that_do_not_fit_the_dataset(good, tmp_path, capsys, words, why):
    assert why in refusal(capsys, "train", good, "--out", tmp_path / "run", *words.split())
    assert not (tmp_path / "run").exists(), "a folder that cannot be filled is not begun"


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        *(({"codes": codes}, f"invalid --codes {codes}; give a number from 1 to 256") for codes in (0, 257)),
        ({"learning_rate": float("nan")}, "invalid --learning-rate nan; give a number above 0"),
        ({"pca": -1}, "invalid --pca -1; give 0 or more"),
        *(({name: 0}, f"invalid --{name} 0") for name in ("batch", "stride", "epochs")),
        ({"seed": -1}, "invalid --seed -1"),
        ({"weights": Weights(yaw=-1.0)}, "loss weights"),
        ({"weights": Weights(0.0, 0.0, 0.0, 0.0, 0.0)}, "loss weights"),
    ],
)
def test_impossible_settings(settings, why):
    refuse_impossible(TrainConfig(codes=1, pca=0, weights=Weights(yaw=0.0)))
    with pytest.raises(RunError, match=why):
        refuse_impossible(TrainConfig(**settings))


def test_an_unknown_feature_set_is_wrong_usage(good, capsys):
    assert run("evaluate", good.parent / "cf", "--dataset", good, "--feature-set", "15") == 2
    assert "hindsight" in capsys.readouterr().err


def weights_not_finite(run: Path) -> None:
    weights = run / "model.safetensors"
    save_tensors(weights, {name: value * float("nan") for name, value in load_file(weights).items()})
    save_json(run / "model.json", {**load_json(run / "model.json"), "weights_sha256": sha256_of(weights)})


def stated(entry: str, key: str, value: Any) -> Fault:
    """Change what a run says of itself; its checksum fits again."""

    def fault(run: Path) -> None:
        about = json.loads((run / "model.json").read_text())
        about[entry][key] = value
        about["sha256"] = sha256_of_json({name: content for name, content in about.items() if name != "sha256"})
        (run / "model.json").write_text(json.dumps(about))

    return fault


ABOUT, WEIGHTS = "model.json", "model.safetensors"
UNUSABLE = "{run}/model.json: cannot be used ("


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        (lambda run: (run / ABOUT).unlink(), f"{ABOUT}: not a run"),
        (
            lambda run: (run / ABOUT).rename(run / "config.json"),
            "training has not finished; resume it with `offpiste train --resume`",
        ),
        (lambda run: (run / ABOUT).write_text('{"model'), f"{ABOUT}: not a run"),
        (lambda run: (run / WEIGHTS).unlink(), f"{WEIGHTS}: cannot be read"),
        (lambda run: (run / WEIGHTS).write_bytes(bytes(4000)), f"{WEIGHTS}: is damaged: its checksum differs"),
        (weights_not_finite, "are not finite"),
        (
            lambda run: save_json(run / ABOUT, {**load_json(run / ABOUT), "pca": "one"}),
            "reads features of PCA one; the dataset's were made with PCA ours",
        ),
        (
            stated("loss", "weights", {"yaw": "text"}),
            f"{UNUSABLE}Expected `float`, got `str` - at `$.loss.weights.yaw`",
        ),
        (stated("loss", "scale", {"yaw": 1.0}), f"{UNUSABLE}loss.scale is impossible"),
        (stated("vehicle", "mass", float("inf")), f"{UNUSABLE}vehicle.mass is impossible"),
        (stated("vehicle", "codes", 1 << 31), f"{UNUSABLE}vehicle.codes is impossible"),
        (stated("vehicle", "control", ["wings"]), f"{UNUSABLE}vehicle.control is impossible"),
    ],
)
def test_a_fault_of_a_run(good, tmp_path, capsys, fault, why):
    run = Path(shutil.copytree(good.parent / "cf", tmp_path / "cf"))
    fault(run)
    assert why.replace("{run}", str(run)) in refusal(capsys, "evaluate", run, "--dataset", good)
