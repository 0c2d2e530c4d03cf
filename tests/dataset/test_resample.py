"""Rows of a drive with known motion; absent channels stay unknown."""

import numpy as np
import pytest

from factories import RIG, MemoryLog, small_rig
from offpiste.core.conventions import DT
from offpiste.core.errors import LogError
from offpiste.dataset.resample import Rows, extract_rows
from offpiste.logs.drive import drive_from_log
from offpiste.rig.rig import parse_rig

ANGLE = '[channels.steer_angle]\ntopic = "steering"\nfields = ["angle"]\n'
WITH_ANGLE = RIG.replace('"steer_angle", "steer_rate", ', "") + ANGLE


def straight_log(seconds: float = 20.0, *, rate: float = 50.0, grade: float = 0.0, gap: float = 0.0) -> MemoryLog:
    """North-east at 5 m/s horizontally, up a grade, far from the origin; the pedals' stamps lie between the pose's."""
    time = np.arange(0, seconds, 1 / rate)
    along, zero = 5 * time, 0 * time
    half = np.pi / 8
    pose = {
        "x": 4e5 + along * np.sqrt(0.5), "y": 5e6 + along * np.sqrt(0.5), "z": 100 + grade * along,
        "qx": zero, "qy": zero, "qz": zero + np.sin(half), "qw": zero + np.cos(half),
    }  # fmt: skip
    keep = (time < 10) | (time > 10 + gap)
    offset = time + 0.3 / rate
    return MemoryLog(
        odometry=(time[keep], {key: values[keep] for key, values in pose.items()}),
        pedals=(offset, {"throttle": 0.05 * offset, "brake": zero}),
        steering=(offset, {"steer": np.sin(offset), "angle": 0.4 * np.sin(offset)}),
    )


def extracted(text: str = RIG, **log: float) -> Rows:
    return extract_rows(drive_from_log(straight_log(**log), parse_rig(text, where="test")))


def test_known_motion_and_commands_come_out():
    rows = extracted()
    inner = rows.valid
    assert inner.mean() > 0.97
    np.testing.assert_allclose(rows.state[inner, 2:], np.tile([np.pi / 4, 5, 0, 0], (inner.sum(), 1)), atol=2e-3)
    np.testing.assert_allclose(rows.state_causal[inner, 3], 5, atol=1e-2)
    np.testing.assert_allclose(np.diff(rows.time), DT, atol=1e-9)
    np.testing.assert_allclose(rows.state[np.argmax(inner), :2], 0, atol=1e-6)
    np.testing.assert_allclose(rows.origin, (4e5, 5e6), atol=5)
    assert rows.state.dtype == np.float32
    assert np.isnan(rows.actuators).all()  # absent
    np.testing.assert_allclose(rows.control[inner, 0], 0.05 * rows.time[inner], atol=1e-5)
    np.testing.assert_allclose(rows.control[inner, 2], np.sin(rows.time[inner]), atol=1e-4)
    assert rows.distance == pytest.approx(5 * inner.sum() * DT, rel=1e-3)


def test_a_steering_rate_is_derived_from_the_angle():
    rows = extracted(WITH_ANGLE)
    at = rows.time[rows.valid]
    np.testing.assert_allclose(rows.actuators[rows.valid, 1], 0.4 * np.sin(at), atol=1e-4)
    np.testing.assert_allclose(rows.actuators[rows.valid, 2], 0.4 * np.cos(at), atol=5e-3)
    assert parse_rig(WITH_ANGLE, where="").present_actuators == ("steer", "steer_rate")


@pytest.mark.parametrize("up", [15.0, -3.0])
def test_no_slope_is_fitted_across_a_jump_of_the_pose(up):
    log = straight_log(grade=0.2)
    time, pose = log.data["odometry"]
    pose["z"] = pose["z"] + up * (time > 10)
    rows = extract_rows(drive_from_log(log, small_rig()))
    wanted = np.array([-0.2 * np.sqrt(0.5), -0.2 * np.sqrt(0.5), 1]) / np.hypot(0.2, 1)
    assert rows.valid.sum() > 900
    np.testing.assert_allclose(rows.normal[0, rows.valid, 0], np.tile(wanted, (rows.valid.sum(), 1)), atol=5e-3)
    steep = np.hypot(rows.normal_causal[:, 0], rows.normal_causal[:, 1]) > 0.2  # flat until two metres were driven
    assert not steep[rows.valid].any()
    before = rows.time < 10 - DT
    np.testing.assert_array_equal(rows.normal_causal[before], extracted(grade=0.2).normal_causal[before])


