"""KITTI's drive is cleared; with a camera planted wrongly it is not."""

import numpy as np
import pytest

from experiments.sensor_faults import planted
from offpiste.inspection.sensor_samples import gather, small_camera
from offpiste.inspection.sensor_stamps import check_own_body, check_sensor_stamps
from offpiste.inspection.sensors import camera_misfits, check_mountings, lidar_misfits
from offpiste.logs import open_log
from offpiste.logs.sensor_log import open_sensors
from offpiste.rig.rig import load_rig


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
    findings += check_own_body(sensors.lidars["velodyne"], gathered.scans["velodyne"], rig.vehicle.wheel_positions)
    assert [f for f in findings if f.severity != "note"] == []

    turn = np.deg2rad([0.0, 2.0, 0.0])
    _, turned, same = planted(sensors.lidars, cameras, gathered, "image_02", turn, 0.0)
    (camera,) = camera_misfits(turned, lidars, same, sensors.poses)
    assert camera.is_turned
    assert camera.misfit is not None
    np.testing.assert_allclose(np.rad2deg(camera.misfit.parameters[1]), -2.0, atol=0.4)
