"""Rows and poses of the last seconds, from readings at any times."""

from dataclasses import replace

import numpy as np
import pytest

from factories import RIG
from offpiste.core.channels import MORE_ACTUATORS, Actuator
from offpiste.core.conventions import DT, HISTORY_STEPS
from offpiste.dataset.resample import extract_rows
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.rig.rig import parse_rig
from offpiste.runtime.estimator import VehicleTrack
from runtime.stream import reading


def circle(time):
    """At 4 m/s round a circle of 8 m, from the origin to the east, turning left."""
    yaw = 0.5 * time
    return reading(time, 8 * np.sin(yaw), 8 * (1 - np.cos(yaw)), yaw, 4.0, 0.0, 0.5)


def test_between_readings_the_motion_is_extrapolated():
    track = VehicleTrack()
    track.add(reading(1.0, 10.0, 20.0, np.pi / 2, 3.0, 0.0, 0.2))
    state = track.rows(1.1).state[-1]
    np.testing.assert_allclose(state[:3], (10.0, 20.3, np.pi / 2 + 0.02), atol=1e-9)
    # Before the first reading its values are repeated, not extrapolated backwards.
    np.testing.assert_allclose(track.rows(1.1).state[0, :3], (10.0, 20.0, np.pi / 2), atol=1e-9)


def test_poses_are_known_between_readings_that_are_slow_but_expected():
    for slowest, known in ((0.0, False), (0.6, True)):
        track = VehicleTrack(slowest=slowest)
        assert not track.awaits(1.0), "nothing was read"
        for time in (1.0, 1.5):
            track.add(circle(time))
        pose = track.pose_at(1.25)
        assert (pose is not None) == known
        assert track.pose_at(1.6) is None
        assert track.awaits(1.6)
        assert not track.awaits(1.5)
    chord = 0.5 * (circle(1.0).position + circle(1.5).position)
    np.testing.assert_allclose(pose[:3, 3], chord, atol=1e-9)


def test_rows_are_those_that_a_dataset_holds_of_the_same_readings():
    more = "".join(
        f'[channels.{name}]\ntopic = "odometry"\nfields = {fields}\n{rest}\n'
        for name, fields, rest in (
            ("linear_velocity", ["vx", "vy", "vz"], 'frame = "world"'),
            ("yaw_rate", ["rate"], ""),
            ("steer_angle", ["angle"], ""),
        )
    )
    rig = parse_rig(RIG.replace('"steer_angle", "steer_rate", ', "") + more, where="")
    stamps = np.sort(np.random.default_rng(0).uniform(0, 4, 300))
    readings = [replace(circle(t), actuators=np.array((np.nan, np.sin(t), np.nan, np.nan))) for t in stamps]
    values = {
        "position": [r.position for r in readings],
        "orientation": [r.orientation for r in readings],
        "linear_velocity": [r.velocity for r in readings],
        "yaw_rate": [[r.yaw_rate] for r in readings],
        "steer_angle": [r.actuators[1:2] for r in readings],
        **dict.fromkeys(("throttle", "brake", "steer"), np.zeros((300, 1))),
    }
    channels = {name: Channel(name, "", stamps, np.array(value)) for name, value in values.items()}
    rows = extract_rows(Drive("readings", rig, channels))
    track, row = VehicleTrack(), 150
    for known in readings[: np.searchsorted(stamps, rows.time[row], side="right")]:
        track.add(known)
    found = track.rows(rows.time[row])
    past = slice(row - HISTORY_STEPS, row + 1)
    origin = np.array((*rows.origin, 0, 0, 0, 0))
    np.testing.assert_allclose(found.state - origin, rows.state_causal[past], atol=1e-5)
    np.testing.assert_array_equal(found.actuators[:, 1].astype(np.float32), rows.actuators_causal[past, 1])


def test_rows_have_the_control_commanded_from_their_time_on():
    track = VehicleTrack()
    for row in range(20):
        track.add(circle(row * DT))
        if 10 <= row < 19:  # of the last row, nothing is commanded yet
            track.commanded(row * DT, np.array((row, 0.0, 0.0)), -1.0 if row < 15 else 1.0)
    rows = track.rows(19 * DT)
    assert rows.control[:, 0].tolist() == [0, *range(10, 19), 18]
    np.testing.assert_array_equal(rows.gear, [np.nan, *5 * [-1.0], *5 * [1.0]])


def test_rows_have_columns_of_registered_actuators_that_a_model_reads(monkeypatch):
    for name in ("flap", "valve"):
        monkeypatch.setitem(MORE_ACTUATORS._entries, name, Actuator(name, channel=name))
    track, measured = VehicleTrack(actuators=("steer", "valve")), {"flap": 0.1, "valve": 0.2}
    track.add(replace(circle(0.0), actuators=np.arange(4.0), extra=measured))
    track.add(replace(circle(DT), actuators=np.arange(4.0)))
    np.testing.assert_array_equal(track.rows(DT).actuators[-2:], [[0, 1, 2, 3, 0.2], [0, 1, 2, 3, np.nan]])


def test_a_jump_of_the_pose_forgets_earlier_readings():
    track = VehicleTrack()
    for row in range(20):
        assert not track.add(circle(row * DT))
    assert track.poses().at(np.array([0.1]))[0, 0, 3] == pytest.approx(8 * np.sin(0.05), abs=1e-3)
    assert not track.add(reading(0.4, 8 * np.sin(0.2) + 0.9, 0.16, 0.2, 4.0, 0.0, 0.5))
    assert track.add(reading(0.42, 30.0, 0.0, 0.2, 4.0, 0.0, 0.5))
    assert not track.enough
    np.testing.assert_allclose(track.rows(0.42).state[:, 0], 30.0)
