"""ROS 2 messages of a simulated drive: the vehicle, its sensors, and the ground truth under /truth."""

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from offpiste.core.geometry import rotation_of_one
from offpiste.logs.ground_truth import GROUND_KINDS, GROUND_PROPERTIES, WHEEL
from offpiste.logs.ros.grid_map import grid_map_from_layers
from offpiste.logs.ros.sensor_messages import message_from_points
from offpiste.logs.ros.writer import floats, header, make, quaternion, vector
from offpiste.rig.camera import CameraModel
from offpiste.simulation.sample import Pose, VehicleSample, WheelTruth
from offpiste.simulation.world.world import World

START_NS = 1_700_000_000 * 10**9
"""Stamp of the start of a drive [ns]; constant, so that equal drives give equal files."""
FULL_PRESSURE = 10e6
"""Pressure of the fully applied brake [Pa]; the order of a hydraulic disc brake at lock-up."""
MAP_RESOLUTION = 0.5
"""Node spacing of the true map in a log [m]; patches of ground are larger."""
BODY, MAP = "base_link", "map"
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
JPEG_QUALITY = 90
LIDAR_POINT = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("t", "<u4")], align=True
)
"""LiDAR point similar to that of Ouster's driver; `t` is the time since the message's stamp [ns]."""


def stamp_ns(time: float) -> int:
    """Return the stamp [ns] of a time since the start of the drive [s]."""
    return START_NS + round(time * 1e9)


