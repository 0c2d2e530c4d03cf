"""How a camera maps directions to pixels, as CameraInfo messages and rigs tell it."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from offpiste.errors import LogError
from offpiste.rig.sensors import Intrinsics

_ALIASES: Final = {"": "plumb_bob", "radtan": "plumb_bob", "fisheye": "equidistant", "kannala_brandt4": "equidistant"}


@dataclass(frozen=True)
class CameraModel:
    """A calibration as recorded; axes z forward, x right, y down; the middle of the first pixel is (0, 0).

    Attributes:
        width, height: of the image [px].
        matrix: K [px].
        distortion: coefficients in the order of CameraInfo's d; none for a rectified image.
        model: ROS's name of the distortion model (sensor_msgs/CameraInfo.msg).
    """

    width: int
    height: int
    matrix: Float[np.ndarray, "3 3"]
    distortion: tuple[float, ...] = ()
    model: str = "plumb_bob"


def model_from_intrinsics(given: Intrinsics) -> CameraModel:
    """What a rig says of a lens."""
    (fx, fy), (cx, cy) = given.focal_length, given.centre
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return CameraModel(given.width, given.height, matrix, given.distortion, given.model)


def model_from_message(message: Any, topic: str, *, rectified: bool) -> tuple[CameraModel, Float[np.ndarray, "4 4"]]:
    """What a CameraInfo says of a lens, and `camera_from_image`: where its images were taken from.

    That is the camera itself, unless they are rectified: then the axes are turned by R, and in the right image of a
    stereo pair the origin is shifted along the baseline (sensor_msgs/CameraInfo.msg).

    Raises:
        LogError: not calibrated, or in a way that is not read.
    """
    # ROS 1 writes these in capitals.
    k, d, r, p = (np.asarray(getattr(message, n, getattr(message, n.upper(), ())), np.float64) for n in "kdrp")
    where = f"topic '{topic}'"
    used = p.reshape(3, 4)[:, :3] if rectified else k.reshape(3, 3)
    if not (np.isfinite(used).all() and used[0, 0] > 0 and used[1, 1] > 0 and message.width and message.height):
        how = "calibrate it, or give intrinsics in the rig"
        raise LogError("the camera is not calibrated: its CameraInfo is empty", where=where, how=how)
    if max(message.binning_x, message.binning_y) > 1 or message.roi.width or message.roi.height:
        how = "give intrinsics in the rig as they hold for the recorded image"
        raise LogError("CameraInfo with binning or a region of interest is not read", where=where, how=how)
    if not rectified:
        model = _ALIASES.get(message.distortion_model, message.distortion_model)
        return CameraModel(message.width, message.height, used, tuple(d.tolist()), model), np.eye(4)
    turn, shift = np.eye(4), np.eye(4)
    turn[:3, :3] = r.reshape(3, 3).T if r.any() else np.eye(3)
    shift[:3, 3] = -np.linalg.solve(used, p.reshape(3, 4)[:, 3])
    return CameraModel(message.width, message.height, used), turn @ shift
