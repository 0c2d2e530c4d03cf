"""Constants obey their constraints whatever the optimiser does to the parameters behind them."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from factories import COMMANDED
from offpiste.core.conventions import DT, GRAVITY
from offpiste.dynamics.bicycle import BicycleConstants, Constants

COUNT = BicycleConstants(COMMANDED).raw.numel()


def constants_from(raw: list[float]) -> Constants:
    module = BicycleConstants(COMMANDED).double()
    module.raw.data = torch.tensor(raw, dtype=torch.float64)
    return Constants(*(float(c.detach()) for c in module()))


any_raw = st.lists(st.floats(-30, 30), min_size=COUNT, max_size=COUNT)


@given(any_raw)
@settings(max_examples=100, deadline=None)
def test_constraints_hold_for_every_raw_value(raw):
    c = constants_from(raw)
    nearly = 1e-6
    for name in ("rear_peak", "rear_stiffness", "front_peak", "front_stiffness", "yaw_gain", "drag_x", "drag_y"):
        assert getattr(c, name) >= 0
    for peak, shape in ((c.front_peak, c.front_shape), (c.rear_peak, c.rear_shape)):
        assert peak / c.mass <= GRAVITY * (1 + nearly)
        assert shape >= 0
        assert math.sin(max(shape, math.pi / 2)) >= 0.7
    for length in (c.rear_length, c.front_length):
        assert 0 <= length <= COMMANDED.wheelbase * (1 + nearly)
    assert max(c.drag_x, c.drag_y) <= 0.05 * (1 + nearly)
    assert c.brake_1 >= 0 <= c.brake_2
    assert c.resistance >= 0 <= c.resistance_slope
    for pull in (c.gravity_x, c.gravity_y):
        assert 0 <= pull <= 1.1 * GRAVITY * (1 + nearly)
    assert 0 < c.yaw_damping * DT < 1
    stiffness = c.front_peak * c.front_shape * c.front_stiffness + c.rear_peak * c.rear_shape * c.rear_stiffness
    assert 1 - nearly <= c.min_slip_speed / (DT * stiffness / c.mass) <= 4 * (1 + nearly) or stiffness < 1e-9
    assert c.yaw_gain / c.yaw_damping * (c.rear_length + c.front_length) <= 1 + nearly


@given(any_raw, st.floats(0, 1))
@settings(max_examples=100, deadline=None)
def test_the_throttle_polynomial_rises_from_zero(raw, throttle):
    c = constants_from(raw)
    assert c.drive_1 + 2 * c.drive_2 * throttle >= -1e-6 * c.mass


def test_learning_begins_at_a_plausible_vehicle():
    c = Constants(*(float(x.detach()) for x in BicycleConstants(COMMANDED).double()()))
    assert c.gravity_x == pytest.approx(GRAVITY, rel=1e-6)
    assert c.rear_length == pytest.approx(COMMANDED.wheelbase / 2, rel=1e-6)
    assert c.yaw_gain / c.yaw_damping == pytest.approx(0.9 / COMMANDED.wheelbase, rel=1e-6)
    assert 2 * (c.drive_1 + c.drive_2) / c.mass == pytest.approx(3.0, rel=1e-6)
    assert c.min_slip_speed < 1.5


def test_gradients_of_constants_equal_finite_differences():
    module = BicycleConstants(COMMANDED).double()
    raw = torch.linspace(-2, 2, COUNT, dtype=torch.float64, requires_grad=True)

    def values(raw):
        scaled = torch.func.functional_call(module, {"raw": raw}, ())
        return torch.stack(tuple(scaled)) / COMMANDED.mass

    assert torch.autograd.gradcheck(values, (raw,))


def test_all_constants_follow_the_modules_type():
    for dtype in (torch.float32, torch.float64):
        assert {c.dtype for c in BicycleConstants(COMMANDED).to(dtype)()} == {dtype}
