"""The scalar physics against the paper's equations worked a second time, and against what physics forbids."""

import math

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from torch.func import functional_call, jacfwd, vmap

from factories import COMMANDED
from offpiste.core.conventions import DT
from offpiste.dynamics.actuators import TORCH
from offpiste.dynamics.bicycle import (
    STANDSTILL,
    BicycleConstants,
    Constants,
    Elementary,
    Force,
    forces,
    rates,
    slip_angles,
)

SCALARS = Elementary(math.sin, math.cos, math.tanh, math.atan, max)
COUNT = BicycleConstants(COMMANDED).raw.numel()


def constants_from(raw: list[float]) -> Constants:
    module = BicycleConstants(COMMANDED).double()
    module.raw.data = torch.tensor(raw, dtype=torch.float64)
    return Constants(*(float(c.detach()) for c in module()))


def extremes(count: int, seed: int = 0) -> torch.Tensor:
    """Raw parameters of many bicycles: half with every constant at an end of its range, half anywhere."""
    generator = torch.Generator().manual_seed(seed)
    ends = torch.where(torch.rand(count // 2, COUNT, generator=generator) < 0.5, -15.0, 15.0)
    return torch.cat((ends, 4 * torch.randn(count - count // 2, COUNT, generator=generator))).double()


def many_constants(raw: torch.Tensor) -> Constants:
    """Constants with a batch of values each."""
    module = BicycleConstants(COMMANDED).double()
    columns = vmap(lambda one: torch.stack(tuple(functional_call(module, {"raw": one}, ()))))(raw)
    return Constants(*columns.detach().unbind(-1))


any_constants = st.lists(st.floats(-12, 12), min_size=COUNT, max_size=COUNT).map(constants_from)
speeds = st.floats(-20, 20)
angles = st.floats(-0.6, 0.6)
UP = (0.0, 0.0, 1.0)


def euler(c, vx, vy, yaw_rate, *, brake=0.0, steer=0.0, throttle=0.0, engine=0.0, gear=1.0, up=UP, f=SCALARS):
    """vx, vy and yaw rate one step later."""
    brake, steer, throttle, engine = (0 * vx + value for value in (brake, steer, throttle, engine))
    force = forces(vx, vy, yaw_rate, brake, steer, engine, throttle, gear, up[2], c, f)
    change = rates(0 * vx, vx, vy, yaw_rate, steer, up[0], up[1], force, c, f)
    return vx + DT * change.vx, vy + DT * change.vy, yaw_rate + DT * change.yaw_rate


def paper(x, u, eta, c):
    """Eqs. 1-4 from the paper's text with the changes of docs/method.md, written for one vehicle with NumPy."""
    phi, vx, vy, r = x
    throttle, brake, delta, rpm, gear = u
    below = max(c.min_slip_speed, abs(vx))
    alpha_r = np.arctan((vy - c.rear_length * r) / below)
    alpha_f = np.arctan((vy + c.front_length * r) / below) - delta * np.clip(vx / c.min_slip_speed, -1, 1)
    p_rpm = max(np.polyval([c.engine_2, c.engine_1, 1], rpm), 0)
    p_throttle = np.polyval([c.drive_2, c.drive_1, 0], throttle)
    p_brake = np.polyval([c.brake_2, c.brake_1, 0], max(brake, 0))
    beta = c.resistance * np.tanh(c.resistance_slope * vx)
    f_x = (gear * p_rpm * p_throttle - p_brake * np.tanh(vx / 0.25) - beta) * eta[2]
    f_yf = -c.front_peak * np.sin(c.front_shape * np.tanh(c.front_stiffness * alpha_f)) * eta[2]
    f_yr = -c.rear_peak * np.sin(c.rear_shape * np.tanh(c.rear_stiffness * alpha_r)) * eta[2]
    f_r = c.yaw_gain * vx * delta - c.yaw_damping * r
    turn = np.array([[np.cos(phi), -np.sin(phi)], [np.sin(phi), np.cos(phi)]])
    return np.concatenate(
        (
            turn @ [vx, vy],
            [
                r,
                ((1 + np.cos(delta)) * f_x - f_yf * np.sin(delta)) / c.mass
                - c.drag_x * vx * abs(vx)
                + c.gravity_x * eta[0]
                + vy * r,
                (f_yr + np.cos(delta) * f_yf + f_x * np.sin(delta)) / c.mass
                - c.drag_y * vy * abs(vy)
                + c.gravity_y * eta[1]
                - vx * r,
                f_r,
            ],
        )
    )


@pytest.mark.parametrize("seed", range(20))
def test_equations_equal_the_papers_worked_again(seed):
    rng = np.random.default_rng(seed)
    c = constants_from(list(rng.normal(0, 2, COUNT)))
    phi, vx, vy, r = rng.uniform((-3, -5, -2, -1), (3, 12, 2, 1))
    throttle, brake, delta, rpm = rng.uniform((0, -0.1, -0.5, 0), (1, 1, 0.5, 5))
    gear = seed % 3 - 1.0
    eta = np.array([0, 0, 1]) + rng.normal(0, 0.2, 3)
    eta /= np.linalg.norm(eta)
    force = forces(vx, vy, r, brake, delta, rpm, throttle, gear, eta[2], c, SCALARS)
    ours = rates(phi, vx, vy, r, delta, eta[0], eta[1], force, c, SCALARS)
    np.testing.assert_allclose(ours, paper((phi, vx, vy, r), (throttle, brake, delta, rpm, gear), eta, c), rtol=1e-12)


def test_a_case_worked_by_hand():
    c = Constants(**dict.fromkeys(Constants._fields, 0.0))._replace(
        drive_1=800.0, drive_2=400.0, engine_1=0.5, brake_1=200.0, resistance=100.0, resistance_slope=4.0,
        min_slip_speed=1.0, yaw_gain=2.0, yaw_damping=3.0, drag_x=0.01, gravity_x=9.0, mass=1000.0,
    )  # fmt: skip
    force = forces(10.0, 0.0, 0.5, 0.5, 0.1, 2.0, 0.5, 1.0, 0.9, c, SCALARS)
    # Drive (1 + 1)(400 + 100) = 1000 N, brakes 100 N, rolling 100 N, all times 0.9; yaw 2*10*0.1 - 3*0.5.
    assert force.forward == pytest.approx(720.0)
    assert force.yaw == pytest.approx(0.5)
    change = rates(0.0, 10.0, 0.0, 0.5, 0.0, -0.1, 0.0, force, c, SCALARS)
    assert change.vx == pytest.approx(2 * 0.72 - 1.0 - 0.9)
    assert change.vy == pytest.approx(-5.0)


@given(any_constants, speeds, st.floats(-10, 10), st.floats(-3, 3), angles)
@settings(max_examples=80, deadline=None)
def test_tyres_oppose_slip_at_every_slip_angle(c, vx, vy, yaw_rate, steer):
    rear, front = slip_angles(vx, vy, yaw_rate, steer, c, SCALARS)
    force = forces(vx, vy, yaw_rate, 0.0, steer, 0.0, 0.0, 1.0, 1.0, c, SCALARS)
    assert force.lateral_rear * rear <= 0
    assert force.lateral_front * front <= 0
    assert force.lateral_rear != 0 or abs(rear) < 1e-6
    assert force.lateral_front != 0 or abs(front) < 1e-6


SLIP = Constants(**dict.fromkeys(Constants._fields, 0.0))._replace(
    rear_length=1.0, front_length=1.0, min_slip_speed=1.25
)


@pytest.mark.parametrize(
    ("vx", "rear", "front"),
    [
        (5.0, math.atan(-0.1 / 5), math.atan(0.5 / 5) - 0.1),
        (1.25, math.atan(-0.08), math.atan(0.4) - 0.1),
        (0.625, math.atan(-0.08), math.atan(0.4) - 0.05),
        (0.0, math.atan(-0.08), math.atan(0.4)),
        (-0.625, math.atan(-0.08), math.atan(0.4) + 0.05),
        (-5.0, math.atan(-0.1 / 5), math.atan(0.5 / 5) + 0.1),
    ],
)
def test_slip_worked_by_hand_all_of_the_steering_angle_enters_above_c_max(vx, rear, front):
    """vy 0.2 m/s, yaw rate 0.3 rad/s, steered 0.1 rad, axles 1 m from the pose point: they move at -0.1 and 0.5 m/s."""
    assert slip_angles(vx, 0.2, 0.3, 0.1, SLIP, SCALARS) == pytest.approx((rear, front), rel=1e-12)


@pytest.mark.parametrize("steer", [-0.3, 0.1])
@pytest.mark.parametrize("vx", [0.02, 0.3, 1.0, 1.3, 8.0, -0.3, -8.0])
def test_wheels_that_roll_where_they_point_do_not_slip_at_any_speed(vx, steer):
    yaw_rate = vx * math.tan(steer) / 2
    rear, front = slip_angles(vx, yaw_rate, yaw_rate, steer, SLIP, SCALARS)
    assert rear == 0
    assert abs(front) < 0.04 * abs(steer)
    assert abs(front) < 1e-12 or abs(vx) < SLIP.min_slip_speed


def test_slip_counts_against_the_motion_in_reverse_too():
    c = constants_from([0.0] * COUNT)
    for vx in (30.0, -30.0):
        _, front = slip_angles(vx, 0.0, 0.0, 0.2, c, SCALARS)
        force = forces(vx, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0, 1.0, 1.0, c, SCALARS)
        # Wheels turned left push the front to the left going forward, to the right in reverse.
        assert math.copysign(1, force.lateral_front) == math.copysign(1, vx) == -math.copysign(1, front)


@given(any_constants, speeds, angles)
@settings(max_examples=50, deadline=None)
def test_yaw_acceleration_has_the_sign_of_steer_times_speed(c, vx, steer):
    assume(abs(vx * steer) > 1e-6)
    assert forces(vx, 0.0, 0.0, 0.0, steer, 0.0, 0.0, 1.0, 1.0, c, SCALARS).yaw * vx * steer > 0


@given(any_constants, speeds, st.floats(-0.5, 1))
@settings(max_examples=80, deadline=None)
def test_brakes_drag_and_rolling_never_accelerate(c, vx, brake):
    slower, vy, yaw_rate = euler(c, vx, 0.0, 0.0, brake=brake)
    assert abs(slower) <= abs(vx)
    assert vy == yaw_rate == 0


@given(any_constants, speeds, st.floats(0, 1), st.floats(0, 1))
@settings(max_examples=80, deadline=None)
def test_more_brake_never_pushes_along_the_motion(c, vx, one, other):
    less, more = sorted((one, other))
    forward = [forces(vx, 0.0, 0.0, b, 0.0, 0.0, 0.0, 1.0, 1.0, c, SCALARS).forward for b in (less, more)]
    assert (forward[1] - forward[0]) * vx <= 0


@given(any_constants, st.floats(0, 1), st.floats(0, 1), st.floats(0, 8))
@settings(max_examples=80, deadline=None)
def test_drive_rises_with_throttle_at_every_engine_speed(c, one, other, engine):
    less, more = sorted((one, other))
    forward = [forces(5.0, 0.0, 0.0, 0.0, 0.0, engine, u, 1.0, 1.0, c, SCALARS).forward for u in (0.0, less, more)]
    assert forward[0] <= forward[1] + 1e-9 <= forward[2] + 2e-9


@given(any_constants, st.floats(0.01, 0.3), speeds)
@settings(max_examples=50, deadline=None)
def test_climbing_slows_and_a_bank_pulls_down(c, tilt, vx):
    level, *_ = euler(c, vx, 0.0, 0.0)
    climbing, *_ = euler(c, vx, 0.0, 0.0, up=(-tilt, 0.0, 1.0))
    _, sideways, _ = euler(c, 0.0, 0.0, 0.0, up=(0.0, -tilt, 1.0))
    assert climbing < level
    assert sideways < 0


@given(any_constants, speeds, st.floats(-5, 5))
@settings(max_examples=80, deadline=None)
def test_kinetic_energy_does_not_grow_when_coasting_straight(c, vx, vy):
    assert math.hypot(*euler(c, vx, vy, 0.0)[:2]) <= math.hypot(vx, vy) * (1 + 1e-12)


@pytest.mark.parametrize("steer", [0.1, 0.4])
@pytest.mark.parametrize("start", [0.1, 1.0, 5.0, -0.1, -1.0, -5.0])
def test_coasting_with_the_wheels_turned_gains_no_speed(steer, start):
    """For constants about as learning begins. At the ends of all ranges the paper's yaw equation, which knows no tyre
    moment, still feeds some energy into a turn (at most 0.5 % of corners of the box)."""
    raw = BicycleConstants(COMMANDED).raw.detach().double()
    c = many_constants(raw + 0.5 * torch.randn(200, COUNT, generator=torch.Generator().manual_seed(1)).double())
    vx, vy, yaw_rate = torch.full((200,), start).double(), torch.zeros(200).double(), torch.zeros(200).double()
    for _ in range(100):
        vx, vy, yaw_rate = euler(c, vx, vy, yaw_rate, steer=steer, f=TORCH)
        assert torch.hypot(vx, vy).max() < abs(start)


def test_wheels_held_turned_at_standstill_are_stable_for_all_constants():
    """No perpetual motion: about rest, the step's eigenvalues stay in the unit circle with the wheels turned too."""
    module = BicycleConstants(COMMANDED).double()

    def step(velocity, raw):
        return torch.stack(euler(functional_call(module, {"raw": raw}, ()), *velocity, steer=0.4, f=TORCH))

    jacobian = vmap(jacfwd(step))(torch.zeros(1000, 3).double(), extremes(1000))
    assert torch.linalg.eigvals(jacobian).abs().max() <= 1 + 1e-9


def test_euler_is_stable_at_every_speed_for_all_constants():
    """Eigenvalues of the step, linearised about straight running, lie in the unit circle."""
    module = BicycleConstants(COMMANDED).double()

    def step(velocity, raw, brake):
        c = functional_call(module, {"raw": raw}, ())
        return torch.stack(euler(c, *velocity, brake=brake, f=TORCH))

    raw = extremes(400)
    for speed in (0.0, 1.0, 20.0, -1.0, -20.0):
        for brake in (0.0, 1.0):
            velocity = torch.tensor([speed, 0.0, 0.0]).double().expand(400, 3)
            jacobian = vmap(jacfwd(step))(velocity, raw, torch.full((400,), brake).double())
            assert torch.linalg.eigvals(jacobian).abs().max() <= 1 + 1e-9


def test_the_bound_on_slip_speed_is_half_of_where_euler_breaks():
    """At C_max = dt S / m the slip of a parked car is gone in one step; at just below half of it, it grows."""
    c = constants_from([0.0] * COUNT)._replace(drag_y=0.0)
    slope = c.front_peak * c.front_shape * c.front_stiffness + c.rear_peak * c.rear_shape * c.rear_stiffness
    for share, left in ((1.0, 0.0), (0.51, 0.97), (0.49, 1.04)):
        _, vy, _ = euler(c._replace(min_slip_speed=share * DT * slope / c.mass), 0.0, 1e-6, 0.0)
        assert abs(vy) / 1e-6 == pytest.approx(left, abs=0.02)


def test_long_rollouts_stay_finite_and_lateral_velocity_decays():
    c = many_constants(extremes(500))
    vx, vy, yaw_rate = (torch.full((500,), v).double() for v in (8.0, 3.0, 1.0))
    for _ in range(500):
        before, (vx, vy, yaw_rate) = vy.abs(), euler(c, vx, vy, 0 * yaw_rate, f=TORCH)
        assert (vy.abs() <= before + 1e-12).all()
    assert vx.isfinite().all()


def test_a_parked_car_with_turned_wheels_and_brakes_on_stays_parked():
    c = many_constants(extremes(500))
    for steer in (-0.4, 0.4):
        velocity = tuple(torch.full((500,), 1e-5).double() for _ in range(3))
        moved = torch.zeros(500).double()
        for _ in range(250):
            velocity = euler(c, *velocity, brake=1.0, steer=steer, f=TORCH)
            moved += DT * torch.hypot(*velocity[:2])
        assert moved.max() < 1e-3


def test_forces_that_oppose_motion_fade_below_walking_pace():
    c = constants_from([0.0] * COUNT)
    strong, weak = (
        forces(v, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, c, SCALARS).forward for v in (1.0, STANDSTILL / 10)
    )
    assert strong < 5 * weak < 0


@pytest.mark.parametrize("vx", [6.0, 0.3, 0.0, -0.3, -6.0])
def test_gradients_equal_finite_differences(vx):
    raw = torch.zeros(COUNT, dtype=torch.float64, requires_grad=True)
    module = BicycleConstants(COMMANDED).double()
    inputs = torch.tensor([vx, 0.4, 0.3, 0.3, 0.2, 2.0, 0.5, -1.0], dtype=torch.float64, requires_grad=True)

    def change(raw, inputs):
        vx, vy, yaw_rate, brake, steer, engine, throttle, gear = inputs.unbind()
        c = functional_call(module, {"raw": raw}, ())
        force: Force = forces(vx, vy, yaw_rate, brake, steer, engine, throttle, gear, torch.ones_like(vx), c, TORCH)
        return torch.stack(rates(0 * vx, vx, vy, yaw_rate, steer, 0.1 * vx, 0 * vx, force, c, TORCH))

    assert torch.autograd.gradcheck(change, (raw, inputs))