def in_body(sample: VehicleSample, vector_world: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """Return the world-frame vector in the body frame."""
    return vector_world @ rotation_of_one(sample.orientation)


def vehicle_messages(sample: VehicleSample, stamp: int, *, wheel_radius: float) -> dict[str, Any]:
    """Return the messages of the vehicle by topic, as read by the rigs `proving_ground` and `proving_ground_gear`."""
    body = header(stamp, BODY)
    throttle_brake_steer = np.asarray(sample.command[:3], np.float32)
    return {
        "/odometry": odometry_message(sample, stamp),
        "/command": make("sensor_msgs/Joy", header=body, axes=throttle_brake_steer, buttons=np.zeros(0, np.int32)),
        "/gear": make("std_msgs/Int8", data=round(sample.gear)),
        "/steering": _joints(body, ["steering"], [sample.steer_angle], [sample.steer_rate]),
        "/brake": make(
            "sensor_msgs/FluidPressure", header=body, fluid_pressure=sample.brake_pressure * FULL_PRESSURE, variance=0.0
        ),
        "/engine": _joints(body, ["crankshaft"], [], [sample.engine_speed * 2 * np.pi / 60]),
        "/wheels": _joints(body, list(WHEELS), [], sample.wheel_speed / wheel_radius),
    }


def odometry_message(sample: VehicleSample, stamp: int) -> Any:
    """Return a nav_msgs/Odometry message: pose in the frame map, twist in the body frame."""
    position, orientation = vector(sample.position, "geometry_msgs/Point"), quaternion(sample.orientation)
    pose = make("geometry_msgs/Pose", position=position, orientation=orientation)
    velocity, rates = vector(in_body(sample, sample.velocity)), vector(sample.angular_velocity)
    twist = make("geometry_msgs/Twist", linear=velocity, angular=rates)
    unknown = np.zeros(36)
    return make(
        "nav_msgs/Odometry",
        header=header(stamp, MAP),
        child_frame_id=BODY,
        pose=make("geometry_msgs/PoseWithCovariance", pose=pose, covariance=unknown),
        twist=make("geometry_msgs/TwistWithCovariance", twist=twist, covariance=unknown),
    )


def imu_message(force: Float[np.ndarray, " 3"], rate: Float[np.ndarray, " 3"], stamp: int) -> Any:
    """Return a sensor_msgs/Imu message without orientation, marked by a covariance of -1."""
    return make(
        "sensor_msgs/Imu",
        header=header(stamp, BODY),
        orientation=quaternion((0, 0, 0, 1)),
        orientation_covariance=np.array([-1.0] + 8 * [0.0]),
        angular_velocity=vector(rate),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(force),
        linear_acceleration_covariance=np.zeros(9),
    )


def events_message(events: Sequence[str], stamp: int) -> Any:
    """Return a diagnostic_msgs/DiagnosticArray message with an error for each event."""
    error = {"level": 2, "hardware_id": "", "values": []}
    status = [make("diagnostic_msgs/DiagnosticStatus", name=event, message=event, **error) for event in events]
    return make("diagnostic_msgs/DiagnosticArray", header=header(stamp, BODY), status=status)


def true_wheels_message(truth: WheelTruth, stamp: int) -> Any:
    """Return a sensor_msgs/PointCloud2 message of the four contact points (`logs.ground_truth.WHEEL`)."""
    points = np.zeros(4, WHEEL)
    points["x"], points["y"], points["z"] = truth.contact.T
    for name, column in zip(GROUND_PROPERTIES, truth.properties.T, strict=True):
        points[name] = column
    for name in ("load", "slip_ratio", "slip_angle", "kind"):
        points[name] = getattr(truth, name)
    return message_from_points(points, stamp, MAP)


def true_map_message(world: World, stamp: int) -> Any:
    """Return a grid_map_msgs/GridMap message of the world: elevation, ground properties, kinds and wetness."""
    layers = {"elevation": world.elevation, "wetness": world.wetness}
    layers |= {name: world.properties[:, :, i] for i, name in enumerate(GROUND_PROPERTIES)}
    layers |= dict(zip(GROUND_KINDS, world.kinds, strict=True))
    every = max(1, round(MAP_RESOLUTION / world.resolution))
    coarse = {name: layer[::every, ::every] for name, layer in layers.items()}
    return grid_map_from_layers(coarse, world.origin, every * world.resolution, stamp_ns=stamp, frame=MAP)


def _joints(head: Any, names: list[str], position: Any, velocity: Any) -> Any:
    values = {"position": floats(position), "velocity": floats(velocity), "effort": np.zeros(0)}
    return make("sensor_msgs/JointState", header=head, name=names, **values)


def mountings_message(mountings: Mapping[str, Pose], stamp_ns: int) -> Any:
    """Return a tf2_msgs/TFMessage of `body_from_sensor` by frame (of cameras, the optical frame of REP 103)."""
    transforms = []
    for frame, pose in mountings.items():
        rotation, translation = quaternion(pose.orientation), vector(pose.position)
        transform = make("geometry_msgs/Transform", translation=translation, rotation=rotation)
        about = {"header": header(stamp_ns, BODY), "child_frame_id": frame, "transform": transform}
        transforms.append(make("geometry_msgs/TransformStamped", **about))
    return make("tf2_msgs/TFMessage", transforms=transforms)


def image_message(image: UInt8[np.ndarray, "h w 3"], stamp_ns: int, frame: str) -> Any:
    """Return a sensor_msgs/CompressedImage message: JPEG of an RGB image."""
    done, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))
    assert done, "OpenCV encodes every RGB image"
    return make("sensor_msgs/CompressedImage", header=header(stamp_ns, frame), format="jpeg", data=data.reshape(-1))


def camera_info_message(model: CameraModel, stamp_ns: int, frame: str) -> Any:
    """Return a sensor_msgs/CameraInfo message of a monocular camera; the rectified image keeps K (P = [K 0])."""
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
    """Return a sensor_msgs/PointCloud2 message of one revolution of a LiDAR (`LIDAR_POINT`); arguments as in `Scan`."""
    points = np.zeros(len(xyz), LIDAR_POINT)
    points["x"], points["y"], points["z"] = xyz.T
    points["intensity"], points["ring"], points["t"] = intensity, ring, np.round(time * 1e9)
    return message_from_points(points, stamp_ns, frame)
