"""The bicycle in reverse and in neutral: where the drive pushes, how it turns, that speed settles."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.test_bicycle import COUNT, SCALARS, any_constants, constants_from, euler, extremes, many_constants, speeds
from offpiste.core.conventions import DT
from offpiste.dynamics.actuators import TORCH
from offpiste.dynamics.bicycle import forces, rates


@given(any_constants, speeds, st.floats(0, 1), st.floats(0, 8))
@settings(max_examples=80, deadline=None)
def test_drive_pushes_where_the_gear_says_and_all_else_is_the_same(c, vx, throttle, engine):
    forward, neutral, reverse = (
        forces(vx, 0.1, 0.2, 0.3, 0.1, engine, throttle, gear, 0.9, c, SCALARS) for gear in (1.0, 0.0, -1.0)
    )
    assert forward.forward >= neutral.forward >= reverse.forward
    assert forward.forward - neutral.forward == pytest.approx(neutral.forward - reverse.forward, rel=1e-6, abs=1e-6)
    assert forward[1:] == neutral[1:] == reverse[1:]
    assert neutral == forces(vx, 0.1, 0.2, 0.3, 0.1, engine, 0.0, 1.0, 0.9, c, SCALARS)


@pytest.mark.parametrize(("steer", "turns"), [(0.3, -1), (-0.3, 1)])
def test_reversing_with_the_wheels_to_the_left_swings_the_nose_to_the_right(steer, turns):
    """Round the same circle as forwards, whose centre lies on the side to which the wheels point."""
    c = constants_from([0.0] * COUNT)
    vx, vy, yaw_rate = 0.0, 0.0, 0.0
    x = y = yaw = 0.0
    for _ in range(200):
        change = rates(yaw, vx, vy, yaw_rate, steer, 0.0, 0.0,
            forces(vx, vy, yaw_rate, 0.0, steer, abs(vx) / 10, 0.3, -1.0, 1.0, c, SCALARS), c, SCALARS)  # fmt: skip
        x, y, yaw = x + DT * change.px, y + DT * change.py, yaw + DT * change.yaw
        vx, vy, yaw_rate = vx + DT * change.vx, vy + DT * change.vy, yaw_rate + DT * change.yaw_rate
    assert vx < -1
    assert x < -1
    assert yaw_rate * turns > 0.1
    assert yaw * turns > 0.2
    # Backwards round a centre on the left, the vehicle ends on the left.
    assert y * steer > 0
    assert abs(y) < abs(x)


def test_throttle_in_reverse_speeds_up_backwards_and_brakes_forwards():
    c = constants_from([0.0] * COUNT)
    for start in (-3.0, 0.0, 3.0):
        vx, *_ = euler(c, start, 0.0, 0.0, throttle=0.8, gear=-1.0)
        coasting, *_ = euler(c, start, 0.0, 0.0)
        assert vx < coasting


@pytest.mark.parametrize("gear", [-1.0, 0.0, 1.0])
def test_held_at_full_throttle_speed_settles_and_never_diverges(gear):
    c = many_constants(extremes(300))._replace(engine_1=torch.zeros(300).double(), engine_2=torch.zeros(300).double())
    vx, vy, yaw_rate = (torch.zeros(300).double() for _ in range(3))
    for _ in range(1500):
        vx, vy, yaw_rate = euler(c, vx, vy, yaw_rate, throttle=1.0, gear=gear, f=TORCH)
    assert (vx * gear >= 0).all()
    assert vx.isfinite().all()
    assert vy.abs().max() == 0
