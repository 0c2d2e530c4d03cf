"""Recordings: the right rig restores the truth, whatever the logger; drives of other sizes obey the same mechanics."""

import numpy as np
import pytest

from experiments.inspection_faults.drives import scaled
from experiments.inspection_faults.recording import START, recorded
from made_up_drive import MAX_STEER, made_up_case, made_up_drive
from offpiste.core.geometry import yaw_from_quaternion
from offpiste.dataset.resample import extract_rows
from offpiste.inspection.inspect import inspect_log
from offpiste.logs.drive import drive_from_log


@pytest.mark.parametrize("seed", range(6))
def test_the_rig_of_a_recording_gives_the_truth_back(seed):
    case, truth = made_up_case(seed=seed), made_up_drive()
    rows = extract_rows(drive_from_log(case.log, case.rig))
    assert rows.valid.mean() > 0.9
    rows_time, valid = rows.time[rows.valid] - START, rows.valid
    ahead = -case.rig.vehicle.wheel_positions[0][0] + truth.wheelbase / 2

    def error(column, values):
        return np.sqrt(np.mean((column[valid] - np.interp(rows_time, truth.time, values)) ** 2))

    rate, heading = truth.angular_velocity[:, 2], yaw_from_quaternion(truth.orientation)
    east, north = truth.velocity[:, :2].T
    assert error(rows.state[:, 3], np.cos(heading) * east + np.sin(heading) * north) < 0.15
    assert error(rows.state[:, 4], np.cos(heading) * north - np.sin(heading) * east + ahead * rate) < 0.15
    assert error(rows.state[:, 5], rate) < 0.1
    assert error(rows.control[:, 2], truth.command[:, 2]) < 0.05
    if case.has("steer_angle"):
        assert error(rows.actuators[:, 1], truth.steer_angle) < 0.03 * MAX_STEER


def test_healthy_recordings_of_all_sizes_are_usable():
    for seed, size in enumerate((0.1, 1.0, 1.6)):
        case = recorded(scaled(made_up_drive(), size), np.random.default_rng(seed))
        assert inspect_log(case.log, case.rig).usable


@pytest.mark.parametrize("size", [0.1, 1.6])
def test_a_drive_of_another_size_solves_the_same_equations(size):
    drive = made_up_drive()
    other = scaled(drive, size)
    np.testing.assert_allclose(
        np.gradient(other.velocity[:, 0], other.time), np.gradient(drive.velocity[:, 0], drive.time), atol=1e-9
    )
    moved = np.gradient(other.position[:, 0], other.time)
    assert np.sqrt(np.mean((moved - other.velocity[:, 0]) ** 2)) < 0.02 * np.sqrt(size)
    turned = np.gradient(yaw_from_quaternion(other.orientation), other.time)
    assert np.sqrt(np.mean((turned - other.angular_velocity[:, 2]) ** 2)) < 0.02 / np.sqrt(size)
    assert other.mass == pytest.approx(drive.mass * size**3)
