"""Camera model: image size, intrinsics and distortion, projected and unprojected by OpenCV."""

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from jaxtyping import Float

from offpiste.core.errors import LogError, PerceptionError, did_you_mean
from offpiste.core.limits import MOST_PIXELS
from offpiste.rig.sensors import Intrinsics

FISHEYE: Final = "equidistant"
COEFFICIENTS: Final[dict[str, tuple[int, ...]]] = {
    "plumb_bob": (0, 4, 5),
    "rational_polynomial": (8, 12, 14),
    FISHEYE: (4,),
}
"""Distortion models of ROS's CameraInfo (sensor_msgs/distortion_models.hpp), and their numbers of coefficients.

Brown, "Decentering distortion of lenses", 1966 (plumb_bob); Claus and Fitzgibbon, 2005 (rational); Kannala and Brandt,
2006 (equidistant).
"""

_ALIASES: Final = {"": "plumb_bob", "radtan": "plumb_bob", "fisheye": FISHEYE, "kannala_brandt4": FISHEYE}
_BLOCK: Final = 2048
"""Number of points per call: OpenCV also computes derivatives, 240 bytes a point, which then stay in the cache."""
_ITERATIONS: Final = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-10)


@dataclass(frozen=True)
class CameraModel:
    """Calibration of a camera; axes z forward, x right, y down; the centre of the first pixel is (0, 0)."""

    width: int  # width, height: size of the image [px]
    height: int
    matrix: Float[np.ndarray, "3 3"]  # K [px]
    distortion: tuple[float, ...] = ()  # coefficients in the order of OpenCV and of CameraInfo's d; none for a pinhole
    distortion_model: str = "plumb_bob"  # key of `COEFFICIENTS`; `validate` refuses others

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the image [px]."""
        return self.width, self.height

    def validate(self, name: str) -> None:
        """Refuse an unknown distortion model and impossible numbers; `name` is the camera's, for messages."""
        how = "fix its CameraInfo or its calibration in the rig"
        if self.distortion_model not in COEFFICIENTS:
            what, known = f"unknown distortion model {self.distortion_model!r}", ", ".join(COEFFICIENTS)
            how = f"{did_you_mean(self.distortion_model, COEFFICIENTS)}known are {known}"
            raise PerceptionError(what, where=name, how=how)
        counts = COEFFICIENTS[self.distortion_model]
        if len(self.distortion) not in counts:
            wanted = " or ".join(map(str, counts))
            what = f"{len(self.distortion)} distortion coefficients, {self.distortion_model} has {wanted}"
            raise PerceptionError(what, where=name, how=how)
        if self.width < 1 or self.height < 1 or self.width * self.height > MOST_PIXELS:
            raise PerceptionError(f"invalid image size {self.width}x{self.height} pixels", where=name, how=how)
        if not (np.isfinite(self.matrix).all() and np.isfinite(self.distortion).all()):
            raise PerceptionError("calibration is not finite", where=name, how=how)
        if self.matrix[0, 0] <= 0 or self.matrix[1, 1] <= 0:
            raise PerceptionError("uncalibrated: its focal length is 0 or less", where=name, how=how)

    def project(self, points_camera: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Project points in front of the camera (z > 0) to pixels (x, y)."""
        points = np.ascontiguousarray(points_camera, dtype=np.float64)[:, None]
        project = cv2.fisheye.projectPoints if self.distortion_model == FISHEYE else cv2.projectPoints
        still, distortion = np.zeros(3), np.array(self.distortion, dtype=np.float64)
        pixels = np.empty((len(points), 2))
        for first in range(0, len(points), _BLOCK):
            block = slice(first, first + _BLOCK)
            pixels[block] = project(points[block], still, still, self.matrix, distortion)[0].reshape(-1, 2)
        return pixels

    def unproject(self, pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Return the directions (x / z, y / z) of pixels; NaN outside the field of view of a pinhole."""
        coefficients = np.array(self.distortion or (0.0,) * 4, dtype=np.float64)
        positions = np.ascontiguousarray(pixels, dtype=np.float64)[:, None]
        if self.distortion_model == FISHEYE:
            result = cv2.fisheye.undistortPoints(positions, self.matrix, coefficients)
        else:
            result = cv2.undistortPoints(positions, self.matrix, coefficients, criteria=_ITERATIONS)
        directions = result.reshape(-1, 2)
        seen = np.all(np.abs(directions) < 1e3, axis=1)
        rays = np.column_stack((np.where(seen[:, None], directions, 0.0), np.ones(len(directions))))
        # The iteration may diverge where the polynomial folds back: keep directions that project to the pixel.
        seen = seen & (np.abs(self.project(rays) - pixels).max(axis=1) < 0.1)
        return np.where(seen[:, None], directions, np.nan)

    def edges(self) -> tuple[Float[np.ndarray, "_ 2"], ...]:
        """Return the directions (x / z, y / z) of the pixels along the left, right, top and bottom edge."""
        columns, rows = np.arange(self.width, dtype=np.float64), np.arange(self.height, dtype=np.float64)
        sides = [np.column_stack((np.full_like(rows, x), rows)) for x in (0, self.width - 1)]
        sides += [np.column_stack((columns, np.full_like(columns, y))) for y in (0, self.height - 1)]
        return tuple(self.unproject(side) for side in sides)


def model_from_intrinsics(given: Intrinsics) -> CameraModel:
    """Return the model for a rig's intrinsics."""
    (fx, fy), (cx, cy) = given.focal_length, given.centre
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return CameraModel(given.width, given.height, matrix, given.distortion, given.model)


def model_from_message(message: Any, topic: str, *, rectified: bool) -> tuple[CameraModel, Float[np.ndarray, "4 4"]]:
    """Return the model for a CameraInfo, and `camera_from_image`.

    The latter is the identity for images that are not rectified. The axes of rectified images are rotated by R, and the
    origin of the right image of a stereo pair is shifted along the baseline (sensor_msgs/CameraInfo.msg).
    """
    # ROS 1 names them in capitals.
    k, d, r, p = (np.asarray(getattr(message, n, getattr(message, n.upper(), ())), np.float64) for n in "kdrp")
    where = f"topic '{topic}'"
    used = p.reshape(3, 4)[:, :3] if rectified else k.reshape(3, 3)
    if not (np.isfinite(used).all() and used[0, 0] > 0 and used[1, 1] > 0 and message.width and message.height):
        how = "calibrate it, or give intrinsics in the rig"
        raise LogError("the camera is not calibrated: its CameraInfo is empty", where=where, how=how)
    roi, size = message.roi, (message.width, message.height)
    part = (roi.width, roi.height) not in ((0, 0), size) or roi.x_offset or roi.y_offset  # zeros mean the full image
    if max(message.binning_x, message.binning_y) > 1 or part:
        how = "give the intrinsics of the recorded image in the rig"
        raise LogError("CameraInfo with binning or a region of interest is not supported", where=where, how=how)
    if not rectified:
        model = _ALIASES.get(message.distortion_model, message.distortion_model)
        return CameraModel(message.width, message.height, used, tuple(d.tolist()), model), np.eye(4)
    turn, shift = np.eye(4), np.eye(4)
    turn[:3, :3] = r.reshape(3, 3).T if r.any() else np.eye(3)
    shift[:3, 3] = -np.linalg.solve(used, p.reshape(3, 4)[:, 3])
    return CameraModel(message.width, message.height, used), turn @ shift
