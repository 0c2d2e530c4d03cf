"""Learning curves: nested amounts of driving, as many steps for each, and the experiment from end to end."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from experiments.control_experiments.curve import (
    Curve,
    Point,
    amounts,
    at_size,
    curve_control,
    draw_curves,
    hours_of,
    training_on,
)
from experiments.control_experiments.reproduced import open_reproduction
from experiments.control_experiments.runs import trained
from feature_datasets import dataset_with_features
from offpiste.core.conventions import DT
from offpiste.core.errors import DatasetError, RunError
from offpiste.dataset.store import Dataset
from offpiste.reproduction.settings import Size
from offpiste.training.config import TrainConfig

ROWS = 900
DRIVE = ROWS * DT / 3600
"""Hours of a drive."""

PARTS = ("train", "test", "train", "train", "validation", "train")
SIZE = Size("tiny", (72.0, 18.0, 18.0), stride=320, train=TrainConfig(epochs=1, bicycle_epochs=1, batch=128, stride=80))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return dataset_with_features(tmp_path_factory.mktemp("curve") / "dataset.zarr", PARTS, rows=ROWS)


def test_amounts_are_nested_and_come_nearest_to_what_is_asked_for(dataset: Dataset) -> None:
    found = amounts(dataset, Curve(hours=(DRIVE, 2.2 * DRIVE, 2.3 * DRIVE, 9 * DRIVE)))
    assert [len(names) for names in found] == [1, 2, 4]
    assert found[0] < found[1] < found[2] == {f"circle-{k}" for k, part in enumerate(PARTS) if part == "train"}
    assert amounts(dataset, Curve(hours=(DRIVE,), seed=0)) == found[:1], "the seed decides"
    drawn = {tuple(amounts(dataset, Curve(hours=(DRIVE,), seed=seed))[0]) for seed in range(12)}
    assert len(drawn) > 1
    with pytest.raises(DatasetError, match="to train on"):
        amounts(dataset, Curve(hours=(5 * DRIVE,)))


def test_only_drives_that_train_are_left_out(dataset: Dataset) -> None:
    fewer = training_on(dataset, {"circle-2"})
    assert [drive.name for drive in fewer.drives] == ["circle-1", "circle-2", "circle-4"]
    assert hours_of(fewer) == pytest.approx(DRIVE)
    assert hours_of(dataset) == pytest.approx(4 * DRIVE)


@pytest.mark.parametrize("share", [1.0, 0.5, 0.25, 0.24, 0.06])
def test_each_amount_takes_as_many_steps(share: float) -> None:
    whole = TrainConfig(batch=512, epochs=10, bicycle_epochs=8)
    config, windows = at_size(whole, share), 180_000
    assert config.batch == max(128, round(512 * share))
    steps = config.epochs * share * windows / config.batch
    assert steps == pytest.approx(whole.epochs * windows / whole.batch, rel=0.1)
    assert at_size(whole, 1.0) == replace(whole, seed=0)


def test_a_curve_from_end_to_end_is_resumed(tmp_path: Path) -> None:
    folder, out = tmp_path / "reproduced", tmp_path / "controls"
    folder.mkdir()
    dataset_with_features(folder / "dataset.zarr", PARTS, rows=ROWS)
    dataset_with_features(folder / "truth.zarr", PARTS, rows=ROWS)
    (folder / "settings.json").write_text(json.dumps({"size": asdict(SIZE), "dataset": "simulated"}))
    of = open_reproduction(folder)
    trained(of.dataset, of.member("b").config(of.size, 0, "cpu"), folder / "runs")
    curve = Curve(hours=(DRIVE, 4 * DRIVE), models=("b", "dc"))
    page = curve_control(of, out, curve, 1)
    points = json.loads((page.parent / "control.json").read_text("utf-8"))["points"]
    assert [(p["model"], round(p["hours"] / DRIVE)) for p in points] == [
        (model, drives) for model in ("b", "dc", "oracle") for drives in (1, 4)
    ]
    assert all(p["error_m"] > 0 for p in points)
    assert [p["against_less"] is None for p in points] == [True, False] * 3
    for less, more in zip(points[::2], points[1::2], strict=True):
        assert more["against_less"]["mean"] == pytest.approx(more["error_m"] / less["error_m"] - 1)
    by_point = {(p["model"], i % 2): p for i, p in enumerate(points)}
    for model in ("dc", "oracle"):
        less, more = ([by_point[name, amount] for name in (model, "b")] for amount in (0, 1))
        ratios = [one["error_m"] / blind["error_m"] for one, blind in (less, more)]
        assert more[0]["against_b"]["mean"] == pytest.approx(ratios[1] - 1)
        assert more[0]["gained_since"]["mean"] == pytest.approx(ratios[1] - ratios[0])
        assert less[0]["gained_since"] is by_point["b", 1]["against_b"] is None
    assert (page.parent / "curve.png").exists()
    assert not list(out.rglob(f"{4 * DRIVE:.2f}h/runs/b-0")), "the reproduction has it"
    kept = {path: path.stat().st_mtime_ns for path in out.rglob("*.safetensors")}
    curve_control(of, out, curve, 1)
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*.safetensors")} == kept
    (folder / "truth.zarr").rename(tmp_path / "elsewhere.zarr")
    curve_control(of, out, replace(curve, oracle=False), 1)
    points = json.loads((page.parent / "control.json").read_text("utf-8"))["points"]
    assert {p["model"] for p in points} == {"b", "dc"}, "no true ground is needed"
    with pytest.raises(RunError, match=r"was begun with other settings \(seed\)"):
        curve_control(of, out, replace(curve, seed=1), 1)


def test_every_model_is_drawn_with_its_interval() -> None:
    points = [
        Point(model=model, hours=hours, error_m=error, ci95=(error - 0.1, error + 0.1), against_less=None)
        for model, level in (("b", 1.2), ("oracle", 0.7))
        for hours, error in ((0.3, level), (5.0, level - 0.2))
    ]
    axes = draw_curves(points).axes[0]
    assert [line.get_label() for line in axes.lines] == ["b", "oracle"]
    np.testing.assert_allclose(axes.lines[1].get_ydata(), [0.7, 0.5])
    assert len(axes.collections) == 2
