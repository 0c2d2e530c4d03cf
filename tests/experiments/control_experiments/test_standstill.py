"""From a standstill: which windows count, on which ground and slope, and whether models say that they move."""

import json
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from experiments.control_experiments import standstill
from experiments.control_experiments.models import trained
from experiments.control_experiments.reproduced import open_reproduction
from experiments.control_experiments.standstill import (
    MIXED,
    OPEN,
    at_rest,
    grouped,
    kinds_under_wheels,
    right_at_best,
    slope_along,
    standstill_control,
)
from feature_datasets import dataset_with_features
from offpiste.conventions import CONTROL
from offpiste.dataset.store import open_dataset
from offpiste.dataset.windows import Windows
from offpiste.errors import DatasetError
from offpiste.logs.ground_truth import GROUND_KINDS
from offpiste.reproduction.settings import Size
from offpiste.simulation.world.ground import property_table
from offpiste.training.config import TrainConfig

TRAIN = TrainConfig(epochs=1, bicycle_epochs=1, batch=64, stride=80, min_speed=0.0)
SIZE = Size("tiny", (72.0, 18.0, 18.0), stride=320, train=TRAIN)
STANDING = (0.0, 1e-3)


def test_kinds_need_all_four_wheels() -> None:
    dry, wet = property_table()
    cells = torch.from_numpy(np.concatenate((dry, (dry[:1] + dry[1:2]) / 2, wet)))
    mixture, mud = len(dry), GROUND_KINDS.index("mud")
    under = [[0, 0, 0, 0], [mud, mud, mixture + 1 + mud, mud], [0, 0, 0, mud], [mixture] * 4]
    ground = SimpleNamespace(features=cells, ahead=torch.tensor(under)[:, None])
    truth = SimpleNamespace(gather=lambda index: SimpleNamespace(ground=ground))
    assert kinds_under_wheels(truth, np.arange(4)) == [GROUND_KINDS[0], "mud", MIXED, MIXED]


def test_groups_by_throttle_slope_and_kind(tmp_path: Path) -> None:
    windows = Windows(dataset_with_features(tmp_path / "one.zarr"), "test")
    batch = windows.gather(np.arange(4))
    yaw = torch.tensor([0.0, np.pi / 2, 0.0, 0.0])
    state = batch.state.clone()
    state[:, 2] = yaw
    normal = torch.zeros_like(batch.terrain.normal)
    normal[..., 2] = 1.0
    steep = torch.tensor([np.sin(np.radians(10)), 0.0, np.cos(np.radians(10))], dtype=normal.dtype)
    normal[0], normal[1], normal[2] = -steep, steep, steep  # falls ahead where the normal leans ahead
    normal[0, ..., 2] = steep[2]
    control = torch.zeros_like(batch.control)
    control[:3, :, CONTROL.index("throttle")] = 2 * OPEN
    batch = replace(batch, state=state, control=control, terrain=replace(batch.terrain, normal=normal))
    np.testing.assert_allclose(slope_along(batch), [10.0, 0.0, -10.0, 0.0], atol=1e-4)
    groups = grouped(batch, ["mud", "gravel", "mud", "mud"], 149, np.array([True, False, True, True]))
    assert {name: np.flatnonzero(among).tolist() for name, among in groups.items()} == {
        "all": [0, 1, 2],
        "that move": [0, 2],
        "that stay": [1],
        "gravel": [1],
        "mud": [0, 2],
        "down": [2],
        "level": [1],
        "up": [0],
        "throttle shut": [3],
    }


def test_no_limit_is_right_more_often_than_the_best() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        predicted, moves = rng.normal(size=(12, 2)), rng.random(12) < 0.6
        distance = np.linalg.norm(predicted, axis=1)
        tried = [((distance > limit) == moves).mean() for limit in (-1.0, *distance)]
        assert right_at_best(predicted, moves) == max(tried)
    apart = np.array([[0.1, 0.0], [0.0, 0.7], [2.0, 0.0]])
    assert right_at_best(apart, np.array([False, False, True])) == 1.0, "0.7 m counts as staying at a limit of 1 m"


def test_moving_windows_are_none(tmp_path: Path) -> None:
    windows = Windows(dataset_with_features(tmp_path / "one.zarr"), "test")
    with pytest.raises(DatasetError, match=r"no window with a snapshot starts at a standstill.*--snapshot-speed 0"):
        at_rest(windows, np.arange(len(windows)))


def test_standing_vehicles_from_end_to_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "reproduced"
    folder.mkdir()
    for name, seed in (("dataset", 0), ("truth", 1)):
        dataset_with_features(folder / f"{name}.zarr", seed=seed, speeds=STANDING)
    (folder / "settings.json").write_text(json.dumps({"size": asdict(SIZE), "dataset": "simulated"}))
    of = open_reproduction(folder)
    for model in ("b", "dc"):
        trained(of.dataset, of.member(model).config(of.size, 0, "cpu"), folder / "runs")
    truth = open_dataset(folder / "truth.zarr").starting_above(0.0)
    config = replace(of.member("df").config(of.size, 0, "cpu"), pca=0)
    trained(truth, config, tmp_path / "controls" / "oracle" / "runs")
    monkeypatch.setattr(standstill, "kinds_under_wheels", lambda truth, index: [MIXED] * len(index))
    page = standstill_control(of, tmp_path / "controls")
    rows = {row["group"]: row for row in json.loads((page.parent / "control.json").read_text("utf-8"))["rows"]}
    assert rows["all"]["n"] == rows["mixed"]["n"] > 0
    assert rows["all"]["moves"] == 0, "they stand"
    windows = Windows(of.dataset, "test", min_speed=0.0)
    for model in ("b", "dc", "oracle"):
        found = rows["all"]["models"][model]
        assert 0 <= found["right"] <= found["right_at_best"] <= 1
        assert found["error_m"] >= (1 - found["right"]) * standstill.MOVED, "whoever is said to move is wrong by that"
    assert len(windows) > rows["all"]["n"]
