"""What becomes a warning, what a note, and what the remedies say.

KITTI's drive is cleared; with a camera planted wrongly it is not.
"""

from dataclasses import replace

import numpy as np
import pytest

import textured_world as world
from experiments.sensor_faults import planted
from offpiste.inspection.findings import Finding
from offpiste.inspection.misfit import Misfit
from offpiste.inspection.own_body import check_own_body
from offpiste.inspection.sensor_samples import Gathered, gather, small_camera
from offpiste.inspection.sensor_stamps import check_sensor_stamps
from offpiste.inspection.sensors import CheckedSensor, camera_misfits, can_be_checked, check_mountings, lidar_misfits
from offpiste.logs import open_log
from offpiste.logs.measurements import Camera, Lidar
from offpiste.logs.sensor_log import open_sensors
from offpiste.rig.camera import CameraModel
from offpiste.rig.rig import load_rig
from offpiste.rig.sensors import CameraSource, LidarSource

LIDAR = Lidar("top", np.eye(4), LidarSource(topic="/points", delay=0.02))
CAMERA = Camera("front", CameraModel(8, 6, np.eye(3)), np.eye(4), CameraSource(topic="/image"))
DEGREES = np.array([*np.deg2rad([1.0, 1.0, 1.0]), 1e-3])
"""Of parameters given in degrees and ms."""


def checked(parameters=(0, 0, 0, 0), sigma=(0.1, 0.1, 0.1, 1.0), *, sensor=LIDAR, scale=0.02):
    return CheckedSensor(sensor, Misfit(np.array(parameters) * DEGREES, np.array(sigma) * DEGREES, 30, scale, 3000))


def reported(*those):
    return [(f.severity, f.where, f.what) for f in check_mountings(those)]


def test_what_is_right_is_not_mentioned():
    assert reported(checked(), checked(sensor=CAMERA)) == []
    assert reported(checked((0.4, -0.3, 0.0, 9.0))) == []  # as good drives show


@pytest.mark.parametrize(
    ("parameters", "sigma", "found"),
    [
        ((0, 1.0, 0, 0), (0.1, 0.1, 0.1, 1), True),
        ((0, 1.0, 0, 0), (0.1, 0.3, 0.1, 1), False),  # not surely more than half a degree
        ((0, 2.0, 0, 0), (0.1, 0.6, 0.1, 1), False),  # not known
        ((4.0, 1.0, 0, 0), (2.0, 0.1, 0.1, 1), True),  # what is not known hides nothing that is
        ((0.6, 0.6, 0.6, 0), (0.1, 0.1, 0.1, 1), True),  # 1.04 degrees in all
    ],
)
def test_a_turn_must_be_large_and_sure(parameters, sigma, found):
    assert any("looks" in what for _, _, what in reported(checked(parameters, sigma))) == found


def test_lateness_must_be_large_and_sure():
    assert reported(checked((0, 0, 0, 30))) == [("warning", "top", "is stamped 30 ms too late, against the poses")]
    assert reported(checked((0, 0, 0, -30))) == [("warning", "top", "is stamped 30 ms too early, against the poses")]
    assert reported(checked((0, 0, 0, 30), (0.1, 0.1, 0.1, 7))) == []
    assert reported(checked((0, 0, 0, 300), (0.1, 0.1, 0.1, 25))) == [("note", "top", "was checked in part")]


def test_remedies_are_rig_lines():
    turn, late = check_mountings([checked((0, 0, 2.0, 30))])
    half = np.deg2rad(1.0)
    assert f"orientation = [0.0, 0.0, {np.sin(half):.6f}, {np.cos(half):.6f}]" in turn.remedy
    assert turn.remedy.startswith("calibrate it again; or lidars.top.body_from_lidar = { position = [0.0, 0.0, 0.0]")
    assert late.remedy == "lidars.top.delay = 0.05"  # on top of the 20 ms that the rig has already
    cures = [str(edit) for finding in (turn, late) for cure in finding.cures for edit in cure]
    assert cures == [turn.remedy.partition("; or ")[2], late.remedy]


