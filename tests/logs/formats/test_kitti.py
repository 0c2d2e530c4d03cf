"""KITTI raw drives: a synthetic and a recorded one."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from msgspec import structs
from scipy.spatial.transform import Rotation

from kitti_drive import kitti_drive
from offpiste.core.errors import LogError
from offpiste.logs import open_log, read_drive
from offpiste.logs.formats.kitti import KittiLog, pose_from_oxts, time_in_sweep
from offpiste.logs.measurements import Cloud, Image
from offpiste.logs.sensor_log import SensorLog, open_sensors
from offpiste.rig.rig import load_rig

DRIVE = "kitti_raw/2011_09_26/2011_09_26_drive_0013_sync"
RIG = load_rig("kitti")
SLOW = structs.replace(RIG, clock=structs.replace(RIG.clock, max_gap=2.0))
"""For a row a second."""


def made_up(day: Path) -> Path:
    """Write three OXTS rows, one image and two scans, of frames 0 and 2."""
    drive = kitti_drive(day, 3, 1.0, "S_rect_02: 8 6\nP_rect_02: 5 0 3.5 2 0 5 2.5 0 0 0 1 0\n")
    cv2.imwrite(str(drive / "image_02" / "data" / "0000000002.png"), np.full((6, 8, 3), (10, 20, 30), np.uint8))
    scan = np.array([[5, 0, 0, 0.5], [0, 6, 0, 0.25], [0, -6, 0, 0.25], [0.1, 0, 0, 1]], "<f4")
    scan.tofile(drive / "velodyne_points" / "data" / "0000000000.bin")
    np.savetxt(drive / "velodyne_points" / "data" / "0000000002.txt", scan)
    return drive


def test_a_drive_is_recognised_and_its_rows_are_read(tmp_path):
    log = open_log(made_up(tmp_path))
    assert isinstance(log, KittiLog)
    assert {name: topic.count for name, topic in log.topics.items()} == {
        "oxts": 3, "image_02": 1, "velodyne_points": 2,
    }  # fmt: skip
    samples = log.read("oxts", ["x", "y", "z", "qz", "qw"])
    np.testing.assert_allclose(np.diff(samples.time), [1, 1])
    # A hundred-thousandth of a degree of latitude is 1.11 m of the devkit's sphere, northward.
    np.testing.assert_allclose(samples.values[:, 0], 0, atol=1e-6)
    np.testing.assert_allclose(samples.values[:, 1], np.deg2rad([0, 1e-5, 2e-5]) * 6378137, atol=1e-4)
    np.testing.assert_allclose(samples.values[:, 2:], [[z, np.sqrt(0.5), np.sqrt(0.5)] for z in (0, 1, 2)])


def test_orientations_are_the_devkits_euler_angles():
    rows = np.zeros((20, 30))
    rows[:, :6] = np.random.default_rng(0).uniform(-1, 1, (20, 6))
    found = Rotation.from_quat(pose_from_oxts(rows)[:, 3:]).as_matrix()
    roll, pitch, yaw = (Rotation.from_euler(axis, rows[:, k, None]).as_matrix() for k, axis in enumerate("xyz", 3))
    np.testing.assert_allclose(found, yaw @ pitch @ roll, atol=1e-12)


def test_sensors_through_the_calibration_files(tmp_path):
    log = open_sensors(open_log(made_up(tmp_path)), SLOW)
    found = list(log.stream())
    first, second = (m for m in found if isinstance(m, Cloud))
    (image,) = (m for m in found if isinstance(m, Image))
    np.testing.assert_allclose(first.points, [(5, 0, 0), (0, 6, 0), (0, -6, 0)])  # nearer than 2.5 m: the roof
    np.testing.assert_allclose(first.points, second.points)
    np.testing.assert_allclose(first.offset, [0, -0.025, 0.025], atol=1e-6)  # ahead, left before it, right after it
    assert image.pixels[0, 0].tolist() == [30, 20, 10]
    np.testing.assert_allclose(log.lidars["velodyne"].body_from_lidar[:3, 3], [1, 0, 2])
    # The reference camera is 0.5 m ahead of the Velodyne; image_02 stands P[0, 3] / fx = 0.4 m to its left.
    camera = log.cameras["image_02"]
    np.testing.assert_allclose(camera.body_from_camera[:3, 3], [1.5, 0.4, 2], atol=1e-12)
    np.testing.assert_allclose(camera.body_from_camera[:3, 2], [1, 0, 0], atol=1e-12)
    assert (camera.model.width, camera.model.matrix[0, 2]) == (8, 3.5)


def test_the_velodyne_turns_clockwise_from_behind():
    directions = np.array([[-1, 1e-9], [0, 1], [1, 0], [0, -1], [-1, -1e-9]], float)
    np.testing.assert_allclose(time_in_sweep(directions, -0.05, 0.05), [-0.05, -0.025, 0, 0.025, 0.05], atol=1e-9)


SECOND_ROW, FIRST_SCAN = "oxts/data/0000000001.txt", "velodyne_points/data/0000000000.bin"


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("../calib_velo_to_cam.txt", None, "calib_velo_to_cam.txt: no calibration"),
        ("../calib_imu_to_velo.txt", "T: 1 2 3", "file lacks R"),
        ("oxts/timestamps.txt", "yesterday\n", "no stamps"),
        (SECOND_ROW, "1 2 3", "3 numbers, not 30"),
        (SECOND_ROW, "one", "not a row of numbers"),
        ("velodyne_points/timestamps.txt", "2011-09-26 13:10:50.5\n", "1 stamps, but a frame 2"),
        (FIRST_SCAN, "\0" * 20, "not rows of"),
        ("image_02/data/thumbs.db", "", "its name is not a frame number"),
    ],
)
def test_damaged_drives_end_in_one_line(tmp_path, file, content, message):
    drive = made_up(tmp_path)
    (drive / file).unlink() if content is None else (drive / file).write_text(content)
    with pytest.raises(LogError, match=message) as error:
        list(open_sensors(open_log(drive), SLOW).stream())
    assert "\n" not in str(error.value)


@pytest.fixture(scope="module")
def real(data_folder) -> SensorLog:
    drive = data_folder / DRIVE
    if not drive.is_dir():
        pytest.skip(f"no KITTI drive: {drive}")
    return open_sensors(open_log(drive), RIG)


def test_the_real_drive_has_poses_that_move_as_its_velocities_say(real):
    drive = read_drive(real.path, RIG)
    place, velocity = drive.channels["position"], drive.channels["linear_velocity"]
    moved = np.linalg.norm(np.diff(place.values[:, :2], axis=0), axis=1).sum()
    driven = (np.linalg.norm(velocity.values[:, :2], axis=1)[1:] * np.diff(velocity.time)).sum()
    assert moved == pytest.approx(driven, rel=0.02)
    # The nose points where the vehicle goes.
    went = np.diff(place.values[:, :2], axis=0)
    ahead = real.poses.at(place.time[1:])[:, :2, 0]
    assert np.median(np.einsum("ni,ni->n", went, ahead) / np.linalg.norm(went, axis=1)) > 0.999


def test_the_real_drives_sensors_stop_before_its_poses(real):
    assert real.coverage() == ("image_02: stops 3.4 s before the poses", "velodyne: stops 3.4 s before the poses")


def test_a_link_to_a_drive_finds_the_days_calibration(tmp_path, data_folder):
    link = tmp_path / "linked_sync"
    link.symlink_to(data_folder / DRIVE)
    assert len(KittiLog(link).transforms([])) == len(KittiLog(data_folder / DRIVE).transforms([]))
    # A link may also lie beside the calibration, and lead to where there is none.
    elsewhere, day = tmp_path / "elsewhere", tmp_path / "day"
    drive = made_up(day)
    elsewhere.mkdir()
    drive.rename(elsewhere / "drive_sync")
    (day / "drive_sync").symlink_to(elsewhere / "drive_sync")
    assert len(KittiLog(day / "drive_sync").transforms([])) == 2
    with pytest.raises(LogError, match=r"no calibration file: .*; put the day's calibration files into the folder"):
        KittiLog(elsewhere / "drive_sync").transforms([])
