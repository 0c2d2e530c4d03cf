"""Conversion between throttle and brake and a single pedal."""

import torch

from offpiste.planning.pedal import controls_of, pedals_of, with_pedal


def test_throttle_and_brake_are_never_pressed_together():
    feet = torch.tensor([[0.7, 0.1], [-0.4, -1.0], [0.0, 0.5]])
    assert controls_of(feet).tolist() == [[*p] for p in torch.tensor([[0.7, 0, 0.1], [0, 0.4, -1], [0, 0, 0.5]])]
    random = torch.rand(5, 7, 2) * 2 - 1
    torch.testing.assert_close(pedals_of(controls_of(random)), random)
    assert (controls_of(random)[..., :2].prod(dim=-1) == 0).all()


def test_costs_are_those_of_the_controls():
    cost = with_pedal(lambda controls: controls.sum(dim=(1, 2)))
    torch.testing.assert_close(cost(torch.tensor([[[-0.5, 0.2]], [[0.5, 0.2]]])), torch.tensor([0.7, 0.7]))
