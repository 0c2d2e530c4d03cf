"""Recordings: the right rig gives the truth back, whatever the logger, and every format holds the same numbers."""

import numpy as np
import pytest

from experiments.illnesses import stamp_illnesses  # noqa: F401  # declares its illnesses
from experiments.illnesses.formats import formats_for, stored
from experiments.illnesses.illness import ILLNESSES
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


def test_values_go_into_the_log_and_come_back_through_the_rig():
    for seed in range(8):
        case = made_up_case("steer", "wheel_speed", seed=seed)
        for channel in case.rig.channels:
            values = case.values(channel)
            np.testing.assert_allclose(case.with_values(channel, values).raw(channel), case.raw(channel), atol=1e-6)
            doubled = case.scaled(channel, 2.0)
            np.testing.assert_allclose(doubled.values(channel), 2 * values, atol=1e-9 * np.abs(values).max())


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


@pytest.mark.parametrize("storage", ["MCAP", "ROS 1 bag"])
def test_rows_stay_in_their_order_whatever_their_stamps(storage, tmp_path):
    cases = (made_up_case("orientation", seed=seed) for seed in range(30))
    case = next(case for case in cases if storage in formats_for(case))
    shuffled = ILLNESSES["position: rows shuffled"].change(case, 0.1, np.random.default_rng(0))
    renamed, log = stored(shuffled, storage, tmp_path)
    source = renamed.source("position")
    time = log.read(source.topic, source.fields).time
    assert (np.diff(time) < 0).any()
    np.testing.assert_allclose(time, shuffled.stream("position").time, rtol=0, atol=1e-6)


def test_stamps_that_no_header_holds_are_left_to_folders():
    case = next(case for case in (made_up_case(seed=seed) for seed in range(30)) if "" not in case.streams)
    assert "MCAP" in formats_for(case)
    topic = next(iter(case.streams))
    broken = case.with_stamps(topic, lambda time: np.where(np.arange(len(time)) == 5, np.nan, time))
    assert formats_for(broken) == ("TartanDrive",)


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
