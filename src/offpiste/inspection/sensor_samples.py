"""The scans and images that sensors are checked by: the first minute of driving, held in memory."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from offpiste.core.progress import track
from offpiste.inspection.misfit import Parameters, turned
from offpiste.logs.measurements import Camera, Cloud, Image
from offpiste.logs.poses import Poses
from offpiste.logs.sensor_log import SensorLog
from offpiste.perception.camera import Rectifier, make_rectifier, own_body
from offpiste.perception.motion_compensation import MOMENT

SECONDS: Final = 60.0
"""Driving that is read [s]."""
_PAIRS: Final = 40
"""Wanted number of pairs of measurements of a sensor."""
APART: Final = 0.5
"""Time between the two of a pair [s]: enough to drive some metres, too short to lose sight of much."""
_POINTS: Final = 20_000
"""Most points of a scan."""
_FINE: Final = 400.0
"""Images with a longer focal length are halved [px]."""
_MOVING: Final = 1.0
"""Speed above which the vehicle is driving [m/s]."""


@dataclass(frozen=True)
class Scan:
    """A scan, its points grouped by the moments at which they were measured.

    Attributes:
        moments: [s].
        which: each point's moment, an index.
        points: in the LiDAR's frame at their own moments [m].
        time: in the middle of it [s].
    """

    moments: Float[np.ndarray, " t"]
    which: np.ndarray
    points: Float[np.ndarray, "n 3"]
    time: float

    def in_world(
        self,
        body_from_lidar: Float[np.ndarray, "4 4"],
        poses: Poses,
        parameters: Parameters,
        chosen: np.ndarray | slice = slice(None),
    ) -> Float[np.ndarray, "m 3"]:
        """Points in the world if the mounting were turned and the stamps late by these; NaN where no pose is known."""
        matrix = poses.at(self.moments - parameters[3]) @ turned(body_from_lidar, parameters)
        which = self.which[chosen]
        return np.einsum("nij,nj->ni", matrix[which, :3, :3], self.points[chosen]) + matrix[which, :3, 3]


@dataclass(frozen=True)
class Grey:
    """A rectified image of brightness, made small."""

    time: float
    pixels: UInt8[np.ndarray, "h w"]


@dataclass(frozen=True)
class SmallCamera:
    """A camera of rectified, smaller images.

    Attributes:
        free: pixels that show the world.
    """

    camera: Camera
    rectifier: Rectifier
    free: Bool[np.ndarray, "h w"]

    def grey(self, image: Image) -> Grey:
        """Its image, rectified."""
        return Grey(image.time, np.asarray(self.rectifier(cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY)), np.uint8))


@dataclass(frozen=True)
class Gathered:
    """Scans by LiDAR and images by camera, in the order of time; `period`: pairs start so far apart [s]."""

    scans: dict[str, list[Scan]]
    images: dict[str, list[Grey]]
    start: float
    end: float
    period: float


def small_camera(camera: Camera) -> SmallCamera:
    """Compute the maps of a camera once.

    Raises:
        PerceptionError: a calibration or mask is wrong.
    """
    model = camera.model
    halved = model.matrix[0, 0] > _FINE
    rectifier = make_rectifier(model, name=camera.name, size=(model.width // 2, model.height // 2) if halved else None)
    free = rectifier.valid & ~rectifier.mask(own_body(camera))
    return SmallCamera(camera, rectifier, np.asarray(free))


def gather(log: SensorLog, cameras: dict[str, SmallCamera]) -> Gathered:
    """Read what is needed of the first minute of driving.

    Raises:
        LogError: the log is damaged, or a sensor's messages are of no use.
    """
    start, end = driving(log.poses)
    period = max((end - start) / _PAIRS, APART)
    result = Gathered({n: [] for n in log.lidars}, {n: [] for n in cameras}, start, end, period)
    names = [*log.lidars, *cameras]
    chosen = {name: _due(log.stamps(name), start, end, period) for name in names}
    for measured in track(log.picked(chosen), "sensors", total=sum(map(len, chosen.values()))):
        if isinstance(measured, Cloud):
            result.scans[measured.lidar].append(_scan(measured))
        else:
            result.images[measured.camera].append(cameras[measured.camera].grey(measured))
    return result


def _due(times: Float[np.ndarray, " n"], start: float, end: float, period: float) -> Int[np.ndarray, " m"]:
    """Indices of those measurements that make pairs: of each moment when one is due, the first thereafter."""
    order = np.argsort(times, kind="stable")
    order = order[(times[order] >= start) & (times[order] <= end)]
    chosen, done = [], 0
    for index in order.tolist():
        if times[index] < start + _wanted(done, period) - 1e-3:
            continue
        while start + _wanted(done, period) - 1e-3 <= times[index]:
            done += 1
        chosen.append(index)
    return np.array(chosen, dtype=np.int64)


def driving(poses: Poses) -> tuple[float, float]:
    """The first minute, from where the vehicle starts to move [s]."""
    first, last = poses.span
    times = np.arange(first, last, 0.5)
    places = poses.at(times)[:, :3, 3]
    speed = np.linalg.norm(np.diff(places, axis=0), axis=1) / 0.5
    moving = np.flatnonzero(speed > _MOVING)
    start = float(times[moving[0]]) if len(moving) else first
    return start, min(start + SECONDS, last)


def pairs(times: list[float]) -> Iterator[tuple[int, int]]:
    """Indices of measurements `APART` from each other, about."""
    for i, time in enumerate(times):
        for j in range(i + 1, len(times)):
            if times[j] - time > 1.6 * APART:
                break
            if times[j] - time > 0.6 * APART:
                yield i, j
                break


def _wanted(index: int, period: float) -> float:
    """When the measurements of pairs are due, after the start [s]."""
    return index * APART if period < 2 * APART else index // 2 * period + index % 2 * APART


def _scan(cloud: Cloud) -> Scan:
    every = max(1, len(cloud.points) // _POINTS)
    ticks, which = np.unique(np.round(cloud.times[::every] / MOMENT), return_inverse=True)
    moments = ticks * MOMENT
    return Scan(moments, which, cloud.points[::every], float(np.median(moments)))
