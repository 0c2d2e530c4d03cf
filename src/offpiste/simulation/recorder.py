"""Record a simulated drive as a vehicle's computer would: standard ROS 2 messages in an MCAP file.

Ground truth, which no real log has, goes to topics of its own under /truth (`offpiste.logs.ground_truth`).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from offpiste.core.conventions import GRAVITY
from offpiste.core.geometry import rotation_of_one
from offpiste.logs.ground_truth import GROUND_KINDS, GROUND_PROPERTIES, MAP_TOPIC, WHEEL, WHEELS_TOPIC
from offpiste.logs.ros.grid_map import grid_map_from_layers
from offpiste.logs.ros.sensor_messages import message_from_points
from offpiste.logs.ros.writer import McapWriter, header, make, quaternion, vector
from offpiste.simulation.sample import VehicleSample, WheelTruth
from offpiste.simulation.sensors.imperfections import Drift, Imperfections, Noise, misaligned, with_noise
from offpiste.simulation.sensors.messages import Mounting, mountings_message
from offpiste.simulation.world.world import World

START_NS = 1_700_000_000 * 10**9
"""Stamp of the start of a drive [ns]; constant, so that the same drive gives the same file."""
FULL_PRESSURE = 10e6
"""Pressure of the fully applied brake [Pa]: the order of a hydraulic disc brake's at lock-up."""
MAP_RESOLUTION = 0.5
"""Spacing of the true map's nodes in a log [m]; patches of ground are larger."""
BODY, MAP = "base_link", "map"
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")


class Recorder:
    """Writes a simulation's samples as messages, with the imperfections of real logs.

    Args:
        writer: an open file.
        wheel_radius: rolling radius, from wheel speeds back to rotation [m].
        rng: random numbers of noise, drift and wrong calibrations.
    """

    def __init__(
        self,
        writer: McapWriter,
        *,
        wheel_radius: float,
        rng: np.random.Generator,
        noise: Noise | None = None,
        imperfections: Imperfections | None = None,
    ) -> None:
        self._writer, self._wheel_radius = writer, wheel_radius
        self._noise, self._imperfections = noise or Noise(), imperfections or Imperfections()
        self._noise_rng, self._drift_rng, self._mounting_rng = rng.spawn(3)
        self._drift = Drift(self._imperfections.pose_drift, self._drift_rng)
        self._before: VehicleSample | None = None

    def start(self, world: World, mountings: Sequence[Mounting] = ()) -> None:
        """Write the messages of the whole drive: the recorded mountings of the sensors, and the true map."""
        error = self._imperfections.extrinsic_error_deg
        recorded = [
            Mounting(
                m.frame,
                m.translation,
                tuple(misaligned(np.array(m.rotation), error, self._mounting_rng).tolist()),
                m.parent,
            )
            if error
            else m
            for m in mountings
        ]
        self._writer.write("/tf_static", mountings_message(recorded, START_NS), START_NS)
        self._writer.write(MAP_TOPIC, true_map_message(world, START_NS), START_NS)

    def vehicle(self, sample: VehicleSample) -> None:
        """Write one sample's messages, all stamped with its time."""
        stamp = stamp_ns(sample.time)
        drifted = self._drift.apply(sample)
        measured = with_noise(drifted, self._noise, self._imperfections, self._noise_rng)
        for topic, message in vehicle_messages(measured, stamp, wheel_radius=self._wheel_radius).items():
            self._writer.write(topic, message, stamp)
        if self._before is not None:
            self._writer.write("/imu", self._imu(self._before, sample, measured, stamp), stamp)
        if sample.events:
            self._writer.write("/events", events_message(sample.events, stamp), stamp)
        self._writer.write(WHEELS_TOPIC, true_wheels_message(sample.truth, stamp), stamp)
        self._before = sample

    def sensor(self, topic: str, message: Any) -> None:
        """Write a camera's or LiDAR's message, stamped by `sensor_stamp_ns`."""
        stamp = message.header.stamp
        self._writer.write(topic, message, stamp.sec * 10**9 + stamp.nanosec)

    def sensor_stamp_ns(self, time: float) -> int:
        """Stamp of a camera's or LiDAR's measurement at a time since the start of the drive [s]."""
        return stamp_ns(time + self._imperfections.stamp_offset_ms / 1000)

    def _imu(self, before: VehicleSample, sample: VehicleSample, measured: VehicleSample, stamp: int) -> Any:
        """Specific force: mean acceleration since the last sample, plus gravity, in the body frame."""
        acceleration = (sample.velocity - before.velocity) / (sample.time - before.time) + np.array((0, 0, GRAVITY))
        force = in_body(sample, acceleration)
        force += self._noise.acceleration * self._noise_rng.standard_normal(3)
        return imu_message(force, measured.angular_velocity, stamp)


