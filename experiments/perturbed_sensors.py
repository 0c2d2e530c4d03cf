"""Sensor logs with wrong calibrations: cameras whose mountings are rotated, and whose images are stamped late."""

from copy import copy
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from offpiste.logs.channel import Channel
from offpiste.logs.measurements import Camera
from offpiste.logs.sensor_log import SensorLog


@dataclass(frozen=True)
class Flaw:
    """Calibration error of all cameras; LiDARs and poses stay as they are.

    Attributes:
        degrees: angle between the assumed and the true mounting [deg].
        direction: seed of the random rotation axes, one for each camera.
        late: how much too late images are stamped [s].
    """

    degrees: float = 0.0
    direction: int = 0
    late: float = 0.0

    def __str__(self) -> str:
        return f"{self.degrees:g}deg{self.direction}-{1000 * self.late:g}ms"


def perturbed(log: SensorLog, flaw: Flaw) -> SensorLog:
    """A copy of the log with wrong cameras."""
    rng = np.random.default_rng(flaw.direction)
    other = copy(log)
    other.cameras = {name: _perturbed(camera, flaw, rng) for name, camera in log.cameras.items()}
    return other


def stretch(log: SensorLog, start: float, end: float) -> SensorLog:
    """A copy of the log with poses from `start` to `end` [s] only: nothing else is mapped."""
    other = copy(log)
    position, orientation = (_cut(c, start, end) for c in (log.poses.position, log.poses.orientation))
    other.poses = replace(log.poses, position=position, orientation=orientation)
    return other


def turn(degrees: float, rng: np.random.Generator) -> Float[np.ndarray, "4 4"]:
    """Rotation by an angle [deg] about a uniformly random axis."""
    axis = rng.normal(size=3)
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(np.deg2rad(degrees) * axis / np.linalg.norm(axis)).as_matrix()
    return matrix


def _perturbed(camera: Camera, flaw: Flaw, rng: np.random.Generator) -> Camera:
    mounting = camera.body_from_camera @ turn(flaw.degrees, rng)
    # The delay is subtracted from stamps: less of it makes images later.
    source = msgspec.structs.replace(camera.source, delay=camera.source.delay - flaw.late)
    return replace(camera, body_from_camera=mounting, source=source)


def _cut(channel: Channel, start: float, end: float) -> Channel:
    inside = (channel.time >= start) & (channel.time <= end)
    return replace(channel, time=channel.time[inside], values=channel.values[inside])
