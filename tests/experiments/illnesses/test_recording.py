"""Recordings: the right rig gives the truth back, whatever the logger, and every format holds the same numbers."""

import numpy as np
import pytest

from experiments.illnesses import stamp_illnesses  # noqa: F401  # declares its illnesses
from experiments.illnesses.formats import formats_for, stored
from experiments.illnesses.logger import recorded
from experiments.illnesses.recording import rig_text
from experiments.illnesses.sensing import START, Sensing
from experiments.illnesses.true_drive import scaled
from made_up_drive import MAX_STEER, made_up_case, made_up_drive
from offpiste.dataset.resample import extract_rows
from offpiste.inspection.inspect import inspect_log
from offpiste.logs.drive import drive_from_log
from offpiste.rig.rig import parse_rig


@pytest.mark.parametrize("seed", range(6))
def test_the_rig_of_a_logger_gives_the_truth_back(seed):
    case = made_up_case(seed=seed)
    assert parse_rig(rig_text(case.rig), where="test") == case.rig
    drive, truth = drive_from_log(case.log, case.rig), made_up_drive()
    rows = extract_rows(drive)
    assert rows.valid.mean() > 0.9
    time = rows.time[rows.valid] - START
    ahead = -case.rig.vehicle.wheel_positions[0][0] + truth.wheelbase / 2
    speed = np.interp(time, truth.time, np.hypot(*truth.velocity[:, :2].T))
    rate = np.interp(time, truth.time, truth.angular_velocity[:, 2])
    assert np.sqrt(np.mean((rows.state[rows.valid, 3] - speed) ** 2)) < 0.15
    assert np.sqrt(np.mean((rows.state[rows.valid, 4] - ahead * rate) ** 2)) < 0.15
    assert np.sqrt(np.mean((rows.state[rows.valid, 5] - rate) ** 2)) < 0.1
    steer = np.interp(time, truth.time, truth.command[:, 2])
    assert np.sqrt(np.mean((rows.control[rows.valid, 2] - steer) ** 2)) < 0.05
    if case.has("steer_angle"):
        angle = np.interp(time, truth.time, truth.steer_angle)
        assert np.sqrt(np.mean((rows.actuators[rows.valid, 1] - angle) ** 2)) < 0.03 * MAX_STEER


@pytest.mark.parametrize("storage", ["CSV", "Parquet", "MCAP", "ROS 1 bag", "TartanDrive"])
def test_every_format_holds_the_same_numbers(storage, tmp_path):
    cases = (made_up_case("orientation", seed=seed) for seed in range(30))
    case = next(case for case in cases if storage in formats_for(case))
    renamed, log = stored(case, storage, tmp_path)
    assert set(renamed.streams) == set(case.streams)
    for name, source in renamed.rig.channels.items():
        samples = log.read(source.topic, source.fields)
        np.testing.assert_allclose(samples.values, case.raw(name), rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(samples.time, case.stream(name).time, rtol=0, atol=1e-6)
        if case.stream(name).arrival is not None and log.has_arrivals:
            arrived = log.read(source.topic, source.fields, stamps="receive").time
            np.testing.assert_allclose(arrived, case.stream(name).arrival, rtol=0, atol=1e-6)


def test_velocities_belong_to_the_pose_point():
    drive = made_up_drive()
    time = np.linspace(1, 29, 500)
    ahead = Sensing(drive, (1.5, 0.0), np.random.default_rng(0))
    body = ahead.velocity(time, "body")
    rate = np.interp(time, drive.time, drive.angular_velocity[:, 2])
    np.testing.assert_allclose(body[:, 1], 1.5 * rate, atol=1e-3)
    step = 1e-3
    moved = (ahead.position(time + step) - ahead.position(time - step)) / (2 * step)
    assert np.sqrt(np.mean((moved - ahead.velocity(time, "world")) ** 2)) < 0.05


def test_healthy_recordings_of_all_sizes_are_usable():
    for seed, size in enumerate((0.1, 1.0, 1.6)):
        case = recorded(scaled(made_up_drive(), size), np.random.default_rng(seed))
        assert inspect_log(case.log, case.rig).usable
