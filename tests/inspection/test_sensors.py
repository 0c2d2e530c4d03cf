"""Findings about mountings and stamps of sensors; first rigs of their topics."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import simulated
from scipy.spatial.transform import Rotation
from simulated import MemoryLog

from offpiste.calibration.misfit import Misfit
from offpiste.calibration.misfit import turned as turned_mounting
from offpiste.calibration.samples import gather, small_camera
from offpiste.cli import main
from offpiste.core.errors import LogError
from offpiste.inspection.draft_sensors import draft_sensors, missing
from offpiste.inspection.inspect import Inspection, inspect_log
from offpiste.inspection.sensors import (
    CheckedSensor,
    camera_misfits,
    check_mountings,
    check_own_body,
    check_sensor_stamps,
    check_sensors,
    lidar_misfits,
)
from offpiste.logs import open_log
from offpiste.logs.log import RawCloud, Topic
from offpiste.logs.measurements import Camera, Lidar
from offpiste.logs.ros.writer import quaternion
from offpiste.logs.sensor_log import open_sensors
from offpiste.rig.camera import CameraModel
from offpiste.rig.rig import load_rig, parse_rig
from offpiste.rig.sensors import CameraSource, LidarSource
from sensor_bags import IMAGE, SENSORS, cloud, compressed, info, odometry, opened, record, sensor_rig, tree

LIDAR = Lidar("top", np.eye(4), LidarSource(topic="/points", delay=0.02))
CAMERA = Camera("front", CameraModel(8, 6, np.eye(3)), np.eye(4), CameraSource(topic="/image"))
DEGREES = np.array([*np.deg2rad([1.0, 1.0, 1.0]), 1e-3])
"""Of parameters given in degrees and ms."""


def checked(parameters=(0, 0, 0, 0), sigma=(0.1, 0.1, 0.1, 1.0), *, sensor=LIDAR, scale=0.02):
    return CheckedSensor(sensor, Misfit(np.array(parameters) * DEGREES, np.array(sigma) * DEGREES, 30, scale, 3000))


@pytest.mark.parametrize(
    ("parameters", "sigma", "found"),
    [
        ((0, 1.0, 0, 0), (0.1, 0.1, 0.1, 1), ["warning looks 1.0 degrees away from its stated mounting"]),
        ((0, 1.0, 0, 0), (0.1, 0.3, 0.1, 1), []),  # not surely more than half a degree
        ((0, 2.0, 0, 0), (0.1, 0.6, 0.1, 1), ["note was checked in part"]),  # not known
        # What is not known hides nothing that is.
        (
            (4.0, 1.0, 0, 0),
            (2.0, 0.1, 0.1, 1),
            ["warning looks 1.0 degrees away from its stated mounting", "note was checked in part"],
        ),
        ((0.6, 0.6, 0.6, 0), (0.1, 0.1, 0.1, 1), ["warning looks 1.0 degrees away from its stated mounting"]),
        ((0, 0, 0, 30), (0.1, 0.1, 0.1, 1), ["warning is stamped 30 ms too late, against the poses"]),
        ((0, 0, 0, -30), (0.1, 0.1, 0.1, 1), ["warning is stamped 30 ms too early, against the poses"]),
        ((0, 0, 0, 30), (0.1, 0.1, 0.1, 7), []),
        ((0, 0, 0, 300), (0.1, 0.1, 0.1, 25), ["note was checked in part"]),
    ],
)
def test_a_misfit_must_be_large_and_sure(parameters, sigma, found):
    said = check_mountings([checked(parameters, sigma)])
    assert [f"{finding.severity} {finding.what}" for finding in said] == found
    assert {finding.where for finding in said} <= {"top"}


def test_remedies_are_rig_lines():
    turn, late = check_mountings([checked((0, 0, 2.0, 30))])
    half = np.deg2rad(1.0)
    assert f"orientation = [0.0, 0.0, {np.sin(half):.6f}, {np.cos(half):.6f}]" in turn.remedy
    assert turn.remedy.startswith("calibrate it again; or lidars.top.body_from_lidar = { position = [0.0, 0.0, 0.0]")
    assert late.remedy == "lidars.top.delay = 0.05"  # on top of the 20 ms that the rig has already
    cures = [str(edit) for finding in (turn, late) for cure in finding.cures for edit in cure]
    assert cures == [turn.remedy.partition("; or ")[2], late.remedy]


def test_if_all_sensors_agree_the_pose_may_be_off():
    late = (0, 0, 0, 50)
    both = check_mountings([checked(late), checked(late, sensor=CAMERA)])
    assert all("the pose's stamps may be" in f.remedy and not f.cures for f in both)
    apart = check_mountings([checked(late), checked((0, 0, 0, 90), sensor=CAMERA)])
    assert not any("the pose's" in f.remedy for f in apart)
    alone = check_mountings([checked(late), checked(sensor=CAMERA)])
    assert not any("the pose's" in f.remedy for f in alone)
    assert not any("the pose's" in f.remedy for f in check_mountings([checked(late)]))


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
    findings += check_own_body(velodyne, gathered, sensors.poses, wheels)
    assert [f for f in findings if f.severity != "note"] == []

    turn = np.deg2rad([0.0, 2.0, 0.0])
    small = cameras["image_02"]
    mounting = turned_mounting(small.camera.body_from_camera, np.append(turn, 0.0))
    wrong = {"image_02": replace(small, camera=replace(small.camera, body_from_camera=mounting))}
    (camera,) = camera_misfits(wrong, lidars, gathered, sensors.poses)
    assert camera.is_turned
    assert camera.misfit is not None
    np.testing.assert_allclose(np.rad2deg(camera.misfit.parameters[1]), -2.0, atol=0.4)


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

    def clouds(self, topic: str, *, stamps: str = "header", times: np.ndarray | None = None) -> Iterator[RawCloud]:
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
            if times is None or at in times:
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
    return log.put("odom", qz=np.sin(yaw / 2), qw=np.cos(yaw / 2))


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


FIXED = [(0, "/tf_static", tree()), (0, "/info", info())]


def stamped(tmp_path, *, image=lambda t: t, until=20.0, last=np.inf, sensors=SENSORS):
    """Findings about a drive of two images and clouds a second; messages arrive in order, images stamped as given."""
    times = np.arange(0.2, until, 0.5).tolist()
    messages = [(t + 0.05, "/points", cloud(t)) for t in times]
    messages += [(t + 0.05, "/image", compressed(image(t), IMAGE)) for t in times if t < last]
    path = record(tmp_path / f"{len(list(tmp_path.iterdir()))}.mcap", messages + FIXED, until=until)
    return check_sensor_stamps(open_log(path), opened(path, sensors))


SHUFFLED = np.random.default_rng(0).permutation(np.arange(0.2, 20.0, 0.5))


@pytest.mark.parametrize(
    ("given", "severity", "what"),
    [
        ({"last": 15.0}, "note", "starts late or stops early"),
        ({"last": 8.0}, "warning", "starts late or stops early"),
        ({"image": lambda t: t if t < 10 else t + 6, "until": 30.0}, "warning", "has a gap"),
        ({"image": lambda t: t * 0.99, "until": 40.0}, "warning", "its clock drifts"),
        (
            {"image": lambda t: SHUFFLED[round(2 * (t - 0.2))]},
            "warning",
            "samples are not in the order of their stamps",
        ),
    ],
)
def test_stamps_of_a_camera(tmp_path, given, severity, what):
    assert stamped(tmp_path) == []
    found = stamped(tmp_path, **given)
    assert (severity, "/image", what) in [(f.severity, f.where, f.what) for f in found]
    assert not any(finding.cures for finding in found)  # no channel is spoilt, and no clock is edited


def test_a_calibration_of_another_size_is_reported_and_stops_nothing(tmp_path):
    messages = [(0.3, "/points", cloud(0.2)), (0.3, "/image", compressed(0.1, np.zeros((60, 80, 3), np.uint8))), *FIXED]
    path = record(tmp_path / "drive.mcap", messages)
    (finding,) = [f for f in check_sensors(open_log(path), sensor_rig()) if f.severity == "warning"]
    assert "images of 80x60 pixels, but a calibration for 8x6" in finding.what
    assert "calibration of these images" in finding.remedy


def test_without_sensors_there_are_no_findings(tmp_path):
    path = record(tmp_path / "drive.mcap")
    assert check_sensors(open_log(path), sensor_rig("")) == []
    optional = sensor_rig('[lidars.top]\ntopic = "/none"\noptional = true\n')
    assert check_sensors(open_log(path), optional) == []
    (finding,) = check_sensors(open_log(path), sensor_rig('[lidars.top]\ntopic = "/none"\n'))
    assert finding.severity == "warning"
    assert "no messages on topic '/none'" in finding.what


def test_a_sensor_by_another_clock_is_given_the_delay_that_puts_it_right(tmp_path):
    (found,) = stamped(tmp_path, image=lambda t: t - 30.0)
    assert (found.severity, found.where) == ("warning", "/image")
    assert found.remedy.startswith("cameras.front.delay = -30.05, ")  # by its arrival
    assert found.cures == ()  # it may as well be sent late
    cured = SENSORS.replace('info = "/info"', 'info = "/info"\ndelay = -30.05')
    assert stamped(tmp_path, image=lambda t: t - 30.0, sensors=cured) == []


SCAN = np.random.default_rng(0).uniform(1, 5, (150, 3))


def turning(seconds: float):
    """A pose that turns: a heading that never changes may be one that is never measured."""
    message = odometry(seconds)
    message.pose.pose.orientation = quaternion((0, 0, np.sin(seconds / 4), np.cos(seconds / 4)))
    return message


def recorded(path: Path, **left_out: bool) -> Path:
    """One image and one scan of 150 points beside a cloud of three, without some of what they need."""
    messages = [
        (0.2, "/front/image_raw/compressed", compressed(0.1, IMAGE)),
        (0.3, "/front/depth/compressed", compressed(0.2, IMAGE)),
        (0.25, "/top/points", cloud(0.2, SCAN)),
        (0.25, "/wheels/points", cloud(0.2)),
    ]
    messages += [(t, "/odom", turning(t)) for t in np.arange(0.05, 1, 0.1).tolist()]
    messages += [] if left_out.get("info") else [(0, "/front/camera_info", info())]
    messages += [] if left_out.get("transforms") else [(0, "/tf_static", tree())]
    return record(path, messages)


def test_the_draft_can_be_read_through(tmp_path: Path) -> None:
    log = open_log(recorded(tmp_path / "log.mcap"))
    text = draft_sensors(log, "/odom")
    rig = sensor_rig(text)
    assert {name: camera.topic for name, camera in rig.cameras.items()} == {"front": "/front/image_raw/compressed"}
    assert {name: lidar.topic for name, lidar in rig.lidars.items()} == {"top": "/top/points"}
    assert rig.cameras["front"].info == "/front/camera_info"
    assert rig.frames.body == "base_link"
    # A mast of 2 m, and the LiDAR half a metre above it.
    sensors = open_sensors(log, rig)
    assert sensors.lidars["top"].body_from_lidar[:3, 3] == pytest.approx([1, 0, 2.5])
    top = rig.lidars["top"]
    assert (top.time_field, top.time_unit, top.time_origin) == ("t", "ns", "stamp")
    assert missing(text) == []


def test_what_the_log_does_not_say_is_missing(tmp_path: Path) -> None:
    text = draft_sensors(open_log(recorded(tmp_path / "log.mcap", info=True, transforms=True)), "/odom")
    rig = sensor_rig(text)
    assert not rig.cameras, "a camera without calibration waits in comments"
    assert "# [cameras.front]" in text
    lines = missing(text)
    assert any(line.startswith("transforms: no TF") for line in lines)
    assert any(line.startswith("calibration of front: no CameraInfo") for line in lines)
    assert any(line.startswith("mounting of top: no fixed transform joins 'lidar' to 'base_link'") for line in lines)
    given = rig.lidars["top"].body_from_lidar
    assert given is not None
    assert given.looks == "forward"
    with pytest.raises(LogError, match="the mounting of 'top' is a rough guess"):
        open_sensors(open_log(tmp_path / "log.mcap"), rig)


def test_images_of_16_bits_are_drafted_with_the_bits_that_they_use(tmp_path: Path) -> None:
    deep = np.arange(48, dtype=np.uint16).reshape(6, 8, 1) * 80
    message = compressed(0.2, deep, "mono16; png compressed ")
    messages = [(0.2, "/cam/image/compressed", message), (0, "/cam/camera_info", info()), (0, "/tf_static", tree())]
    log = open_log(record(tmp_path / "log.mcap", messages))
    rig = sensor_rig(draft_sensors(log, "/odom"))
    assert rig.cameras["cam"].bits == 12
    image = next(open_sensors(log, rig).stream(["cam"]))
    assert (image.pixels.min(), image.pixels.max()) == (0, round(47 * 80 * 255 / 4095))


def test_a_topic_without_pictures_waits_in_comments(tmp_path: Path) -> None:
    message = compressed(0.2, np.zeros((6, 8, 1), np.uint16), "16UC1; png compressed ")
    messages = [(0.2, "/cam/image/compressed", message), (0, "/cam/camera_info", info()), (0, "/tf_static", tree())]
    text = draft_sensors(open_log(record(tmp_path / "log.mcap", messages)), "/odom")
    assert not sensor_rig(text).cameras
    (line,) = missing(text)
    assert line.startswith("pictures of cam: topic '/cam/image/compressed' holds images encoded as '16UC1', which are")


def test_the_command_says_what_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = recorded(tmp_path / "log.mcap", info=True)
    with pytest.raises(SystemExit):
        main(["inspect", str(log), "--write-rig", str(tmp_path / "my.toml")])
    printed = capsys.readouterr().err
    assert f"wrote {tmp_path / 'my.toml'}\n" in printed
    assert "  missing: calibration of front" in printed
    assert "  missing: steering: no field looks like it" in printed
    assert "All topics are named like measurements." in printed
    parse_rig((tmp_path / "my.toml").read_text(), where="my.toml")
