"""Gains by speed, world and seed: every window belongs to one band and one world, and errors are found once."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from experiments.control_experiments.reproduced import open_reproduction
from experiments.control_experiments.runs import trained
from experiments.control_experiments.strata import strata, strata_control
from feature_datasets import dataset_with_features
from offpiste.dataset.windows import Windows
from offpiste.evaluation.evaluated_windows import BANDS, REVERSE
from offpiste.reproduction.runs import errors_path
from offpiste.reproduction.settings import Size
from offpiste.training.checkpoint import save_json
from offpiste.training.config import TrainConfig

SIZE = Size("tiny", (72.0, 18.0, 18.0), stride=320, train=TrainConfig(epochs=1, bicycle_epochs=1, batch=64, stride=80))


def test_strata_from_end_to_end(tmp_path: Path) -> None:
    folder = tmp_path / "reproduced"
    folder.mkdir()
    dataset_with_features(folder / "dataset.zarr", ("train", "train", "validation", "test", "test"))
    save_json(folder / "settings.json", {"size": asdict(SIZE), "dataset": "simulated"})
    of = open_reproduction(folder)
    runs = [trained(of.dataset, of.member(m).config(of.size, 0, "cpu"), folder / "runs").folder for m in ("b", "dc")]
    windows = Windows(of.dataset, "test")
    found = strata(windows, np.arange(len(windows)))
    bands = {REVERSE, *(band.name for band in BANDS)}
    assert sum(among.sum() for name, among in found.items() if name in bands) == len(windows)
    assert found["circle"].all()
    page = strata_control(of, tmp_path / "controls")
    gains = json.loads((page.parent / "control.json").read_text("utf-8"))["gains"]
    assert [gain["lookup"] for gain in gains if not gain["case"]] == ["map", *["recorded"] * 4]
    whole, seed = gains[0], next(gain for gain in gains if gain["case"] == "seed 0")
    assert seed["error_m"] == whole["error_m"], "one seed is all of them"
    written = errors_path(runs[0], ("map", None)).stat().st_mtime_ns
    strata_control(of, tmp_path / "controls")
    assert errors_path(runs[0], ("map", None)).stat().st_mtime_ns == written
