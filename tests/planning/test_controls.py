"""Bounds and rates against hand-worked values and the torch reference; throttle and brake as one pedal."""

import re

import jaxtyping
import pytest
import torch

from factories import drawn
from offpiste.planning.controls import (
    CONTROL_LIMITS,
    Limits,
    controls_of,
    keep_within,
    keep_within_stepwise,
    pedals_of,
    with_pedal,
)

STEERING = Limits((-1.0,), (1.0,), (5.0,))


def test_bounds_and_rates_by_hand():
    wanted = torch.tensor([0.9, 2.0, -3.0, -0.2, 0.1])[None, :, None]
    for keep in (keep_within, keep_within_stepwise):
        found = keep(STEERING, 0.1, wanted, torch.tensor([0.0]))[0, :, 0]
        torch.testing.assert_close(found, torch.tensor([0.5, 1.0, 0.5, 0.0, 0.1]))
        free = keep(STEERING, 0.1, wanted)[0, :, 0]
        torch.testing.assert_close(free, torch.tensor([0.9, 1.0, 0.5, 0.0, 0.1]))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("previous", [None, [0.3, 0.0, -1.4]])
def test_the_compiled_pass_equals_the_reference(dtype, previous):
    wanted = torch.randn(70, 3, 40, generator=torch.Generator().manual_seed(0), dtype=dtype).transpose(1, 2)
    wanted[3, 10, 1] = torch.nan
    wanted[4, 0, 2] = torch.inf
    before = None if previous is None else torch.tensor(previous, dtype=dtype)
    asked = wanted.clone()
    for dt in (0.02, 0.1):
        found = keep_within(CONTROL_LIMITS, dt, wanted, before)
        reference = keep_within_stepwise(CONTROL_LIMITS, dt, wanted, before)
        assert torch.equal(found.nan_to_num(9), reference.nan_to_num(9))
        assert found[3, 10:, 1].isnan().all()
    assert torch.equal(wanted.nan_to_num(9), asked.nan_to_num(9))


def test_the_compiled_pass_does_not_depend_on_the_default_type():
    wanted, before = torch.linspace(-2, 2, 96).reshape(4, 8, 3), torch.get_default_dtype()
    found = keep_within(CONTROL_LIMITS, 0.02, wanted)
    torch.set_default_dtype(torch.float64)
    try:
        assert torch.equal(keep_within(CONTROL_LIMITS, 0.02, wanted), found)
    finally:
        torch.set_default_dtype(before)


def test_shapes_that_do_not_fit_are_refused():
    jaxtyping.config.update("jaxtyping_disable", True)
    for shape, before in (((4, 3, 2), None), ((4, 3), None), ((4, 3, 3), (2,)), ((4, 3, 3), ())):
        with pytest.raises(ValueError, match=re.escape(f"controls have shape {list(shape)}")):
            keep_within(CONTROL_LIMITS, 0.02, torch.zeros(shape), before if before is None else torch.zeros(before))


def test_controls_within_limits_stay():
    slow = torch.linspace(0, 0.5, 50)[None, :, None].expand(2, -1, 3)
    assert torch.equal(keep_within(CONTROL_LIMITS, 0.02, slow, torch.zeros(3)), slow)


def test_without_rates_only_bounds_apply():
    wanted = torch.tensor([5.0, -5.0, 0.3])[None, :, None]
    assert keep_within(Limits((-1.0,), (1.0,)), 0.1, wanted)[0, :, 0].tolist() == pytest.approx([1, -1, 0.3])


def test_throttle_and_brake_are_never_pressed_together():
    feet = torch.tensor([[0.7, 0.1], [-0.4, -1.0], [0.0, 0.5]])
    assert controls_of(feet).tolist() == [[*p] for p in torch.tensor([[0.7, 0, 0.1], [0, 0.4, -1], [0, 0, 0.5]])]
    torch.testing.assert_close(pedals_of(controls_of(drawn(5, 7, 2))), drawn(5, 7, 2))
    assert (controls_of(drawn(5, 7, 2))[..., :2].prod(dim=-1) == 0).all()


def test_costs_are_those_of_the_controls():
    cost = with_pedal(lambda controls: controls.sum(dim=(1, 2)))
    torch.testing.assert_close(cost(torch.tensor([[[-0.5, 0.2]], [[0.5, 0.2]]])), torch.tensor([0.7, 0.7]))
