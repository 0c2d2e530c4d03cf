"""Gains and shares with known answers, and stored errors of runs."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from experiments.gains import errors_of, gain, runs_of, same_windows, share
from feature_datasets import dataset_with_features
from offpiste.core.errors import RunError
from offpiste.dataset.windows import Windows
from offpiste.dynamics import MODELS
from offpiste.evaluation.errors import Errors
from offpiste.evaluation.intervals import PairedDifference, Sampling
from offpiste.reproduction.results import HINDSIGHT, MAP
from offpiste.training.config import TrainConfig
from offpiste.training.run import Stretch, load_run, save_run, vehicle_of
from window_errors import BASE, errors


def test_a_gain_compares_seeds_in_pairs_and_averages_them_by_window() -> None:
    found = gain("case", "dc", [errors(0.75 * BASE.distance())], [BASE], MAP)
    assert found.distance.mean == pytest.approx(-0.25)
    assert found.distance.ci95 == pytest.approx((-0.25, -0.25))
    assert found.loss.mean == pytest.approx(0.75**2 - 1)
    assert (found.n, found.levels.seeds, found.lookup) == (len(BASE.row), 1, "map")
    both = [errors(0.5 * BASE.distance()), errors(1.5 * BASE.distance())]
    assert gain("", "dc", both, [BASE], MAP).distance.mean == pytest.approx(0.0, abs=1e-12)
    others = [BASE, errors(9.0 * BASE.distance())]
    assert gain("", "dc", [errors(0.75 * BASE.distance())], others, MAP).distance.mean == pytest.approx(-0.25)


def test_share_of_the_oracle_by_hand() -> None:
    def shared(*errors: Errors) -> PairedDifference:
        return share(*(runs_of([each]) for each in errors), Sampling().on(BASE))

    # The oracle halves the error of its own baseline; the model takes off a fifth of its own: 0.2 / 0.5.
    own, better = errors(1.3 * BASE.distance()), errors(0.8 * BASE.distance())
    reached = shared(better, BASE, errors(0.5 * own.distance()), own)
    assert reached.mean == pytest.approx(0.4)
    assert reached.ci95 == pytest.approx((0.4, 0.4))
    assert np.isnan(shared(better, BASE, errors(1.1 * BASE.distance()), BASE).mean), "an oracle without a gain"
    broken = errors(np.where(BASE.row == 0, np.inf, BASE.distance()))
    assert np.isnan(shared(broken, BASE, BASE, BASE).mean)


def test_stored_errors_belong_to_one_run_its_windows_and_its_units(tmp_path: Path) -> None:
    dataset = dataset_with_features(tmp_path / "seen.zarr")
    windows, options = Windows(dataset, "test"), {"scale": torch.ones(5), "kept": tmp_path / "kept"}

    def trained(by: float) -> None:
        model, config = MODELS["parametric"](vehicle_of(dataset), seed=0), TrainConfig(model="parametric")
        for parameter in model.parameters():
            parameter.data += by
        save_run(tmp_path / "run-0", model, config, dataset, torch.ones(5))

    trained(0.0)
    run = load_run(tmp_path / "run-0")
    few, more = (errors_of(run, windows, np.array(index), HINDSIGHT, **options) for index in ([0, 50], [20, 50, 100]))
    assert few.loss[1] == more.loss[1]
    again = errors_of(run, windows, np.array([0, 50]), HINDSIGHT, **options)
    np.testing.assert_array_equal(again.values, few.values)
    assert len(list((tmp_path / "kept").rglob("*.safetensors"))) == 2
    doubled = errors_of(run, windows, np.array([0, 50]), HINDSIGHT, **{**options, "scale": torch.full((5,), 2.0)})
    assert (doubled.loss < few.loss).all()
    trained(0.1)
    assert (errors_of(load_run(run.folder), windows, np.array([0, 50]), HINDSIGHT, **options).loss != few.loss).all()

    informed = replace(run, seen=(Stretch(windows.drive_names[windows.drive[0]], 0.0, 60.0),))
    with pytest.raises(RunError, match=r"run-0: was trained on 18 s of the test part of drive"):
        errors_of(informed, windows, np.array([0, 50]), HINDSIGHT, **options)
    longer = Windows(dataset, "test", horizon=100)
    found = same_windows(windows, np.arange(0, len(windows), 7), longer)
    assert longer.row_in_drive(found).tolist() == windows.row_in_drive(np.arange(0, len(windows), 7)).tolist()
    with pytest.raises(RunError, match="same windows"):
        same_windows(longer, np.arange(len(longer)), windows)
