"""The multi-step loss on errors whose loss is known."""

import math

import pytest
import torch

from offpiste.training.losses import COMPONENTS, robust, squared_errors, summed_loss

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


def test_a_robust_loss_is_the_loss_while_small_and_a_distance_where_large():
    loss = torch.tensor([0.0, 1e-4, 0.75, 1e6, 4e6]).double()
    bent = robust(loss, 0.5)
    assert bent[:3].tolist() == pytest.approx([0, 1e-4, 0.5], rel=1e-3)  # of 3/4: 1 * (sqrt(3/4 + 1/4) - 1/2)
    assert (bent[4] / bent[3]).item() == pytest.approx(2, rel=1e-3)
    assert robust(loss, 0.0) is loss


def test_a_robust_loss_is_least_near_the_median_and_a_squared_one_at_the_mean():
    places = torch.tensor([0.0, 0.0, 0.0, 10.0])
    target = torch.zeros(4, 3, 6)
    target[..., 0] = places[:, None]
    guesses = torch.linspace(0, 10, 1001)

    def best(bend: float) -> float:
        losses = [robust(summed_loss(target * 0 + _at(x), target, ONES, ONES), bend).mean() for x in guesses]
        return guesses[torch.stack(losses).argmin()].item()

    def _at(x: torch.Tensor) -> torch.Tensor:
        return torch.cat((x.expand(1), torch.zeros(5)))

    assert best(0.0) == pytest.approx(2.5, abs=0.02)
    assert best(0.5) < 0.25


def test_gradients_equal_finite_differences():
    target = torch.randn(2, 3, 6).double()
    predicted = torch.randn(2, 3, 6).double().requires_grad_()
    scale = torch.tensor([1.0, 2.0, 3.0, 4.0, 5.0]).double()
    assert torch.autograd.gradcheck(lambda p: summed_loss(p, target, scale, ONES.double()), predicted)