def test_points_without_their_times_are_no_reason_for_a_delay():
    (late,) = check_mountings([replace(checked((0, 0, 0, 30)), untimed="t")])
    assert late.remedy.startswith('lidars.top.time_field = "t", with its time_unit;')
    assert late.cures == ()


def test_if_all_sensors_agree_the_pose_may_be_off():
    late = (0, 0, 0, 50)
    both = check_mountings([checked(late), checked(late, sensor=CAMERA)])
    assert all("the pose's stamps may be" in f.remedy and not f.cures for f in both)
    apart = check_mountings([checked(late), checked((0, 0, 0, 90), sensor=CAMERA)])
    assert not any("the pose's" in f.remedy for f in apart)
    alone = check_mountings([checked(late), checked(sensor=CAMERA)])
    assert not any("the pose's" in f.remedy for f in alone)
    assert not any("the pose's" in f.remedy for f in check_mountings([checked(late)]))


def test_a_camera_that_seems_turned_may_be_late(monkeypatch):
    """The fit is begun again from other delays; the smallest residuals count, unless there are few of them."""
    turned, late = checked((0, 0, 4.0, 20), scale=0.7).misfit, checked((0, 0, 0, 195), scale=0.5).misfit
    few = replace(checked((0, 30, 0, -150), scale=0.4).misfit, residuals=600)

    def check(*given, start=None):
        return turned if start is None else late if start[3] > 0 else few

    monkeypatch.setattr("offpiste.inspection.sensors.check_camera", check)
    gathered = Gathered({"top": []}, {"front": []}, 0.0, 1.0, 1.0)
    given = {"front": world.camera()}, [CheckedSensor(LIDAR, None)], gathered, world.poses()
    assert camera_misfits(*given)[0].misfit is late
    turned = checked((0, 0, 4.0, 20), scale=0.45).misfit
    assert camera_misfits(*given)[0].misfit is turned


def test_what_could_not_be_checked_is_a_note():
    assert reported(CheckedSensor(CAMERA, None)) == [("note", "front", "could not be checked against the poses")]
    (note,) = check_mountings([checked(sigma=(3.0, 0.1, 0.1, 90))])
    assert note.evidence == "not known: roll (± 3.0 degrees), delay (± 90 ms)"


def test_scans_without_a_common_world():
    assert reported(checked(scale=0.5)) == [("warning", "top", "its scans show no common world")]


def test_kitti(data_folder):
    drive = data_folder / "kitti_raw/2011_09_26/2011_09_26_drive_0013_sync"
    if not drive.is_dir():
        pytest.skip(f"no KITTI drive: {drive}")
    log, rig = open_log(drive), load_rig("kitti")
    sensors = open_sensors(log, rig)
    cameras = {name: small_camera(camera) for name, camera in sensors.cameras.items()}
    gathered = gather(sensors, cameras)
    lidars = lidar_misfits(sensors.lidars, gathered, sensors.poses)
    findings = check_mountings(lidars + camera_misfits(cameras, lidars, gathered, sensors.poses))
    findings += check_sensor_stamps(log, sensors)
    velodyne, wheels = sensors.lidars["velodyne"], rig.vehicle.wheel_positions
    findings += check_own_body(velodyne, gathered.scans["velodyne"], sensors.poses, wheels)
    assert [f for f in findings if f.severity != "note"] == []

    turn = np.deg2rad([0.0, 2.0, 0.0])
    _, turned, same = planted(sensors.lidars, cameras, gathered, "image_02", turn, 0.0)
    (camera,) = camera_misfits(turned, lidars, same, sensors.poses)
    assert camera.is_turned
    assert camera.misfit is not None
    np.testing.assert_allclose(np.rad2deg(camera.misfit.parameters[1]), -2.0, atol=0.4)


@pytest.mark.parametrize(
    ("where", "checked"), [("controls", True), ("steer", True), ("position", False), ("oxts", False)]
)
def test_only_the_pose_decides_whether_sensors_are_checked(where, checked):
    finding = Finding("fatal", where, "is wrong", "", "")
    assert can_be_checked([finding], load_rig("kitti")) == checked
    assert can_be_checked([replace(finding, severity="warning")], load_rig("kitti"))
