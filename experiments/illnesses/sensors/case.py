"""A log with a camera and a LiDAR, the rig that it is read through, and the truth about both."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from experiments.illnesses.sensors.drives import CAMERA, LAYOUTS, LIDAR, Layout, SensorDrive
from offpiste.logs.log import Log, RawCloud, RawImage, Samples, Topic, open_log
from offpiste.logs.transforms import Transform
from offpiste.rig.camera import CameraModel
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig


class ChangedLog(Log):
    """A bag, some measurements of which are changed as they are read.

    Args:
        log: the bag as it was recorded.
        cloud: gives another cloud for each.
        shown: gives, for stamps of images, the stamps of those that are shown instead [s].
        height: gives what is added to z of the poses at some times [s, m].
    """

    description = "a changed bag"
    has_sensors = has_messages = has_arrivals = True

    def __init__(
        self,
        log: Log,
        *,
        cloud: Callable[[RawCloud], RawCloud] | None = None,
        shown: Callable[[np.ndarray], np.ndarray] | None = None,
        height: Callable[[np.ndarray], np.ndarray] | None = None,
    ) -> None:
        self.path, self.warnings, self._log = log.path, log.warnings, log
        self._cloud, self._shown, self._height = cloud, shown, height

    @property
    def topics(self) -> dict[str, Topic]:
        """Those of the bag."""
        return self._log.topics

    def _read(self, topic: Topic, fields: Sequence[str], stamps: str) -> Samples:
        samples = self._log.read(topic.name, fields, stamps=stamps)
        z = [number for number, name in enumerate(fields) if name == "pose.pose.position.z"]
        if self._height is None or not z:
            return samples
        values = samples.values.copy()
        values[:, z] += self._height(samples.time)[:, None]
        return Samples(samples.time, values)

    def stamps(self, topic: str, *, stamps: str = "header") -> Float[np.ndarray, " n"]:
        """Those of the bag."""
        return self._log.stamps(topic, stamps=stamps)

    def transforms(self, topics: Sequence[str]) -> list[Transform]:
        """Those of the bag."""
        return self._log.transforms(topics)

    def camera_model(self, topic: str, *, rectified: bool) -> tuple[CameraModel, Float[np.ndarray, "4 4"]]:
        """That of the bag."""
        return self._log.camera_model(topic, rectified=rectified)

    def frame(self, topic: str) -> str:
        """That of the bag."""
        return self._log.frame(topic)

    def clouds(self, topic: str, *, stamps: str = "header") -> Iterator[RawCloud]:
        """Clouds, changed."""
        return map(self._cloud or (lambda cloud: cloud), self._log.clouds(topic, stamps=stamps))

    def clouds_at(self, topic: str, times: Float[np.ndarray, " n"], *, stamps: str = "header") -> Iterator[RawCloud]:
        """Clouds, changed."""
        return map(self._cloud or (lambda cloud: cloud), self._log.clouds_at(topic, times, stamps=stamps))

    def images_at(self, topic: str, times: Float[np.ndarray, " n"], *, stamps: str = "header") -> Iterator[RawImage]:
        """Images with their own stamps, and the pixels of those that are shown instead."""
        if self._shown is None:
            yield from self._log.images_at(topic, times, stamps=stamps)
            return
        instead = self._shown(times)
        images = {one.time: one for one in self._log.images_at(topic, np.unique(instead), stamps=stamps)}
        for time, other in zip(times.tolist(), instead.tolist(), strict=True):
            yield replace(images[other], time=time)


@dataclass(frozen=True)
class SensorCase:
    """A log and the rig that it is read through; illnesses change one, the other, or both.

    Attributes:
        layout: where the sensors are in truth; their stamps have no delay.
        part: a place in the body frame where a part of the vehicle stands in view [m].
    """

    log: Log
    rig: Rig
    layout: Layout
    part: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def with_rig(self, *entries: tuple[str, object]) -> "SensorCase":
        """The case with some entries of the rig set."""
        return replace(self, rig=edited(self.rig, [Edit(key, value) for key, value in entries]))

    def with_clouds(self, change: Callable[[np.ndarray, np.random.Generator], np.ndarray], seed: int) -> "SensorCase":
        """The case with other points in its clouds.

        Args:
            change: takes the points of a cloud in the body frame [n, 3] [m], and random numbers of that cloud.
        """
        pose = self.layout.lidar

        def changed(cloud: RawCloud) -> RawCloud:
            points = np.stack([cloud.points[axis] for axis in "xyz"], axis=1).astype(np.float64)
            random = np.random.default_rng([seed, int(1e3 * cloud.time)])
            body = change(points @ pose.rotation.T + pose.position, random)
            records = cloud.points.copy()
            for axis, column in zip("xyz", ((body - pose.position) @ pose.rotation).T, strict=True):
                records[axis] = column
            return replace(cloud, points=records)

        return replace(self, log=ChangedLog(self.log, cloud=changed))


def case_of(drive: SensorDrive) -> SensorCase:
    """The healthy case of a drive."""
    layout = LAYOUTS[drive.layout]
    rig = layout.rig()
    return SensorCase(open_log(drive.path, clock=rig.clock), rig, layout)


def mounting_key(name: str) -> str:
    """The rig's entry for the mounting of a sensor."""
    return f"cameras.{CAMERA}.body_from_camera" if name == CAMERA else f"lidars.{LIDAR}.body_from_lidar"


def true_mounting(layout: Layout, name: str) -> Float[np.ndarray, "4 4"]:
    """`body_from_sensor` in truth."""
    pose = layout.camera if name == CAMERA else layout.lidar
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = pose.rotation, pose.position
    return matrix


def sensor_errors(rig: Rig, layout: Layout, name: str) -> tuple[float, float]:
    """By how much a rig's mounting of a sensor is turned from the true one [deg], and its delay wrong [s]."""
    source = rig.cameras[CAMERA] if name == CAMERA else rig.lidars[LIDAR]
    given = source.mounting
    if given is None:  # the log's own transform is the truth
        return 0.0, abs(source.delay)
    wrong = given.matrix()[:3, :3] @ true_mounting(layout, name)[:3, :3].T
    return float(np.rad2deg(Rotation.from_matrix(wrong).magnitude())), abs(source.delay)
