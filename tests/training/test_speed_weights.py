"""Weights by the speed at the start: none as in the paper, or errors relative to the distance."""

from pathlib import Path

import pytest
import torch

from factories import circle_rows, small_rig
from offpiste.core.conventions import MIN_EVALUATION_SPEED
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import add_drive, create, open_dataset
from offpiste.dataset.windows import Windows
from offpiste.training.losses import speed_weights


@pytest.fixture(scope="module")
def windows(tmp_path_factory: pytest.TempPathFactory) -> Windows:
    """Circles at 2 and at 8 m/s."""
    path: Path = tmp_path_factory.mktemp("data") / "dataset.zarr"
    split = parse_split("blocks:0.6,0.2,0.2")
    create(path, small_rig(), split)
    for number, speed in enumerate((2.0, 8.0)):
        add_drive(path, f"drive{number}", circle_rows(2000, speed=speed, seed=number), split, ())
    return Windows(open_dataset(path), "train")


def test_without_a_setting_all_windows_count_alike(windows: Windows) -> None:
    batch = windows.gather(windows.every(50))
    assert torch.equal(speed_weights(windows, 0.0)(batch), torch.ones(len(batch.state)))


def test_weights_have_a_mean_of_one_and_take_the_distance_out_of_squared_errors(windows: Windows) -> None:
    weigh = speed_weights(windows, 1.0)
    batch = windows.gather(windows.every(1))
    weight, speed = weigh(batch), torch.hypot(*batch.state[:, 3:5].T)
    assert weight.mean().item() == pytest.approx(1, rel=1e-4)
    distance = speed + MIN_EVALUATION_SPEED * min(1.0, (windows.dataset.rig.vehicle.wheelbase / 1.5) ** 0.5)
    assert (weight * distance.square()).std().item() == pytest.approx(0, abs=1e-4)
    assert weight[speed < 5].mean() > 5 * weight[speed > 5].mean()


def test_half_way_lies_between(windows: Windows) -> None:
    batch = windows.gather(windows.every(50))
    half, whole = (speed_weights(windows, relative)(batch) for relative in (0.5, 1.0))
    assert torch.allclose(half.square() / half.square().mean(), whole / whole.mean(), rtol=1e-4)
