"""Alignment of scans by poses: on made-up walls, and on a real drive with errors that must make it worse."""

import numpy as np
import pytest

from experiments.kitti import APART, VARIANTS, distance_from_upright_planes, scan_alignment
from offpiste.logs import open_log
from offpiste.logs.measurements import Cloud
from offpiste.logs.sensor_log import SensorLog, open_sensors
from offpiste.rig.rig import load_rig


@pytest.fixture(scope="module")
def log(data_folder) -> SensorLog:
    drive = data_folder / "kitti_raw/2011_09_26/2011_09_26_drive_0013_sync"
    if not drive.is_dir():
        pytest.skip(f"no KITTI drive: {drive}")
    return open_sensors(open_log(drive), load_rig("kitti"))


def wall(x: float, *, seed: int = 0) -> np.ndarray:
    """An upright plane with some ground before it."""
    rng = np.random.default_rng(seed)
    upright = np.column_stack((np.full(4000, x), rng.uniform(-5, 5, 4000), rng.uniform(0, 3, 4000)))
    ground = np.column_stack((rng.uniform(x - 5, x - 1, 2000), rng.uniform(-5, 5, 2000), np.zeros(2000)))
    return np.concatenate((upright, ground))


def test_a_wall_that_is_moved_is_off_by_as_much():
    assert distance_from_upright_planes(wall(10.0, seed=1), wall(10.0)) == pytest.approx(0.0, abs=1e-6)
    assert distance_from_upright_planes(wall(10.3, seed=1), wall(10.0)) == pytest.approx(0.3, abs=1e-6)
    # Level ground does not count, nor what has nothing near it.
    lifted = wall(10.0, seed=1) + np.array([0, 0, 0.3])
    assert distance_from_upright_planes(lifted, wall(10.0)) == pytest.approx(0.0, abs=1e-6)
    assert np.isnan(distance_from_upright_planes(wall(20.0), wall(10.0)))
    assert np.isnan(distance_from_upright_planes(wall(10.0)[:10], wall(10.0)))


def test_the_real_drives_scans_lie_on_each_other(log):
    """0.2, 0.4 and 1 s apart. Over 1 s, GPS wanders: some pairs lie further off than 0.2 m, the median does not."""
    lidar, begin = log.lidars["velodyne"], log.poses.span[0]
    scans = [s for s in log.stream(["velodyne"], start=begin + 4.0, end=begin + 9.0) if isinstance(s, Cloud)]
    for apart in APART:
        found = scan_alignment(scans, lidar, log.poses, apart=apart, every=7)
        right, uncompensated, late, unmoved = np.nanmedian(found, axis=0)
        assert np.isfinite(found).all(axis=1).sum() >= 3
        assert right < 0.2, apart
        assert right < min(late, unmoved) / 1.5, (
            apart,
            dict(zip(VARIANTS, (right, uncompensated, late, unmoved), strict=True)),
        )


def test_points_without_their_own_times_lie_further_off(log):
    lidar, begin = log.lidars["velodyne"], log.poses.span[0]
    scans = [s for s in log.stream(["velodyne"], start=begin + 7.0, end=begin + 8.3) if isinstance(s, Cloud)]
    right, uncompensated, *_ = scan_alignment(scans, lidar, log.poses, apart=5, every=1)[0]
    assert right < 0.1
    assert right < uncompensated
