"""Losses of errors whose loss is known, and weights of windows by speed."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from factories import circle_rows, small_rig
from offpiste.core.conventions import MIN_EVALUATION_SPEED
from offpiste.core.errors import RunError, TrainingError
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import add_drive, create, open_dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics import ConstantMotion
from offpiste.training.config import TrainConfig
from offpiste.training.losses import COMPONENTS, LOSSES, loss_scale, speed_weights, squared_errors, summed_loss
from offpiste.training.run import vehicle_of

ONES = torch.ones(5)


def test_no_error_costs_nothing():
    target = torch.randn(3, 7, 6)
    assert (summed_loss(target, target, ONES, ONES) == 0).all()


def test_squared_errors_by_component():
    target = torch.zeros(1, 2, 6)
    predicted = target.clone()
    predicted[0, 1] = torch.tensor([3.0, 4.0, 0.1, 2.0, -1.0, 0.5])
    errors = squared_errors(predicted, target)
    assert (errors[0, 0] == 0).all()
    torch.testing.assert_close(errors[0, 1], torch.tensor([25.0, 0.01, 4.0, 1.0, 0.25]))
    assert len(COMPONENTS) == 5


@pytest.mark.parametrize("turns", [-2, 1, 3])
def test_whole_turns_of_yaw_cost_nothing(turns):
    target = torch.randn(2, 4, 6).double()
    predicted = target.clone()
    predicted[..., 2] += 2 * math.pi * turns
    assert summed_loss(predicted, target, ONES, ONES).max() < 1e-20


def test_yaw_errors_are_taken_the_short_way_round():
    target, predicted = torch.zeros(1, 1, 6), torch.zeros(1, 1, 6)
    target[..., 2], predicted[..., 2] = math.pi - 0.1, -math.pi + 0.1
    assert squared_errors(predicted, target)[0, 0, 1] == pytest.approx(0.04, rel=1e-4)


def test_the_loss_is_one_for_an_error_as_large_as_the_scale():
    target, scale = torch.zeros(1, 250, 6), torch.tensor([9.0, 0.25, 4.0, 1.0, 0.01])
    predicted = target.clone()
    predicted[..., 0] = 3.0  # as wrong as `kinematic`, in position only
    for weight in (1.0, 3.0, 0.0):
        weights = torch.tensor([weight, 1, 1, 1, 1])
        assert summed_loss(predicted, target, scale, weights).item() == pytest.approx(weight)


def test_all_steps_count_alike():
    target = torch.zeros(1, 4, 6)
    for t in range(4):
        predicted = target.clone()
        predicted[0, t, 3] = 2.0
        assert summed_loss(predicted, target, ONES, ONES).item() == pytest.approx(1.0)


def test_windows_do_not_mix():
    target, predicted = torch.zeros(2, 4, 6), torch.zeros(2, 4, 6)
    predicted[1] += 1
    loss = summed_loss(predicted, target, ONES, ONES)
    assert loss[0] == 0 < loss[1]


def test_charbonnier_equals_small_losses_and_grows_as_the_root_of_large_ones():
    loss = torch.tensor([0.0, 1e-4, 0.75, 1e6, 4e6]).double()
    squared = torch.zeros(5, 3, 5).double()
    squared[..., 0] = loss[:, None]
    bent = LOSSES["charbonnier"](squared, ONES.double())
    assert bent[:3].tolist() == pytest.approx([0, 1e-4, 0.5], rel=1e-3)  # of 3/4: 1 * (sqrt(3/4 + 1/4) - 1/2)
    assert (bent[4] / bent[3]).item() == pytest.approx(2, rel=1e-3)


@pytest.mark.parametrize(("name", "least", "within"), [("squared", 2.5, 0.02), ("charbonnier", 0.12, 0.12)])
def test_the_squared_loss_is_least_at_the_mean_and_charbonnier_near_the_median(name, least, within):
    places, guesses = torch.tensor([0.0, 0.0, 0.0, 10.0]), torch.linspace(0, 10, 1001)
    squared = torch.zeros(1001, 4, 3, 5)
    squared[..., 0] = (guesses[:, None] - places).square()[..., None]
    losses = torch.stack([LOSSES[name](each, ONES).mean() for each in squared])
    assert guesses[losses.argmin()].item() == pytest.approx(least, abs=within)


def test_an_unknown_loss_lists_those_there_are():
    with pytest.raises(RunError, match=r"no loss 'squares'; did you mean 'squared'\? there are: squared, charbonnier"):
        LOSSES["squares"]


def test_gradients_equal_finite_differences():
    target = torch.randn(2, 3, 6).double()
    predicted = torch.randn(2, 3, 6).double().requires_grad_()
    scale = torch.tensor([1.0, 2.0, 3.0, 4.0, 5.0]).double()
    assert torch.autograd.gradcheck(lambda p: summed_loss(p, target, scale, ONES.double()), predicted)


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


def test_impossible_motion_is_refused_before_a_training_begins(tmp_path: Path) -> None:
    split, rows = parse_split("blocks:1,0,0"), circle_rows(600)
    create(tmp_path / "data.zarr", small_rig(), split)
    add_drive(tmp_path / "data.zarr", "one", replace(rows, state=rows.state * 1e20), split, ())
    windows = Windows(open_dataset(tmp_path / "data.zarr"), "train")
    with pytest.raises(TrainingError, match=r"mean square error .* in position is .*: the motion is impossible"):
        loss_scale(ConstantMotion(vehicle_of(windows.dataset)), windows, TrainConfig())
