"""A log in memory with one camera and one LiDAR over level ground, at the topics of the proving ground."""

from pathlib import Path

import numpy as np

from experiments.inspection_faults.sensor_faults import LAYOUTS, SensorCase
from offpiste.logs.log import Log, RawCloud, RawImage, Samples, Topic

TIMES = 1000 + 0.5 * np.arange(40)
GROUND = -0.36
"""Height of the ground in the body frame, below the wheels' centres [m]."""


class MadeUpSensors(Log):
    """Level ground up to 40 m away; images that tell their number; a pose that stays at its height."""

    has_sensors = True

    def __init__(self, layout):
        self.path, self._layout = Path("made-up"), layout

    @property
    def topics(self):
        names = ("/odometry", "/camera_front/image/compressed", "/lidar_top/points")
        return {name: Topic(name, "memory", len(TIMES), ("pose.pose.position.z",)) for name in names}

    def _read(self, topic, fields, stamps):
        return Samples(TIMES, np.zeros((len(TIMES), len(fields))))

    def stamps(self, topic, *, stamps="header"):
        return TIMES

    def images(self, topic, *, stamps="header", times=None):
        for number in np.searchsorted(TIMES, times):
            yield RawImage(float(TIMES[number]), "camera_front", np.full((4, 6, 3), number, np.uint8))

    def clouds(self, topic, *, stamps="header", times=None):
        pose = self._layout.lidar
        for time in times.tolist():
            random = np.random.default_rng(int(10 * time))
            around, away = random.uniform(-np.pi, np.pi, 20_000), random.uniform(2.5, 40.0, 20_000)
            body = np.stack((away * np.cos(around), away * np.sin(around), np.full(20_000, GROUND)), axis=1)
            points = np.zeros(len(body), [(axis, "<f4") for axis in "xyz"])
            points["x"], points["y"], points["z"] = ((body - pose.position) @ pose.rotation).T
            yield RawCloud(time, "lidar_top", points)


def sensor_case(layout="mast"):
    """A healthy case."""
    return SensorCase(MadeUpSensors(LAYOUTS[layout]), LAYOUTS[layout].rig(), LAYOUTS[layout])


def body_points(case, time=TIMES[0]):
    """Points of a cloud in the body frame, as the log gives them."""
    (cloud,) = case.log.clouds("/lidar_top/points", times=np.array([time]))
    points = np.stack([cloud.points[axis] for axis in "xyz"], axis=1).astype(float)
    return points @ case.layout.lidar.rotation.T + case.layout.lidar.position
