"""The fit of the actuators, which depends neither on the ground nor on the model to train."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import kill
from offpiste.dataset.store import Dataset, open_dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics.models import initial_actuators
from offpiste.training.actuator_stage import FITTED_STEPS, actuator_loss
from offpiste.training.config import TrainConfig
from offpiste.training.run import vehicle_of
from offpiste.training.train import train

QUICK = TrainConfig("b", epochs=1, bicycle_epochs=1, actuator_epochs=2, stride=60, batch=32)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("steering")
    kill.recorded_steering(folder)
    return open_dataset(folder / "features.zarr")


def test_all_models_of_a_seed_have_the_same_actuators(dataset: Dataset, tmp_path: Path) -> None:
    for model in ("b", "dc"):
        train(dataset, replace(QUICK, model=model), tmp_path / model)
    one, other = ((tmp_path / model / "actuators.safetensors").read_bytes() for model in ("b", "dc"))
    assert one == other


def test_the_loss_depends_on_motion_alone(dataset: Dataset) -> None:
    windows, lags = Windows(dataset, "train"), initial_actuators(vehicle_of(dataset), 0)
    loss = actuator_loss(lags, windows)
    index = np.arange(0, len(windows), 50)
    with torch.no_grad():
        whole = loss(windows.gather(index))
        assert torch.equal(loss(windows.without_terrain().gather(index)), whole)
        assert torch.equal(loss(windows.without_terrain(FITTED_STEPS).gather(index)), whole)
