"""Forward, neutral and reverse: shifted at a standstill, and the vehicle goes where the gear says."""

import numpy as np

from offpiste.simulation.vehicle.drivetrain import GearBox
from offpiste.simulation.vehicle.parameters import load_vehicle
from simulation.drives import drive, flat_world, vehicle_on, yaw_of

GEAR_TIME = load_vehicle().gear_time


def test_a_shift_takes_its_time_and_is_neutral_meanwhile():
    box, engaged = GearBox(3), []
    for wanted in (None, 1.0, -1.0, -1.0, -1.0, -1.0, None, 0.0, 0.0, 0.0, 0.0):
        box.shift(wanted, moving=False)
        engaged.append(box.engaged)
    assert engaged == [1, 1, 0, 0, 0, -1, -1, 0, 0, 0, 0]


def test_nothing_shifts_while_the_vehicle_moves():
    box = GearBox(1)
    for _ in range(5):
        box.shift(-1.0, moving=True)
        assert box.engaged == 1
    box.shift(-1.0, moving=False)
    box.shift(-1.0, moving=True)
    assert box.engaged == -1


def test_it_reverses_with_its_wheels_and_turns_the_other_way():
    samples = drive(vehicle_on(), 4, (0.5, 0.0, 0.5, -1.0))
    waiting = [s for s in samples if s.time < GEAR_TIME]
    assert {s.gear for s in waiting[2:]} == {0}
    assert max(np.hypot(*s.velocity[:2]) for s in waiting) < 0.05
    last = samples[-1]
    assert last.gear == -1
    assert last.velocity[0] < -0.5
    assert last.wheel_speed.max() < 0
    assert last.angular_velocity[2] < -0.05
    assert -2 < yaw_of(last) < -0.1
    assert last.engine_speed > 1200


def test_neutral_revs_the_engine_and_drives_nothing():
    samples = drive(vehicle_on(), 3, (1.0, 0.0, 0.0, 0.0))
    assert samples[-1].engine_speed > 6000
    assert np.hypot(*samples[-1].velocity[:2]) < 0.05


def test_reverse_is_not_engaged_at_speed_and_brakes_still_brake():
    driven = drive(vehicle_on(flat_world(), speed=5.0), 1, (0.0, 0.0, 0.0, -1.0))
    assert {s.gear for s in driven} == {1}
    backwards = drive(vehicle_on(flat_world()), 6, lambda s: (0.6 * (s.time < 3), float(s.time >= 3), 0.0, -1.0))
    assert min(s.velocity[0] for s in backwards) < -1
    assert abs(backwards[-1].velocity[0]) < 0.05
