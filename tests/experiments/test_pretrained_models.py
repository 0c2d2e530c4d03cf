"""Choice and figures of models that ship."""

import numpy as np
import pytest

from experiments import pretrained_models
from experiments.pretrained_models import figures_of
from feature_datasets import dataset_with_features
from offpiste.training.config import TrainConfig
from offpiste.training.run import load_run
from offpiste.training.train import train
from offpiste.uncertainty.fit import load_spread
from window_errors import errors


def test_figures_are_of_the_windows_in_the_group_alone():
    distances = np.full(40, 2.0), np.where(np.arange(40) % 2, 1.0, 3.0)
    base, mine = (errors(distance, drives=4, every=1000) for distance in distances)
    odd = np.arange(40) % 2 == 1
    found = figures_of("odd", [mine], [base], odd)
    assert (found.group, found.windows, found.levels.drives) == ("odd", 20, 4)
    assert found.error_m.mean == pytest.approx(1.0)
    assert found.against_b.mean == pytest.approx(-0.5)
    assert figures_of("even", [mine], None, ~odd).error_m.mean == pytest.approx(3.0)
    assert figures_of("even", [mine], None, ~odd).against_b is None
    assert figures_of("all", [mine, base], [base, base], np.ones(40, bool)).levels.seeds == 2


def test_a_run_ships_with_its_uncertainty_and_without_the_machine_that_trained_it(tmp_path):
    dataset = dataset_with_features(tmp_path / "dataset.zarr")
    config = TrainConfig(model="dc", epochs=1, bicycle_epochs=1, batch=64, stride=80)
    train(dataset, config, tmp_path / "dc-0")
    pretrained_models.keep_uncertainty(load_run(tmp_path / "dc-0"), None)
    pretrained_models.copy_run(tmp_path / "dc-0", tmp_path / "out" / "dc")
    names = {path.name for path in (tmp_path / "out" / "dc").iterdir()}
    assert names == {"model.json", "model.safetensors", "spread.safetensors"}, "no PCA made its features"
    shipped = load_run(tmp_path / "out" / "dc")
    assert load_spread(shipped).state_dict()
    assert str(tmp_path) not in (tmp_path / "out" / "dc" / "model.json").read_text()
