"""Scans of level ground by LiDARs on a vehicle whose pose may jump, as a log without a file."""

from collections.abc import Iterator

import numpy as np

from offpiste.logs.channel import Channel
from offpiste.logs.measurements import Cloud, Image, Lidar
from offpiste.logs.poses import Poses
from offpiste.logs.sensor_log import SensorLog
from offpiste.mapping.pipeline import MapSettings
from offpiste.mapping.replay import MapperSettings
from offpiste.mapping.voxel_map import VoxelSettings
from offpiste.rig.sensors import LidarSource

SETTINGS = MapperSettings(0.5, map=MapSettings(VoxelSettings(reach=24.0, capacity=200_000, threads=1)))


class ScriptedLog(SensorLog):
    """Scans and poses that are given."""

    def __init__(self, scans: list[Cloud], lidars: dict[str, Lidar], poses: Poses) -> None:
        self.lidars, self.cameras, self.poses, self._scans = lidars, {}, poses, scans

    def stream(self, *_: object, **__: object) -> Iterator[Image | Cloud]:
        return iter(self._scans)


def jumping_log(scans: list[Cloud], lidars: dict[str, Lidar], *, jump: float = np.inf) -> ScriptedLog:
    """A log of a vehicle at 5 m/s on level ground, whose pose jumps 3 m up and 5 m aside at a time [s]."""
    time = np.arange(0, 8.001, 0.02)
    after = time >= jump
    position = Channel("position", "m", time, np.column_stack((5 * time, 5.0 * after, 3.0 * after)))
    orientation = Channel("orientation", "", time, np.tile([0, 0, 0, 1.0], (len(time), 1)))
    jumps = [(time[~after][-1], time[after][0])] if after.any() else []
    poses = Poses(position, orientation, 0.2, np.array(jumps).reshape(-1, 2))
    return ScriptedLog(scans, lidars, poses)


def ring(reach: float = 20.0, half: float = np.pi) -> np.ndarray:
    """Points on level ground 2 m below a LiDAR."""
    angle, radius = (grid.ravel() for grid in np.meshgrid(np.linspace(-half, half, 400), np.linspace(3, reach, 60)))
    return np.column_stack((radius * np.cos(angle), radius * np.sin(angle), np.full(angle.size, -2.0)))


def mast(name: str) -> Lidar:
    mounting = np.eye(4)
    mounting[2, 3] = 2.0
    return Lidar(name, mounting, LidarSource(f"/{name}"))
