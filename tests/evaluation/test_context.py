"""Slow context along recorded drives: only what had come true counts, and a wrong constant is found."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from factories import circle_rows, small_rig
from offpiste.core.conventions import DT
from offpiste.core.errors import RunError
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import Dataset, add_drive, create, open_dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics import MODELS, Dynamics
from offpiste.dynamics.slow_context import SHIFTED, ContextSettings, shifted
from offpiste.evaluation.context import errors_with_context
from offpiste.evaluation.errors import positions, prediction_errors
from offpiste.evaluation.evaluate_runs import evaluate_runs
from offpiste.evaluation.report_figures.windows import WORST, predict_worst
from offpiste.evaluation.window_paths import worst_windows
from offpiste.training.build import vehicle_of
from offpiste.training.config import TrainConfig
from offpiste.training.run import load_run, save_run
from offpiste.training.short_errors import known_from, shifts_of, short_errors
from offpiste.training.train import train

SETTINGS = ContextSettings(memory=10.0)
NOISE = np.array([0.1, 0.1, 0.03])
DRIVE = list(SHIFTED).index("drive")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    path, split = tmp_path_factory.mktemp("context") / "dataset.zarr", parse_split("blocks:0.4,0.3,0.3")
    create(path, small_rig(), split)
    for number in range(2):
        add_drive(path, f"circle-{number}", circle_rows(3000, speed=4.0 + number, seed=number), split, ())
    return open_dataset(path)


@pytest.fixture(scope="module")
def model(dataset: Dataset) -> Dynamics:
    torch.manual_seed(0)
    return MODELS["parametric"].build(vehicle_of(dataset)).eval().requires_grad_(False)


def test_derivatives_are_those_of_the_predictions(dataset: Dataset, model: Dynamics) -> None:
    windows = Windows(dataset, "train")
    here, there = (
        short_errors(each, windows, SETTINGS) for each in (model, shifted(model, [0.05, 0.0, 0.0, 0.0, 0.0]))
    )
    change = here.error - there.error
    np.testing.assert_allclose(change, 0.05 * here.jacobian[:, :, DRIVE], atol=0.15 * np.abs(change).max())
    assert np.abs(change).max() > 1e-4


def test_only_what_had_come_true_counts(dataset: Dataset, model: Dynamics) -> None:
    windows = Windows(dataset, "train")
    short = short_errors(model, windows, SETTINGS)
    index = np.arange(len(windows))[:: len(windows) // 5]
    shifts = shifts_of(short, windows, index, NOISE, SETTINGS)
    for number, one in enumerate(index):
        now, drive = windows.row_in_drive(np.array([one]))[0] * DT, windows.drive[one]
        later = (short.drive != drive) | (known_from(short, SETTINGS) > now + 1e-9)
        other = replace(short, error=np.where(later[:, None], 9.0, short.error))
        np.testing.assert_array_equal(shifts_of(other, windows, np.array([one]), NOISE, SETTINGS)[0], shifts[number])
        none = replace(short, error=np.where(later[:, None], short.error, 0.0))
        np.testing.assert_array_equal(shifts_of(none, windows, np.array([one]), NOISE, SETTINGS)[0], 0.0)


def test_windows_are_predicted_with_their_own_constants(dataset: Dataset, model: Dynamics) -> None:
    windows = Windows(dataset, "train")
    index = np.arange(len(windows))[:: len(windows) // 3]
    settings = {"lookup": "recorded", "scale": torch.ones(5), "weights": torch.ones(5)}
    errors, shifts = errors_with_context(model, windows, index, NOISE, settings=SETTINGS, **settings)
    for number, one in enumerate(index):
        alone = prediction_errors(shifted(model, shifts[number]), windows, np.array([one]), **settings)
        np.testing.assert_array_equal(errors.values[number], alone.values[0])
    assert errors.distance().shape == (len(index),)
    calm = errors_with_context(model, windows, index, NOISE, settings=replace(SETTINGS, spread=1e-9), **settings)[0]
    usual = prediction_errors(model, windows, index, **settings)
    np.testing.assert_allclose(calm.values, usual.values, atol=1e-4)


def test_evaluate_shows_runs_with_and_without_context(dataset: Dataset, tmp_path: Path) -> None:
    config = TrainConfig(model="parametric", bicycle_epochs=1, batch=64, stride=40)
    train(dataset, config, tmp_path / "run")
    assert load_run(tmp_path / "run").noise is not None
    evaluation = evaluate_runs([tmp_path / "run"], dataset.path, tmp_path / "report", starts=("causal",), context=True)
    labels = {(row.model, row.variant) for row in evaluation.metrics.results}
    assert {("parametric", ""), ("parametric", "context"), ("kinematic", "")} <= labels
    errors = {case.variant: errors for case, errors in evaluation.errors.items() if case.model == "parametric"}
    np.testing.assert_array_equal(errors[""].row, errors["context"].row)
    assert not np.array_equal(errors[""].values, errors["context"].values)
    chosen = worst_windows(evaluation.errors[evaluation.shown], count=WORST)
    drawn = [
        np.linalg.norm(window.predicted["parametric (context)"][0][-1] - window.recorded[-1])
        for window in predict_worst(evaluation)
    ]
    wanted = errors["context"].distance()[positions(chosen, errors["context"])]
    np.testing.assert_allclose(drawn, wanted, atol=1e-3)
    assert np.abs(wanted - chosen.distance()).max() > 0.01, "without context it would be another picture"


def test_runs_without_noise_are_refused_in_a_line(dataset: Dataset, tmp_path: Path) -> None:
    config = TrainConfig(model="b")
    save_run(tmp_path / "old", MODELS["b"].build(vehicle_of(dataset)), config, dataset, torch.ones(5))
    with pytest.raises(RunError, match="train it again"):
        evaluate_runs([tmp_path / "old"], dataset.path, tmp_path / "report", context=True)
    save_run(
        tmp_path / "bad", MODELS["b"].build(vehicle_of(dataset)), config, dataset, torch.ones(5), None, [1.0, -1.0, 1.0]
    )
    with pytest.raises(RunError, match="noise is impossible"):
        load_run(tmp_path / "bad")


def test_two_runs_of_one_seed_are_evaluated_side_by_side(dataset: Dataset, tmp_path: Path) -> None:
    runs = [tmp_path / name for name in ("parametric", "parametric-longer")]
    for epochs, run in enumerate(runs, start=1):
        train(dataset, TrainConfig(model="parametric", bicycle_epochs=epochs, batch=64, stride=40), run)
    evaluation = evaluate_runs(runs, dataset.path, tmp_path / "report", starts=("causal",), context=True)
    labels = {row.label for row in evaluation.metrics.results if row.model == "parametric"}
    longer = "parametric-longer"
    assert labels == {
        "parametric",
        "parametric (context)",
        f"parametric ({longer})",
        f"parametric ({longer}, context)",
    }
    with pytest.raises(RunError, match=r"same seed and fold.*give each run once"):
        evaluate_runs([runs[0], runs[0]], dataset.path, tmp_path / "report", starts=("causal",))