def stamp_ns(time: float) -> int:
    """Stamp [ns] of a time since the start of the drive [s]."""
    return START_NS + round(time * 1e9)


def in_body(sample: VehicleSample, vector_world: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """A world-frame vector in the body frame."""
    return vector_world @ rotation_of_one(sample.orientation)


def vehicle_messages(sample: VehicleSample, stamp: int, *, wheel_radius: float) -> dict[str, Any]:
    """The vehicle's messages by topic, as rigs `proving_ground` and `proving_ground_gear` read them."""
    body = header(stamp, BODY)
    throttle_brake_steer = np.asarray(sample.command[:3], np.float32)
    return {
        "/odometry": odometry_message(sample, stamp),
        "/command": make("sensor_msgs/Joy", header=body, axes=throttle_brake_steer, buttons=np.zeros(0, np.int32)),
        "/gear": make("std_msgs/Int8", data=round(sample.gear)),
        "/steering": _joints(body, ["steering"], [sample.steer_angle], [sample.steer_rate]),
        "/brake": make(
            "sensor_msgs/FluidPressure",
            header=body,
            fluid_pressure=sample.brake_pressure * FULL_PRESSURE,
            variance=0.0,
        ),
        "/engine": _joints(body, ["crankshaft"], [], [sample.engine_speed * 2 * np.pi / 60]),
        "/wheels": _joints(body, list(WHEELS), [], sample.wheel_speed / wheel_radius),
    }


def odometry_message(sample: VehicleSample, stamp: int) -> Any:
    """A nav_msgs/Odometry message: the pose in frame map, the twist in the body's frame (nav_msgs/Odometry.msg)."""
    velocity = in_body(sample, sample.velocity)
    pose = make(
        "geometry_msgs/Pose",
        position=vector(sample.position, "geometry_msgs/Point"),
        orientation=quaternion(sample.orientation),
    )
    twist = make("geometry_msgs/Twist", linear=vector(velocity), angular=vector(sample.angular_velocity))
    unknown = np.zeros(36)
    return make(
        "nav_msgs/Odometry",
        header=header(stamp, MAP),
        child_frame_id=BODY,
        pose=make("geometry_msgs/PoseWithCovariance", pose=pose, covariance=unknown),
        twist=make("geometry_msgs/TwistWithCovariance", twist=twist, covariance=unknown),
    )


def imu_message(force: Float[np.ndarray, " 3"], rate: Float[np.ndarray, " 3"], stamp: int) -> Any:
    """A sensor_msgs/Imu message without orientation (marked by a covariance of -1)."""
    no_orientation = np.array([-1.0] + 8 * [0.0])
    return make(
        "sensor_msgs/Imu",
        header=header(stamp, BODY),
        orientation=quaternion((0, 0, 0, 1)),
        orientation_covariance=no_orientation,
        angular_velocity=vector(rate),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(force),
        linear_acceleration_covariance=np.zeros(9),
    )


def events_message(events: Sequence[str], stamp: int) -> Any:
    """A diagnostic_msgs/DiagnosticArray message with an error for each event."""
    error = 2
    status = [
        make("diagnostic_msgs/DiagnosticStatus", level=error, name=event, message=event, hardware_id="", values=[])
        for event in events
    ]
    return make("diagnostic_msgs/DiagnosticArray", header=header(stamp, BODY), status=status)


def true_wheels_message(truth: WheelTruth, stamp: int) -> Any:
    """A sensor_msgs/PointCloud2 message of the four contact points (`offpiste.logs.ground_truth.WHEEL`)."""
    points = np.zeros(4, WHEEL)
    points["x"], points["y"], points["z"] = truth.contact.T
    for name, column in zip(GROUND_PROPERTIES, truth.properties.T, strict=True):
        points[name] = column
    for name in ("load", "slip_ratio", "slip_angle", "kind"):
        points[name] = getattr(truth, name)
    return message_from_points(points, stamp, MAP)


def true_map_message(world: World, stamp: int) -> Any:
    """A grid_map_msgs/GridMap message of the whole world: elevation, ground properties, kinds and wetness."""
    layers = {"elevation": world.elevation, "wetness": world.wetness}
    layers |= {name: world.properties[:, :, i] for i, name in enumerate(GROUND_PROPERTIES)}
    layers |= dict(zip(GROUND_KINDS, world.kinds, strict=True))
    every = max(1, round(MAP_RESOLUTION / world.resolution))
    coarse = {name: layer[::every, ::every] for name, layer in layers.items()}
    return grid_map_from_layers(coarse, world.origin, every * world.resolution, stamp_ns=stamp, frame=MAP)


def _joints(head: Any, names: list[str], position: Any, velocity: Any) -> Any:
    return make(
        "sensor_msgs/JointState",
        header=head,
        name=names,
        position=np.asarray(position, np.float64),
        velocity=np.asarray(velocity, np.float64),
        effort=np.zeros(0),
    )
