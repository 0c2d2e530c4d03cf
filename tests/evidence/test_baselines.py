"""`b` beside its own physics: the same constants, without the network."""

from pathlib import Path

import numpy as np
import pytest
import torch

from feature_datasets import dataset_with_features
from offpiste.dataset.windows import Windows
from offpiste.dynamics import MODELS
from offpiste.evidence.baselines import baseline_gains, physics_of
from offpiste.reproduction.gains import MAP, evaluation_index, run_errors
from offpiste.training.build import vehicle_of
from offpiste.training.config import TrainConfig
from offpiste.training.run import load_run, save_run


def test_physics_have_the_constants_of_the_model_and_no_network(tmp_path: Path) -> None:
    dataset = dataset_with_features(tmp_path / "dataset.zarr", rows=900)
    config, generator = TrainConfig(model="b"), torch.Generator().manual_seed(0)
    dynamics = MODELS["b"](vehicle_of(dataset, config), seed=0)
    for parameter in dynamics.parameters():
        parameter.data += 0.1 * torch.randn(parameter.shape, generator=generator)
    save_run(tmp_path / "b-0", dynamics, config, dataset, torch.ones(5))
    run = load_run(tmp_path / "b-0")
    alone = physics_of(run.dynamics)
    assert alone is not None
    inside, mine = alone.kernel_parts(), run.dynamics.kernel_parts()
    assert inside is not None
    assert mine is not None
    assert inside.compensator is None
    for name, value in mine.bicycle.state_dict().items():
        torch.testing.assert_close(inside.bicycle.state_dict()[name], value)
    assert physics_of(MODELS["ctrv"](vehicle_of(dataset), seed=0)) is None

    over_physics, over_kinematic = baseline_gains(dataset, [run], stride=80, scale=run.scale, kept=tmp_path / "kept")
    windows = Windows(dataset, "test")
    index = evaluation_index(windows, MAP, 80)
    whole = run_errors(run, windows, index, MAP, scale=run.scale).distance().mean()
    assert over_physics.error_m == pytest.approx(whole)
    assert over_physics.baseline_error_m == over_kinematic.error_m != pytest.approx(whole)
    assert np.isfinite(over_kinematic.baseline_error_m)