@pytest.mark.parametrize("grade", [0.2, -0.2])
def test_normals_are_those_of_the_driven_slope(grade):
    rows = extracted(grade=grade)
    normal = rows.normal[0, rows.valid]
    assert rows.normal.shape[0] == 1
    wanted = np.array([-grade * np.sqrt(0.5), -grade * np.sqrt(0.5), 1]) / np.hypot(grade, 1)
    np.testing.assert_allclose(normal, np.broadcast_to(wanted, normal.shape), atol=5e-3)
    flat = extracted(RIG + '[motion]\nnormals = "flat"\n', grade=grade)
    np.testing.assert_array_equal(flat.normal[0, flat.valid], [[[0, 0, 1]] * 4] * flat.valid.sum())


def test_a_gear_is_a_column_of_its_own_and_never_averaged():
    log = straight_log()
    time = log.data["steering"][0]
    log.data["box"] = time, {"number": np.where(np.sin(time) > 0, 3.0, np.where(np.sin(time) > -0.3, 0.0, -1.0))}
    gear = '[channels.gear]\ntopic = "box"\nfields = ["number"]\n'
    rows = extract_rows(drive_from_log(log, parse_rig(RIG + gear, where="test")))
    assert rows.control.shape[1] == rows.control_causal.shape[1] == 4
    at = np.floor((rows.time[rows.valid] - time[0]) / DT + 1e-6) * DT + time[0]
    wanted = np.where(np.sin(at) > 0, 1, np.where(np.sin(at) > -0.3, 0, -1))
    for control in (rows.control, rows.control_causal):
        assert set(np.unique(control[rows.valid, 3])) == {-1, 0, 1}
        assert (control[rows.valid, 3] == wanted).mean() > 0.99


def test_rows_in_a_gap_are_invalid_and_never_filled():
    rows = extracted(gap=3.0)
    inside = (rows.time > 10.05) & (rows.time < 12.95)
    assert not rows.valid[inside].any()
    assert np.isnan(rows.state[inside]).all()
    assert rows.valid[(rows.time > 1) & (rows.time < 9.5)].all()
    assert rows.valid[(rows.time > 13.5) & (rows.time < 19)].all()


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_no_row_is_valid_across_a_jump_of_a_yaw_channel(turn):
    log = straight_log()
    time, pose = log.data["odometry"]
    pose["heading"] = np.pi / 4 + 1e-4 * np.sin(time) + turn * (time > 10)
    text = RIG.replace("[channels.orientation]", "[channels.yaw]").replace('["qx", "qy", "qz", "qw"]', '["heading"]')
    rig = parse_rig(text, where="test")
    rows = extract_rows(drive_from_log(log, rig))
    near = (rows.time > 10 - rig.motion.window / 2) & (rows.time < 10 + rig.motion.window)
    assert rows.valid[near].any() == (turn == 0)
    assert np.abs(rows.state[rows.valid, 5]).max() < 1e-3
    assert rows.valid[(rows.time > 1) & (rows.time < 9) | (rows.time > 11) & (rows.time < 19)].all()


VELOCITY = '[channels.linear_velocity]\ntopic = "odometry"\nfields = ["x", "y", "z"]\nframe = "world"\n'


@pytest.mark.parametrize(
    ("text", "rate", "said"),
    [
        (RIG + "[clock]\nmax_gap = 0.001\n", 50.0, r"no second of it has all channels.*max_gap"),
        (RIG + "[motion]\nwindow = 0.3\n", 10.0, r"motion\.window"),
        (WITH_ANGLE + VELOCITY, 10.0, r"steer_angle: too few samples.*motion\.window"),
    ],
)
def test_a_log_too_sparse_for_the_settings_is_an_error_that_names_them(text, rate, said):
    with pytest.raises(LogError, match=said):
        extracted(text, rate=rate)


def test_a_wider_window_accepts_a_slower_pose():
    assert extracted(RIG + "[motion]\nwindow = 0.6\n", rate=10.0).valid.mean() > 0.9
