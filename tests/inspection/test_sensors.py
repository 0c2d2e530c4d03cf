"""What becomes a warning, what a note, and what the remedies say.

KITTI's drive is cleared; with a camera planted wrongly it is not.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import simulated
from scipy.spatial.transform import Rotation
from simulated import MemoryLog

import textured_world as world
from offpiste.inspection.findings import Finding
from offpiste.inspection.inspect import Inspection, inspect_log
from offpiste.inspection.misfit import Misfit
from offpiste.inspection.misfit import turned as turned_mounting
from offpiste.inspection.own_body import check_own_body
from offpiste.inspection.sensor_samples import Gathered, gather, small_camera
from offpiste.inspection.sensor_stamps import check_sensor_stamps
from offpiste.inspection.sensors import CheckedSensor, camera_misfits, can_be_checked, check_mountings, lidar_misfits
from offpiste.logs import open_log
from offpiste.logs.log import RawCloud, Topic
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
    (late,) = check_mountings([replace(checked((0, 0, 0, 30)), untimed='lidars.top.time_field = "t"')])
    assert late.remedy.startswith('lidars.top.time_field = "t"; only if its scans are compensated: ')
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
    small = cameras["image_02"]
    mounting = turned_mounting(small.camera.body_from_camera, np.append(turn, 0.0))
    wrong = {"image_02": replace(small, camera=replace(small.camera, body_from_camera=mounting))}
    (camera,) = camera_misfits(wrong, lidars, gathered, sensors.poses)
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


class AmongWalls(MemoryLog):
    """A drive whose LiDAR sees ground and walls, whatever its log says of it."""

    has_sensors = True

    def __init__(self, log: MemoryLog, true: MemoryLog) -> None:
        super().__init__(log.data)
        self.true, self.times = true, true.data["odom"][0][50:-50:25]

    @property
    def topics(self) -> dict[str, Topic]:
        return super().topics | {"points": Topic("points", "sensor_msgs/PointCloud2", len(self.times), ())}

    def stamps(self, topic: str, *, stamps: str = "header") -> np.ndarray:
        return self.times if topic == "points" else super().stamps(topic, stamps=stamps)

    def frame(self, topic: str) -> str:
        return "lidar"

    def clouds(self, topic: str, *, stamps: str = "header") -> Iterator[RawCloud]:
        random, (time, odom) = np.random.default_rng(0), self.true.data["odom"]
        yaw = np.unwrap(2 * np.arctan2(odom["qz"], odom["qw"]))
        for at in self.times.tolist():
            here, turn = np.array([np.interp(at, time, odom[axis]) for axis in "xyz"]), np.interp(at, time, yaw)
            seen = random.uniform(-20, 20, (3000, 3)) + here
            seen[:, 2] = here[2] + np.where(np.arange(3000) < 1000, 0.0, random.uniform(0, 4, 3000))
            for wall, axis in ((slice(1000, 2000), 0), (slice(2000, 3000), 1)):
                seen[wall, axis] = 14 * np.round(seen[wall, axis] / 14)
            points = (seen - here - [0, 0, 2]) @ Rotation.from_euler("z", turn).as_matrix()
            records = np.rec.fromarrays(points.astype(np.float32).T, names="x, y, z")
            yield RawCloud(at, "lidar", np.asarray(records))


def among_walls(log: MemoryLog) -> Inspection:
    """Of a drive of another log than what its one LiDAR sees, whose mounting and stamps are right."""
    mounting = "{ position = [0.0, 0.0, 2.0], orientation = [0.0, 0.0, 0.0, 1.0] }"
    lidar = f'[lidars.top]\ntopic = "points"\nbody_from_lidar = {mounting}\n'
    given = simulated.rig(("[channels.position]", lidar + "[channels.position]"))
    return inspect_log(AmongWalls(log, simulated.drive_log(seconds=60)), given, sensors=True)


def turned(degrees: float) -> MemoryLog:
    """The drive with its heading turned."""
    log = simulated.drive_log(seconds=60)
    _, odom = log.data["odom"]
    yaw = 2 * np.arctan2(odom["qz"], odom["qw"]) + np.radians(degrees)
    return log.change("odom", "qz", lambda _: np.sin(yaw / 2)).change("odom", "qw", lambda _: np.cos(yaw / 2))


@pytest.mark.parametrize(("degrees", "severity"), [(25.0, "warning"), (-90.0, "fatal")])
def test_a_heading_that_is_cured_does_not_turn_the_lidar_as_well(degrees: float, severity: str) -> None:
    found = among_walls(turned(degrees))
    serious = [(finding.severity, finding.where) for finding in found.findings if finding.severity != "note"]
    assert serious == [(severity, "orientation")]
    assert [edit.key for edit in found.cure] == ["channels.orientation.offset"]
    assert any(finding.where == "LiDARs" for finding in found.findings)  # which were looked at


def test_what_the_cure_of_a_late_pose_leaves_is_no_delay_of_the_lidar() -> None:
    found = among_walls(simulated.drive_log(seconds=60).restamp("odom", lambda time: time + 0.5))
    assert {edit.key for edit in found.cure} >= {"channels.position.delay", "channels.orientation.delay"}
    (top,) = [finding for finding in found.findings if finding.where == "top"]
    assert top.cures == ()
    assert "the pose is cured above" in top.remedy


def test_a_turn_that_only_the_lidar_shows_is_cured_there() -> None:
    assert [edit.key for edit in among_walls(turned(5.0)).cure] == ["lidars.top.body_from_lidar"]
