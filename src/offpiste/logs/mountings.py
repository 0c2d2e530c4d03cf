"""Sensors of a log, calibrated and mounted, by its rig or by its own messages."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import LogError
from offpiste.logs.log import Log
from offpiste.logs.measurements import Camera, Lidar
from offpiste.logs.transforms import Transform, between
from offpiste.rig.camera import model_from_intrinsics
from offpiste.rig.rig import Rig
from offpiste.rig.sensors import CameraSource, LidarSource, Mounting


def camera_of(log: Log, rig: Rig, name: str, entry: CameraSource, transforms: Sequence[Transform]) -> Camera:
    """A camera of a log, calibrated and mounted.

    Raises:
        LogError: no calibration, or no chain of transforms to the body.
    """
    camera_from_image = np.eye(4)
    if entry.intrinsics is not None:
        model = model_from_intrinsics(entry.intrinsics)
    elif entry.info not in log.topics:
        what = f"'{name}': images without calibration: no topic '{entry.info}'"
        raise LogError(what, where=log.path, how=f"give cameras.{name}.intrinsics in the rig")
    else:
        model, camera_from_image = log.camera_model(entry.info, rectified=entry.rectified)
    return Camera(name, model, body_from_sensor(log, rig, entry, transforms) @ camera_from_image, entry)


def lidar_of(log: Log, rig: Rig, name: str, entry: LidarSource, transforms: Sequence[Transform]) -> Lidar:
    """A LiDAR of a log, mounted (see `camera_of`)."""
    return Lidar(name, body_from_sensor(log, rig, entry, transforms), entry)


def refuse_rough(log: Log, entries: Mapping[str, CameraSource | LidarSource]) -> None:
    """Refuse mountings that are rough guesses.

    Raises:
        LogError: of which sensor, and how to estimate it.
    """
    for name, entry in entries.items():
        given = given_mounting(entry)
        if given is not None and given.is_rough:
            how = "run `offpiste inspect LOG --rig RIG --estimate-mountings`, and put its lines into the rig"
            raise LogError(
                f"the mounting of '{name}' is a rough guess, looks = \"{given.looks}\"", where=log.path, how=how
            )


def given_mounting(entry: CameraSource | LidarSource) -> Mounting | None:
    """The mounting that the rig gives for a sensor, if it does."""
    return entry.body_from_camera if isinstance(entry, CameraSource) else entry.body_from_lidar


def body_from_sensor(
    log: Log, rig: Rig, entry: CameraSource | LidarSource, transforms: Sequence[Transform]
) -> Float[np.ndarray, "4 4"]:
    """The mounting of a sensor, by the rig or else by the log's transforms.

    Raises:
        LogError: no chain of transforms joins its frame to the body's.
    """
    given = given_mounting(entry)
    if given is not None:
        return given.matrix(optical=isinstance(entry, CameraSource))
    return between(transforms, rig.frames.body, entry.frame or log.frame(entry.topic), path=log.path)
