"""Drives of other sizes obey the same mechanics; vehicles of the proving ground reverse and are drawn at random."""

import numpy as np
import pytest

from experiments.illnesses.drives import drive_of
from experiments.illnesses.true_drive import load, save, scaled
from made_up_drive import made_up_drive
from offpiste.core.conventions import DT
from offpiste.core.geometry import yaw_from_quaternion
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.simulation.vehicle.vehicle import VehicleSimulation
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import WorldSettings


@pytest.mark.parametrize("size", [0.1, 1.6])
def test_a_drive_of_another_size_is_a_solution_of_the_same_mechanics(size):
    drive = made_up_drive()
    other = scaled(drive, size)

    def ratio(d):
        speed = np.hypot(*d.velocity[:, :2].T)
        turning = np.abs(d.steer_angle) > 0.05
        return d.angular_velocity[turning, 2] * d.wheelbase / (speed * np.tan(d.steer_angle) + 1e-12)[turning]

    np.testing.assert_allclose(ratio(other), ratio(drive), rtol=1e-6)
    # Accelerations, against which gravity and friction stand, and angles stay; velocities are places' derivatives.
    np.testing.assert_allclose(
        np.gradient(other.velocity[:, 0], other.time), np.gradient(drive.velocity[:, 0], drive.time), atol=1e-9
    )
    moved = np.gradient(other.position[:, 0], other.time)
    assert np.sqrt(np.mean((moved - other.velocity[:, 0]) ** 2)) < 0.02 * np.sqrt(size)
    turned = np.gradient(yaw_from_quaternion(other.orientation), other.time)
    assert np.sqrt(np.mean((turned - other.angular_velocity[:, 2]) ** 2)) < 0.02 / np.sqrt(size)
    assert other.mass == pytest.approx(drive.mass * size**3)


def test_a_drive_is_read_as_it_was_written_and_not_simulated_again(tmp_path):
    drive = made_up_drive()
    save(drive, tmp_path / "drive-000003.npz")
    for read in (load(tmp_path / "drive-000003.npz"), drive_of(3, tmp_path)):
        assert read.behaviour == "made up"
        assert read.wheelbase == drive.wheelbase
        np.testing.assert_array_equal(read.orientation, drive.orientation)


def test_a_vehicle_reverses_with_its_wheels_and_turns_the_other_way():
    world = make_world(WorldSettings(preset="uniform", size=60.0, resolution=0.5))
    vehicle = VehicleSimulation(world, load_vehicle(), x=0.0, y=0.0, yaw=0.0)
    for _ in range(round(4 / DT)):
        vehicle.step(0.5, 0.0, 0.5, -1.0)
    sample = vehicle.sample()
    forward = float(sample.velocity[:2] @ np.array((np.cos(0.0), np.sin(0.0))))
    assert forward < -0.5
    assert sample.wheel_speed.max() < 0
    assert sample.angular_velocity[2] < -0.05
