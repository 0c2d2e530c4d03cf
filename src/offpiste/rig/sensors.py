"""Cameras and LiDARs of a rig: topics, mountings and calibrations."""

from typing import Annotated, Final, Literal

import msgspec
import numpy as np
from jaxtyping import Float
from msgspec import Meta

from offpiste.core.errors import RigError
from offpiste.rig.schema import Finite, Positive, refuse

Box = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Lowest and highest x, y, z [m]."""
Polygon = Annotated[tuple[tuple[float, float], ...], Meta(min_length=3)]
"""Corners x, y [px]."""

TIME_FIELDS: Final = ("t", "time", "timestamp", "time_stamp", "offset_time")
"""Names of point times in the fields of common drivers."""
OPTICAL: Final = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation from the axes of a forward-looking camera (z forward, x right, y down) to body axes."""
_DIRECTIONS: Final = {"forward": (1, 0), "left": (0, 1), "back": (-1, 0), "right": (0, -1)}
"""x and y in the body frame."""


class Frames(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Body frame, and topics with the transforms of a log."""

    body: str = "base_link"  # frame whose pose `position` and `orientation` give: x forward, y left, z up
    topics: tuple[str, ...] = ("/tf_static",)  # of tf2_msgs/TFMessage; the first transform of each pair is used


class Mounting(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Pose of a sensor on the vehicle, `body_from_sensor`."""

    position: tuple[Finite, Finite, Finite] | None = None  # in the body frame [m]; None in a guess without a position
    # Quaternion xyzw; (-0.5, 0.5, -0.5, 0.5) for the optical axes of a forward-looking camera.
    orientation: tuple[float, float, float, float] | None = None
    # Rough direction in place of `orientation`, to start `inspect --estimate-mountings`; refused by all other commands.
    looks: Literal["", "forward", "left", "back", "right"] = ""

    def matrix(self, *, optical: bool = False) -> Float[np.ndarray, "4 4"]:
        """Return the 4 x 4 transform `body_from_sensor`.

        Args:
            optical: whether a sensor mounted by `looks` has the axes of a camera (z forward, x right, y down); without
                effect on an `orientation`.
        """
        from offpiste.core.geometry import rotation_from_quaternion

        matrix = np.eye(4)
        if self.orientation is not None:
            matrix[:3, :3] = rotation_from_quaternion(np.array([self.orientation]))[0]
        else:
            x, y = _DIRECTIONS[self.looks]
            matrix[:2, :2] = [[x, -y], [y, x]]
            matrix[:3, :3] = matrix[:3, :3] @ (OPTICAL if optical else np.eye(3))
        matrix[:3, 3] = (0.0, 0.0, 0.0) if self.position is None else self.position
        return matrix


class Intrinsics(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Calibration of a camera whose log has no CameraInfo."""

    width: Annotated[int, Meta(ge=1)]  # width, height: size of the image [px]
    height: Annotated[int, Meta(ge=1)]
    focal_length: tuple[Positive, Positive]  # fx, fy [px]
    centre: tuple[float, float]  # cx, cy [px]; the centre of the first pixel is (0, 0)
    distortion: tuple[float, ...] = ()  # coefficients in the order of CameraInfo's `d`
    model: Literal["plumb_bob", "rational_polynomial", "equidistant"] = "plumb_bob"  # the last is OpenCV's fisheye


class CameraSource(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Source of a camera's images."""

    topic: str  # topic of images, compressed or not
    info: str = ""  # topic of CameraInfo; exclusive with `intrinsics`
    intrinsics: Intrinsics | None = None
    frame: str = ""  # frame of the images (z forward, x right, y down); "" for the frame in their headers
    body_from_camera: Mounting | None = None  # mounting in place of the log's transforms
    rectified: bool = False  # images are rectified; CameraInfo's P holds instead of K and d
    delay: Finite = 0.0  # how much later than its exposure an image is stamped [s]
    # Bit depth of the sensor for images stored in 16 bits; 0 for images of 8 bits.
    bits: Annotated[int, Meta(ge=0, le=16)] = 0
    optional: bool = False  # read a log without this topic, without this camera
    mask: str = ""  # image of the recorded size, not black where the vehicle sees itself; path relative to the rig file
    own_body: tuple[Polygon, ...] = ()  # further polygons in the recorded image in which the vehicle sees itself

    @property
    def mounting(self) -> Mounting | None:
        """Mounting that the rig gives."""
        return self.body_from_camera


class LidarSource(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Source of a LiDAR's point clouds."""

    topic: str  # topic of point clouds
    frame: str = ""  # frame of the points; "" for the frame in their headers
    body_from_lidar: Mounting | None = None  # mounting in place of the log's transforms
    delay: Finite = 0.0  # how much later than measured a cloud is stamped [s]
    time_field: str = ""  # field of the points' own times; "" if they have none or are motion-compensated already
    time_unit: Literal["s", "ms", "us", "ns"] = "s"  # unit of that field
    time_origin: Literal["stamp", "epoch"] = "stamp"  # zero of that field: the cloud's stamp, or 1970
    min_range: Annotated[float, Meta(ge=0.0)] = 0.0  # min_range, max_range: points nearer or further are dropped [m]
    max_range: float = 1000.0
    own_body: Box | None = None  # box in the body frame; points in it belong to the vehicle itself and are dropped
    optional: bool = False  # read a log without this topic, without this LiDAR

    @property
    def mounting(self) -> Mounting | None:
        """Mounting that the rig gives."""
        return self.body_from_lidar


def check_sensors(cameras: dict[str, CameraSource], lidars: dict[str, LidarSource]) -> None:
    """Refuse contradicting or impossible entries that types do not exclude."""
    if both := set(cameras) & set(lidars):
        raise RigError(f"'{min(both)}' is both a camera and a LiDAR", how="rename one of the two")
    for name, camera in cameras.items():
        _check_camera(f"cameras.{name}", camera)
    for name, lidar in lidars.items():
        _check_lidar(f"lidars.{name}", lidar)


def _check_camera(key: str, camera: CameraSource) -> None:
    count = "two calibrations" if camera.info else "no calibration"
    several = bool(camera.info) == (camera.intrinsics is not None)
    refuse(
        (several, f"{key} has {count}", "give info (a CameraInfo topic) or intrinsics, one of the two"),
        (0 < camera.bits < 8, f"{key}.bits is {camera.bits}", "give 8 to 16, or leave it out for images of 8 bits"),
    )
    _check_mounting(f"{key}.body_from_camera", camera.mounting)


def _check_lidar(key: str, lidar: LidarSource) -> None:
    near, far = lidar.min_range, lidar.max_range
    inside_out = lidar.own_body is not None and not np.all(np.less(*lidar.own_body))
    refuse(
        (not near < far, f"{key}: min_range {near} is not below max_range {far}", "fix one"),
        (inside_out, f"{key}.own_body is not a box", "give the lowest and the highest x, y, z [m]"),
    )
    _check_mounting(f"{key}.body_from_lidar", lidar.mounting)


def _check_mounting(key: str, mounting: Mounting | None) -> None:
    if mounting is None:
        return
    turn, count = mounting.orientation, "both" if mounting.looks else "neither orientation nor looks"
    how = 'give orientation = [x, y, z, w], or a rough guess: looks = "forward"'
    refuse(((turn is None) == (not mounting.looks), f"{key} has {count}", how))
    if turn is not None:
        unit = abs(np.linalg.norm(turn) - 1) < 0.01
        refuse(
            (mounting.position is None, f"{key} has no position", "give x, y, z [m]"),
            (not unit, f"{key}.orientation is not a unit quaternion", "give x, y, z, w of length 1"),
        )
