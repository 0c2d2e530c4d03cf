"""Images, calibrations, scans and mountings as ROS 2 messages."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from offpiste.logs.ros.sensor_messages import message_from_points
from offpiste.logs.ros.writer import floats, header, make, quaternion, vector
from offpiste.rig.camera import CameraModel

_JPEG_QUALITY = 90

LIDAR_POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("t", "<u4")], align=True
)
"""A LiDAR point, much as Ouster's driver lays it out: `t` is the time since the message's stamp [ns]."""


@dataclass(frozen=True)
class Mounting:
    """Mounting of a sensor.

    Attributes:
        frame: the sensor's frame; cameras: z forward, x right, y down (REP 103, "optical").
        translation: position of the sensor in its parent's frame [m].
        rotation: parent_from_sensor, xyzw.
    """

    frame: str
    translation: tuple[float, float, float]
    rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    parent: str = "base_link"


def mountings_message(mountings: Sequence[Mounting], stamp_ns: int) -> Any:
    """A tf2_msgs/TFMessage of all mountings."""
    transforms = [
        make(
            "geometry_msgs/TransformStamped",
            header=header(stamp_ns, mounting.parent),
            child_frame_id=mounting.frame,
            transform=make(
                "geometry_msgs/Transform",
                translation=vector(mounting.translation),
                rotation=quaternion(mounting.rotation),
            ),
        )
        for mounting in mountings
    ]
    return make("tf2_msgs/TFMessage", transforms=transforms)


def image_message(image: UInt8[np.ndarray, "h w 3"], stamp_ns: int, frame: str) -> Any:
    """A sensor_msgs/CompressedImage message: JPEG of an RGB image."""
    done, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), (cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY))
    assert done, "OpenCV encodes every RGB image"
    return make("sensor_msgs/CompressedImage", header=header(stamp_ns, frame), format="jpeg", data=data.reshape(-1))


def camera_info_message(model: CameraModel, stamp_ns: int, frame: str) -> Any:
    """A sensor_msgs/CameraInfo message of a monocular camera; the rectified image keeps K (P = [K 0])."""
    projection = np.hstack((model.matrix, np.zeros((3, 1))))
    region = make("sensor_msgs/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    return make(
        "sensor_msgs/CameraInfo",
        header=header(stamp_ns, frame),
        width=model.width,
        height=model.height,
        distortion_model=model.distortion_model,
        d=floats(model.distortion),
        k=floats(model.matrix.reshape(-1)),
        r=floats(np.eye(3).reshape(-1)),
        p=floats(projection.reshape(-1)),
        binning_x=0,
        binning_y=0,
        roi=region,
    )


def points_message(
    xyz: Float[np.ndarray, "n 3"],
    intensity: Float[np.ndarray, " n"],
    ring: Int[np.ndarray, " n"],
    time: Float[np.ndarray, " n"],
    stamp_ns: int,
    frame: str,
) -> Any:
    """A sensor_msgs/PointCloud2 message of one revolution of a LiDAR (`LIDAR_POINT`).

    Args:
        xyz: in the sensor's frame [m].
        ring: number of the beam, from the top.
        time: since the stamp, not negative [s].
    """
    points = np.zeros(len(xyz), LIDAR_POINT)
    points["x"], points["y"], points["z"] = xyz.T
    points["intensity"], points["ring"], points["t"] = intensity, ring, np.round(time * 1e9)
    return message_from_points(points, stamp_ns, frame)
