"""Losses of known errors."""

import math
from dataclasses import replace

import pytest
import torch

from factories import circle_rows, dataset_in_memory, drawn
from offpiste.core.errors import TrainingError
from offpiste.dataset.windows import Windows
from offpiste.dynamics import ConstantMotion
from offpiste.training.config import TrainConfig
from offpiste.training.losses import COMPONENTS, LOSSES, loss_scale, squared_errors, summed_loss
from offpiste.training.run import vehicle_of

ONES = torch.ones(5)


def test_squared_errors_by_component():
    target = torch.zeros(1, 2, 6)
    predicted = target.clone()
    predicted[0, 1] = torch.tensor([3.0, 4.0, 0.1, 2.0, -1.0, 0.5])
    errors = squared_errors(predicted, target)
    assert (errors[0, 0] == 0).all()
    torch.testing.assert_close(errors[0, 1], torch.tensor([25.0, 0.01, 4.0, 1.0, 0.25]))
    assert len(COMPONENTS) == 5


@pytest.mark.parametrize("turns", [-2, 0, 3])
def test_yaw_errors_are_wrapped(turns):
    target = drawn(2, 4, 6)
    predicted = target.clone()
    predicted[..., 2] += 2 * math.pi * turns
    assert summed_loss(predicted, target, ONES, ONES).max() < 1e-20
    target[..., 2], predicted[..., 2] = math.pi - 0.1, -math.pi + 0.1
    assert squared_errors(predicted, target)[0, 0, 1] == pytest.approx(0.04, rel=1e-4)


def test_the_loss_is_one_for_an_error_as_large_as_the_scale():
    target, scale = torch.zeros(1, 250, 6), torch.tensor([9.0, 0.25, 4.0, 1.0, 0.01])
    predicted = target.clone()
    predicted[..., 0] = 3.0  # as wrong as `kinematic`, in position only
    for weight in (1.0, 3.0, 0.0):
        weights = torch.tensor([weight, 1, 1, 1, 1])
        assert summed_loss(predicted, target, scale, weights).item() == pytest.approx(weight)


def test_charbonnier_equals_small_losses_and_grows_as_the_root_of_large_ones():
    loss = torch.tensor([0.0, 1e-4, 0.75, 1e6, 4e6]).double()
    squared = torch.zeros(5, 3, 5).double()
    squared[..., 0] = loss[:, None]
    bent = LOSSES["charbonnier"](squared, ONES.double())
    assert bent[:3].tolist() == pytest.approx([0, 1e-4, 0.5], rel=1e-3)  # of 3/4: 1 * (sqrt(3/4 + 1/4) - 1/2)
    assert (bent[4] / bent[3]).item() == pytest.approx(2, rel=1e-3)


def test_gradients_equal_finite_differences():
    target, predicted = drawn(2, 3, 6), drawn(2, 3, 6, seed=1).requires_grad_()
    scale = torch.tensor([1.0, 2.0, 3.0, 4.0, 5.0]).double()
    assert torch.autograd.gradcheck(lambda p: summed_loss(p, target, scale, ONES.double()), predicted)


def test_impossible_motion_is_refused_before_training() -> None:
    rows = circle_rows(600)
    windows = Windows(dataset_in_memory({"one": replace(rows, state=rows.state * 1e20)}, "blocks:1,0,0"), "train")
    with pytest.raises(TrainingError, match=r"mean square error .* in position is .*: the motion is impossible"):
        loss_scale(ConstantMotion(vehicle_of(windows.dataset)), windows, TrainConfig())
