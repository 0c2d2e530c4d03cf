"""Scans and images of the first minute of driving, held in memory for sensor checks."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from offpiste.calibration.misfit import Parameters, turned
from offpiste.core.progress import track
from offpiste.logs.measurements import Camera, Cloud, Image
from offpiste.logs.poses import Poses
from offpiste.logs.sensor_log import SensorLog
from offpiste.perception.camera import Rectifier, make_rectifier, own_body
from offpiste.perception.motion_compensation import MOMENT

_SECONDS: Final = 60.0
"""Duration of driving that is read [s]."""
_PAIRS: Final = 40
"""Desired number of measurement pairs per sensor."""
APART: Final = 0.5
"""Time between the measurements of a pair [s]; long enough for some metres, short enough for sufficient overlap."""
_POINTS: Final = 20_000
"""Maximum number of points per scan."""
FURTHEST: Final = 40.0
"""Maximum range of points; beyond it, they are too sparse for planes [m]."""
_FINE: Final = 400.0
"""Focal length above which images are halved in size [px]."""
_OLD: Final = 0.3
"""Maximum time between an image and the scan used for its depths [s]."""
_MOVING: Final = 1.0
"""Speed above which the vehicle is driving [m/s]."""


@dataclass(frozen=True)
class Scan:
    """Scan with points grouped by measurement time.

    Attributes:
        moments: measurement times [s].
        which: index of each point's moment.
        points: positions in the LiDAR frame at their own moments [m].
        time: median measurement time [s].
    """

    moments: Float[np.ndarray, " t"]
    which: np.ndarray
    points: Float[np.ndarray, "n 3"]
    time: float

    def kept(self, rows: np.ndarray | slice) -> "Scan":
        """Return the scan with some of its points."""
        return replace(self, which=self.which[rows], points=self.points[rows])

    def in_world(
        self,
        body_from_lidar: Float[np.ndarray, "4 4"],
        poses: Poses,
        parameters: Parameters,
        chosen: np.ndarray | slice = slice(None),
    ) -> Float[np.ndarray, "m 3"]:
        """Return points in the world frame for a corrected mounting and delay [m]; NaN if the pose is unknown."""
        matrix = poses.at(self.moments - parameters[3]) @ turned(body_from_lidar, parameters)
        which = self.which[chosen]
        return np.einsum("nij,nj->ni", matrix[which, :3, :3], self.points[chosen]) + matrix[which, :3, 3]


@dataclass(frozen=True)
class Grey:
    """Rectified and downscaled grey image."""

    time: float
    pixels: UInt8[np.ndarray, "h w"]


@dataclass(frozen=True)
class SmallCamera:
    """Camera with rectified and downscaled images.

    Attributes:
        free: pixels that show the environment.
    """

    camera: Camera
    rectifier: Rectifier
    free: Bool[np.ndarray, "h w"]

    def grey(self, image: Image) -> Grey:
        """Return the rectified grey image."""
        return Grey(image.time, np.asarray(self.rectifier(cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY)), np.uint8))


@dataclass(frozen=True)
class Gathered:
    """Time-ordered scans by LiDAR and images by camera."""

    scans: dict[str, list[Scan]]
    images: dict[str, list[Grey]]


def small_camera(camera: Camera) -> SmallCamera:
    """Precompute the rectification maps of a camera.

    Raises:
        PerceptionError: the calibration or mask is invalid.
    """
    model = camera.model
    halved = model.matrix[0, 0] > _FINE
    rectifier = make_rectifier(model, name=camera.name, size=(model.width // 2, model.height // 2) if halved else None)
    free = rectifier.valid & ~rectifier.mask(own_body(camera))
    return SmallCamera(camera, rectifier, np.asarray(free))


def gather(log: SensorLog, cameras: dict[str, SmallCamera]) -> Gathered:
    """Read the measurements of the first minute of driving that form pairs.

    Raises:
        LogError: the log is damaged, or the messages of a sensor are unusable.
    """
    start, end = _driving(log.poses)
    period = max((end - start) / _PAIRS, APART)
    result = Gathered({name: [] for name in log.lidars}, {name: [] for name in cameras})
    names = [*log.lidars, *cameras]
    chosen = {name: _due(log.stamps(name), start, end, period) for name in names}
    for measured in track(log.picked(chosen), "sensors", total=sum(map(len, chosen.values()))):
        if isinstance(measured, Cloud):
            result.scans[measured.lidar].append(_scan(measured))
        else:
            result.images[measured.camera].append(cameras[measured.camera].grey(measured))
    return result


def _due(times: Float[np.ndarray, " n"], start: float, end: float, period: float) -> Int[np.ndarray, " m"]:
    """Return the indices of the first measurements at or after the wanted times, in order of time."""
    wanted = np.arange(start, end, APART if period < 2 * APART else period)
    if period >= 2 * APART:
        wanted = (wanted[:, None] + [0.0, APART]).ravel()
    order = np.argsort(times, kind="stable")
    order = order[(times[order] >= start) & (times[order] <= end)]
    due = np.unique(np.searchsorted(times[order], wanted - 1e-3))
    return np.asarray(order[due[due < len(order)]])


def _driving(poses: Poses) -> tuple[float, float]:
    """Return start and end of the first minute of driving [s]."""
    first, last = poses.span
    times = np.arange(first, last, 0.5)
    places = poses.at(times)[:, :3, 3]
    speed = np.linalg.norm(np.diff(places, axis=0), axis=1) / 0.5
    moving = np.flatnonzero(speed > _MOVING)
    start = float(times[moving[0]]) if len(moving) else first
    return start, min(start + _SECONDS, last)


def pairs(times: list[float]) -> Iterator[tuple[int, int]]:
    """Yield the indices of measurements that are about `APART` apart."""
    for i, time in enumerate(times):
        for j in range(i + 1, len(times)):
            if times[j] - time > 1.6 * APART:
                break
            if times[j] - time > 0.6 * APART:
                yield i, j
                break


def nearest_world(
    scans: Sequence[Scan], time: float, body_from_lidar: Float[np.ndarray, "4 4"], poses: Poses, parameters: Parameters
) -> Float[np.ndarray, "n 3"]:
    """Return the points of the scan nearest to an image, in the world frame [m]; none if it is too old.

    Args:
        time: of the image [s].
        parameters: corrections of the LiDAR's mounting and delay.
    """
    times = np.array([scan.time for scan in scans]) - parameters[3]
    if not len(times) or np.abs(times - time).min() >= _OLD:
        return np.zeros((0, 3))
    world = scans[int(np.abs(times - time).argmin())].in_world(body_from_lidar, poses, parameters)
    return np.asarray(world[np.isfinite(world).all(axis=1)])


def _scan(cloud: Cloud) -> Scan:
    every = max(1, len(cloud.points) // _POINTS)
    ticks, which = np.unique(np.round(cloud.times[::every] / MOMENT), return_inverse=True)
    moments = ticks * MOMENT
    return Scan(moments, which, cloud.points[::every], float(np.median(moments)))
