"""KITTI's drive is cleared; with a sensor planted wrongly it is not."""

import numpy as np
import pytest

from offpiste.experiments.sensor_faults import planted
from offpiste.logs import open_log
from offpiste.logs.sensors import open_sensors
from offpiste.perception.checks import check_sensors
from offpiste.perception.checks.gather import gather, small_camera
from offpiste.perception.checks.inspect import judge_cameras
from offpiste.perception.checks.verdict import Judged
from offpiste.rig import load_rig


def test_kitti(data_folder):
    drive = data_folder / "kitti_raw/2011_09_26/2011_09_26_drive_0013_sync"
    if not drive.is_dir():
        pytest.skip(f"no KITTI drive: {drive}")
    rig = load_rig("kitti")
    assert [f for f in check_sensors(open_log(drive), rig) if f.severity != "note"] == []

    sensors = open_sensors(open_log(drive), rig)
    cameras = {name: small_camera(camera) for name, camera in sensors.cameras.items()}
    gathered, turn = gather(sensors, cameras), np.deg2rad([0.0, 2.0, 0.0])
    _, turned, same = planted(sensors.lidars, cameras, gathered, "image_02", turn, 0.0)
    (camera,) = judge_cameras(turned, [Judged(sensors.lidars["velodyne"], None)], same, sensors.poses)
    assert camera.is_turned
    assert camera.misfit is not None
    np.testing.assert_allclose(np.rad2deg(camera.misfit.parameters[1]), -2.0, atol=0.4)
