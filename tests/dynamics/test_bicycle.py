"""The scalar physics against the paper's equations written a second time, physical invariants and stability bounds."""

import math

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from torch.func import functional_call, jacfwd, vmap

from factories import COMMANDED
from offpiste.core.conventions import DT, GRAVITY
from offpiste.dynamics.bicycle import STANDSTILL, Constants, DriveTrain, Elementary, forces, rates, slip_angles
from offpiste.dynamics.torch_physics import TORCH, BicycleConstants

SCALARS = Elementary(math.sin, math.cos, math.tanh, math.atan, max)
COUNT = BicycleConstants(COMMANDED).raw.numel()
UP = (0.0, 0.0, 1.0)


def constants_from(raw: list[float]) -> Constants:
    module = BicycleConstants(COMMANDED).double()
    module.raw.data = torch.tensor(raw, dtype=torch.float64)
    return Constants(*(float(c.detach()) for c in module()))


def extremes(count: int) -> torch.Tensor:
    """Raw parameters of many bicycles: half with every constant at a bound of its range, half anywhere."""
    generator = torch.Generator().manual_seed(0)
    ends = torch.where(torch.rand(count // 2, COUNT, generator=generator) < 0.5, -15.0, 15.0)
    return torch.cat((ends, 4 * torch.randn(count - count // 2, COUNT, generator=generator))).double()


def many_constants(raw: torch.Tensor) -> Constants:
    """Constants with a batch of values each."""
    module = BicycleConstants(COMMANDED).double()
    columns = vmap(lambda one: torch.stack(tuple(functional_call(module, {"raw": one}, ()))))(raw)
    return Constants(*columns.detach().unbind(-1))


any_raw = st.lists(st.floats(-30, 30), min_size=COUNT, max_size=COUNT)
any_constants = any_raw.map(constants_from)
speeds = st.floats(-20, 20)
angles = st.floats(-0.6, 0.6)
shares = st.floats(0, 1)
many = settings(max_examples=60, deadline=None)


def inputs(throttle=0.0, brake=0.0, steer=0.0, engine=0.0, gear=1.0):
    return DriveTrain(throttle, brake, steer, engine, gear)


def euler(c, vx, vy, yaw_rate, *, up=UP, f=SCALARS, **given):
    """vx, vy and yaw rate after one step."""
    train = DriveTrain(*(0 * vx + value for value in inputs(**given)))
    force = forces(vx, vy, yaw_rate, train, up[2], c, f)
    change = rates(0 * vx, vx, vy, yaw_rate, train.steer, up[0], up[1], force, c, f)
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
    along = ((1 + np.cos(delta)) * f_x - f_yf * np.sin(delta)) / c.mass - c.drag_x * vx * abs(vx)
    across = (f_yr + np.cos(delta) * f_yf + f_x * np.sin(delta)) / c.mass - c.drag_y * vy * abs(vy)
    moved = [r, along + c.gravity_x * eta[0] + vy * r, across + c.gravity_y * eta[1] - vx * r, f_r]
    return np.concatenate((turn @ [vx, vy], moved))


@pytest.mark.parametrize("seed", range(9))
def test_the_equations_are_the_papers(seed):
    rng = np.random.default_rng(seed)
    c = constants_from(list(rng.normal(0, 2, COUNT)))
    phi, vx, vy, r = rng.uniform((-3, -5, -2, -1), (3, 12, 2, 1))
    throttle, brake, delta, rpm = rng.uniform((0, -0.1, -0.5, 0), (1, 1, 0.5, 5))
    gear = seed % 3 - 1.0
    eta = np.array([0, 0, 1]) + rng.normal(0, 0.2, 3)
    eta /= np.linalg.norm(eta)
    force = forces(vx, vy, r, DriveTrain(throttle, brake, delta, rpm, gear), eta[2], c, SCALARS)
    ours = rates(phi, vx, vy, r, delta, eta[0], eta[1], force, c, SCALARS)
    np.testing.assert_allclose(ours, paper((phi, vx, vy, r), (throttle, brake, delta, rpm, gear), eta, c), rtol=1e-12)


def test_a_case_worked_by_hand():
    c = Constants(**dict.fromkeys(Constants._fields, 0.0))._replace(
        drive_1=800.0, drive_2=400.0, engine_1=0.5, brake_1=200.0, resistance=100.0, resistance_slope=4.0,
        min_slip_speed=1.0, yaw_gain=2.0, yaw_damping=3.0, drag_x=0.01, gravity_x=9.0, mass=1000.0,
    )  # fmt: skip
    force = forces(10.0, 0.0, 0.5, inputs(throttle=0.5, brake=0.5, steer=0.1, engine=2.0), 0.9, c, SCALARS)
    # Drive (1 + 1)(400 + 100) = 1000 N, brakes 100 N, rolling 100 N, all times 0.9; yaw 2*10*0.1 - 3*0.5.
    assert force.forward == pytest.approx(720.0)
    assert force.yaw == pytest.approx(0.5)
    change = rates(0.0, 10.0, 0.0, 0.5, 0.0, -0.1, 0.0, force, c, SCALARS)
    assert change.vx == pytest.approx(2 * 0.72 - 1.0 - 0.9)
    assert change.vy == pytest.approx(-5.0)


SLIP = Constants(**dict.fromkeys(Constants._fields, 0.0))._replace(
    rear_length=1.0, front_length=1.0, min_slip_speed=1.25
)


@pytest.mark.parametrize("steer", [-0.3, 0.1])
@pytest.mark.parametrize("vx", [0.02, 1.0, 1.3, 8.0, -0.3, -8.0])
def test_wheels_that_roll_in_their_direction_do_not_slip_at_any_speed(vx, steer):
    yaw_rate = vx * math.tan(steer) / 2
    rear, front = slip_angles(vx, yaw_rate, yaw_rate, steer, SLIP, SCALARS)
    assert rear == 0
    assert abs(front) < 0.04 * abs(steer)
    assert abs(front) < 1e-12 or abs(vx) < SLIP.min_slip_speed


@given(any_constants, speeds, st.floats(-10, 10), st.floats(-3, 3), angles)
@many
def test_tyres_oppose_slip_at_every_slip_angle(c, vx, vy, yaw_rate, steer):
    rear, front = slip_angles(vx, vy, yaw_rate, steer, c, SCALARS)
    force = forces(vx, vy, yaw_rate, inputs(steer=steer), 1.0, c, SCALARS)
    assert force.lateral_rear * rear <= 0
    assert force.lateral_front * front <= 0
    assume(abs(vx * steer) > 1e-6)
    assert forces(vx, 0.0, 0.0, inputs(steer=steer), 1.0, c, SCALARS).yaw * vx * steer >= 0


@given(any_constants, speeds, shares, shares, st.floats(0, 8))
@many
def test_brakes_drag_and_rolling_never_accelerate_and_drive_increases_with_throttle(c, vx, one, other, engine):
    slower, vy, yaw_rate = euler(c, vx, 0.0, 0.0, brake=one)
    assert abs(slower) <= abs(vx)
    assert vy == yaw_rate == 0
    less, more = sorted((one, other))
    braked = [forces(vx, 0.0, 0.0, inputs(brake=b), 1.0, c, SCALARS).forward for b in (less, more)]
    assert (braked[1] - braked[0]) * vx <= 0
    drive = [forces(5.0, 0.0, 0.0, inputs(u, engine=engine), 1.0, c, SCALARS).forward for u in (0.0, less, more)]
    assert drive[0] <= drive[1] + 1e-9 * c.mass <= drive[2] + 2e-9 * c.mass


@given(any_constants, speeds, shares, st.floats(0, 8))
@many
def test_the_gear_sets_the_direction_of_the_drive_and_nothing_else(c, vx, throttle, engine):
    def at(throttle, gear):
        return forces(vx, 0.1, 0.2, inputs(throttle, 0.3, 0.1, engine, gear), 0.9, c, SCALARS)

    forward, neutral, reverse = (at(throttle, gear) for gear in (1.0, 0.0, -1.0))
    assert forward.forward >= neutral.forward >= reverse.forward
    assert forward.forward - neutral.forward == pytest.approx(neutral.forward - reverse.forward, rel=1e-6, abs=1e-6)
    assert forward[1:] == neutral[1:] == reverse[1:]
    assert neutral == at(0.0, 1.0)


@given(any_constants, st.floats(0.01, 0.3), speeds, st.floats(-5, 5))
@many
def test_climbing_slows_a_bank_pulls_down_and_coasting_gains_no_energy(c, tilt, vx, vy):
    level, *_ = euler(c, vx, 0.0, 0.0)
    climbing, *_ = euler(c, vx, 0.0, 0.0, up=(-tilt, 0.0, 1.0))
    _, sideways, _ = euler(c, 0.0, 0.0, 0.0, up=(0.0, -tilt, 1.0))
    assert climbing <= level
    assert sideways <= 0
    assert math.hypot(*euler(c, vx, vy, 0.0)[:2]) <= math.hypot(vx, vy) * (1 + 1e-12)


@pytest.mark.parametrize("steer", [0.1, 0.4])
@pytest.mark.parametrize("start", [0.1, 5.0, -1.0])
def test_coasting_with_the_wheels_turned_gains_no_speed(steer, start):
    """Near the initial constants. At the bounds of all ranges the paper's yaw equation, which has no tyre moment,
    still feeds some energy into a turn (in at most 0.5 % of the corners of the box)."""
    raw = BicycleConstants(COMMANDED).raw.detach().double()
    c = many_constants(raw + 0.5 * torch.randn(200, COUNT, generator=torch.Generator().manual_seed(1)).double())
    vx, vy, yaw_rate = torch.full((200,), start).double(), torch.zeros(200).double(), torch.zeros(200).double()
    for _ in range(100):
        vx, vy, yaw_rate = euler(c, vx, vy, yaw_rate, steer=steer, f=TORCH)
        assert torch.hypot(vx, vy).max() < abs(start)


@pytest.mark.parametrize("steer", [0.0, 0.4])
def test_euler_is_stable_for_all_constants(steer):
    """Eigenvalues of the step lie in the unit circle: straight at every speed, and at rest with the wheels turned."""
    module, raw = BicycleConstants(COMMANDED).double(), extremes(400)

    def step(velocity, raw, brake):
        return torch.stack(
            euler(functional_call(module, {"raw": raw}, ()), *velocity, brake=brake, steer=steer, f=TORCH)
        )

    for speed in (0.0,) if steer else (0.0, 1.0, 20.0, -1.0, -20.0):
        for brake in (0.0, 1.0):
            velocity = torch.tensor([speed, 0.0, 0.0]).double().expand(400, 3)
            jacobian = vmap(jacfwd(step))(velocity, raw, torch.full((400,), brake).double())
            assert torch.linalg.eigvals(jacobian).abs().max() <= 1 + 1e-9


def test_the_bound_on_the_slip_speed_is_half_the_stability_bound():
    """At C_max = dt S / m the slip of a parked car vanishes in one step; just below half of it, it grows."""
    c = constants_from([0.0] * COUNT)._replace(drag_y=0.0)
    slope = c.front_peak * c.front_shape * c.front_stiffness + c.rear_peak * c.rear_shape * c.rear_stiffness
    for share, left in ((1.0, 0.0), (0.51, 0.97), (0.49, 1.04)):
        _, vy, _ = euler(c._replace(min_slip_speed=share * DT * slope / c.mass), 0.0, 1e-6, 0.0)
        assert abs(vy) / 1e-6 == pytest.approx(left, abs=0.02)


@pytest.mark.parametrize("gear", [-1.0, 1.0])
def test_speed_settles_at_full_throttle(gear):
    c = many_constants(extremes(300))._replace(engine_1=torch.zeros(300).double(), engine_2=torch.zeros(300).double())
    vx, vy, yaw_rate = (torch.zeros(300).double() for _ in range(3))
    for _ in range(1500):
        vx, vy, yaw_rate = euler(c, vx, vy, yaw_rate, throttle=1.0, gear=gear, f=TORCH)
    assert (vx * gear >= 0).all()
    assert vx.isfinite().all()
    assert vy.abs().max() == 0


def test_a_parked_car_with_turned_wheels_and_brakes_on_stays_parked():
    c = many_constants(extremes(500))
    velocity, moved = tuple(torch.full((500,), 1e-5).double() for _ in range(3)), torch.zeros(500).double()
    for _ in range(250):
        velocity = euler(c, *velocity, brake=1.0, steer=0.4, f=TORCH)
        moved += DT * torch.hypot(*velocity[:2])
    assert moved.max() < 1e-3
    c = constants_from([0.0] * COUNT)
    strong, weak = (forces(v, 0.0, 0.0, inputs(brake=1.0), 1.0, c, SCALARS).forward for v in (1.0, STANDSTILL / 10))
    assert strong < 5 * weak < 0


@pytest.mark.parametrize("vx", [6.0, 0.0, -0.3])
def test_gradients_equal_finite_differences(vx):
    raw = torch.zeros(COUNT, dtype=torch.float64, requires_grad=True)
    module = BicycleConstants(COMMANDED).double()
    given = torch.tensor([vx, 0.4, 0.3, 0.5, 0.3, 0.2, 2.0, -1.0], dtype=torch.float64, requires_grad=True)

    def change(raw, given):
        vx, vy, yaw_rate, *train = given.unbind()
        c = functional_call(module, {"raw": raw}, ())
        force = forces(vx, vy, yaw_rate, DriveTrain(*train), torch.ones_like(vx), c, TORCH)
        return torch.stack(rates(0 * vx, vx, vy, yaw_rate, train[2], 0.1 * vx, 0 * vx, force, c, TORCH))

    assert torch.autograd.gradcheck(change, (raw, given))


@given(any_raw, shares)
@many
def test_constraints_hold_for_every_raw_value(raw, throttle):
    c, nearly = constants_from(raw), 1e-6
    for name in ("rear_peak", "rear_stiffness", "front_peak", "front_stiffness", "yaw_gain", "drag_x", "drag_y"):
        assert getattr(c, name) >= 0
    for peak, shape in ((c.front_peak, c.front_shape), (c.rear_peak, c.rear_shape)):
        assert peak / c.mass <= GRAVITY * (1 + nearly)
        assert shape >= 0
        assert math.sin(max(shape, math.pi / 2)) >= 0.7
    for length in (c.rear_length, c.front_length):
        assert 0 <= length <= COMMANDED.wheelbase * (1 + nearly)
    assert max(c.drag_x, c.drag_y) <= 0.05 * (1 + nearly)
    assert min(c.brake_1, c.brake_2, c.resistance, c.resistance_slope) >= 0
    for pull in (c.gravity_x, c.gravity_y):
        assert 0 <= pull <= 1.1 * GRAVITY * (1 + nearly)
    assert 0 < c.yaw_damping * DT < 1
    stiffness = c.front_peak * c.front_shape * c.front_stiffness + c.rear_peak * c.rear_shape * c.rear_stiffness
    assert 1 - nearly <= c.min_slip_speed / (DT * stiffness / c.mass) <= 4 * (1 + nearly) or stiffness < 1e-9
    assert c.yaw_gain / c.yaw_damping * (c.rear_length + c.front_length) <= 1 + nearly
    assert c.drive_1 + 2 * c.drive_2 * throttle >= -nearly * c.mass


def test_initial_constants_are_those_of_a_plausible_vehicle():
    c = Constants(*(float(x.detach()) for x in BicycleConstants(COMMANDED).double()()))
    assert c.gravity_x == pytest.approx(GRAVITY, rel=1e-6)
    assert c.rear_length == pytest.approx(COMMANDED.wheelbase / 2, rel=1e-6)
    assert c.yaw_gain / c.yaw_damping == pytest.approx(0.9 / COMMANDED.wheelbase, rel=1e-6)
    assert 2 * (c.drive_1 + c.drive_2) / c.mass == pytest.approx(3.0, rel=1e-6)
