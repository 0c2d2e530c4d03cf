"""Drive train and gear box."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from offpiste.native.library import entry
from offpiste.simulation.vehicle.parameters import RECORD, load_vehicle
from offpiste.simulation.vehicle.physics import engine_torque
from simulation.drives import drive, flat_world, vehicle_on

P = load_vehicle()
RECORDED = P.as_record()
DT = 0.002

spin = entry("spin", "f8", float, float, float, "f8", float, RECORD)
steered = entry("steered", "f8", float, float, RECORD)
_wheel_angles = entry("wheel_angles", float, RECORD, "f8")


def turned(speeds, *, seconds=DT, ratio=2.0, throttle=0.0, brake=0.0, tyre=(0.0, 0.0, 0.0, 0.0), p=P):
    speeds, p = np.array(speeds, float), p.as_record()
    for _ in range(round(seconds / DT)):
        spin(speeds, ratio, throttle, brake, np.array(tyre, float), DT, p)
    return speeds


def wheel_angles(angle):
    found = np.empty(2)
    _wheel_angles(angle, RECORDED, found)
    return tuple(found)


def test_engine_has_its_power_and_its_limiter():
    speeds = np.arange(100.0, 900.0)
    power = [w * engine_torque(w, 1.0, RECORDED) for w in speeds]
    assert 50e3 < max(power) < 70e3
    assert engine_torque(P.engine_torque_speed, 1.0, RECORDED) == pytest.approx(P.engine_torque)
    assert engine_torque(P.limiter_speed, 1.0, RECORDED) < 0
    assert engine_torque(500.0, 0.0, RECORDED) == pytest.approx(-(P.engine_drag + 500 * P.engine_drag_slope))


@given(st.lists(st.floats(0, 80), min_size=4, max_size=4), st.floats(0, 800), st.floats(0.72, 3.4), st.floats(0, 1))
def test_couplings_and_brakes_only_take_energy(wheels, engine, ratio, brake):
    p = replace(P, engine_drag=1e-12, engine_drag_slope=1e-12, idle_gain=1e-12)
    before = np.array([engine, *wheels])
    after = turned(before, ratio=ratio, brake=brake, p=p)
    inertia = np.array([p.engine_inertia, *[p.wheel_inertia] * 4])
    assert (inertia * after**2).sum() <= (inertia * before**2).sum() * (1 + 1e-9) + 1e-9


def test_brake_torque_of_each_wheel():
    # One step of free wheels: J dw/dt = -T, the front taking its share.
    p = replace(P, clutch_gain=1e-12, centre_rate=1e-12, front_rate=1e-12, rear_rate=1e-12)
    slowed = 60 - turned([0, 60, 60, 60, 60], brake=1.0, p=p)[1:]
    drag = p.shaft_drag + 60 * p.shaft_drag_slope
    front, rear = (share * p.brake_torque / 2 + drag for share in (p.brake_front_share, 1 - p.brake_front_share))
    np.testing.assert_allclose(slowed, np.array((front, front, rear, rear)) * DT / p.wheel_inertia, rtol=0.06)


def test_locked_wheel_stays_locked_below_the_brakes_torque():
    pulled = turned([P.idle_speed, 0, 0, 0, 0], seconds=2, brake=1.0, tyre=(300.0, -300.0, 300.0, 300.0))[1:]
    assert abs(pulled).max() < 1e-3
    over = turned([P.idle_speed, 0, 0, 0, 0], seconds=2, brake=0.1, tyre=(300.0,) * 4)[1:]
    assert over.min() > 1


def test_differentials_front_open_rear_limited_centre_locked():
    wheels = turned([0, 30, 10, 25, 15], seconds=0.06)[1:]
    assert wheels[0] - wheels[1] > 0.5 * 20
    assert wheels[2] - wheels[3] < 0.1 * 10
    assert wheels[:2].mean() == pytest.approx(wheels[2:].mean(), abs=0.1)


def test_steering_rings_like_its_second_order():
    # A step small enough to stay below the rate limit overshoots by exp(-pi zeta / sqrt(1 - zeta^2)).
    zeta, state, path = P.steer_damping, np.zeros(2), []
    for _ in range(2000):
        steered(state, 0.05, DT, RECORDED)
        path.append(state[0])
    expected = 0.05 * P.max_steer
    assert path[-1] == pytest.approx(expected, rel=1e-6)
    assert max(path) / expected - 1 == pytest.approx(np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2)), abs=0.01)


def test_front_wheels_point_at_one_centre():
    left, right = wheel_angles(0.3)
    radius = P.wheelbase / np.tan(0.3)
    assert np.tan(left) == pytest.approx(P.wheelbase / (radius - P.track / 2))
    assert np.tan(right) == pytest.approx(P.wheelbase / (radius + P.track / 2))
    assert wheel_angles(-0.3) == pytest.approx((-right, -left))


def test_it_reverses_with_its_wheels_and_turns_the_other_way():
    samples = drive(vehicle_on(), 4, (0.5, 0.0, 0.5, -1.0))
    waiting = [s for s in samples if s.time < P.gear_time]
    assert {s.gear for s in waiting[2:]} == {0}
    assert max(np.hypot(*s.velocity[:2]) for s in waiting) < 0.05
    last = samples[-1]
    assert last.gear == -1
    assert last.velocity[0] < -0.5
    assert last.wheel_speed.max() < 0
    assert last.angular_velocity[2] < -0.05
    assert -2 < last.yaw < -0.1
    assert last.engine_speed > 1200


def test_reverse_is_not_engaged_at_speed_and_brakes_still_brake():
    driven = drive(vehicle_on(flat_world(), speed=5.0), 1, (0.0, 0.0, 0.0, -1.0))
    assert {s.gear for s in driven} == {1}
    backwards = drive(vehicle_on(flat_world()), 6, lambda s: (0.6 * (s.time < 3), float(s.time >= 3), 0.0, -1.0))
    assert min(s.velocity[0] for s in backwards) < -1
    assert abs(backwards[-1].velocity[0]) < 0.05
