"""Record a simulated drive as an MCAP log of ROS 2 messages, with the imperfections of real logs.

Ground truth goes to separate topics under /truth (`logs.ground_truth`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from offpiste.core.conventions import GRAVITY
from offpiste.logs.ground_truth import MAP_TOPIC, WHEELS_TOPIC
from offpiste.logs.ros.writer import McapWriter
from offpiste.simulation.messages import (
    START_NS,
    events_message,
    imu_message,
    in_body,
    mountings_message,
    stamp_ns,
    true_map_message,
    true_wheels_message,
    vehicle_messages,
)
from offpiste.simulation.sample import Pose, VehicleSample
from offpiste.simulation.world.world import World

POSITION, VELOCITY, RATE, ACCELERATION, WHEEL_SPEED = 0.005, 0.02, 0.005, 0.1, 0.02
"""Standard deviations of the white noise of samples, along each axis or wheel [m, m/s, rad/s, m/s^2, m/s]."""
ATTITUDE, STEER_ANGLE, STEER_RATE = np.radians((0.05, 0.1, 0.5))
"""The same about each axis, and at the road wheels [rad, rad, rad/s]."""
PRESSURE, ENGINE_SPEED = 0.003, 10.0
"""The same relative to full brake pressure, and of the engine [rev/min]."""


@dataclass(frozen=True)
class Imperfections:
    """Additional errors of a log; none by default."""

    pose_noise_m: float = 0.0  # additional white noise of recorded positions [m]
    # Standard deviation after one minute of the random walk of recorded x and y [m] and heading [deg]
    pose_drift: float = 0.0
    extrinsic_error_deg: float = 0.0  # angle between the recorded and the true mounting of each sensor [deg]
    stamp_offset_ms: float = 0.0  # delay of the stamps of cameras and LiDARs [ms]


class Drift:
    """Odometry drift: true steps rotated by the heading error, plus a random walk."""

    def __init__(self, amount: float, rng: np.random.Generator) -> None:
        self._amount, self._rng = amount, rng
        self._last: VehicleSample | None = None
        self._place, self._yaw = np.zeros(2), 0.0

    def apply(self, sample: VehicleSample) -> VehicleSample:
        """Sample with drifted position and orientation, and its velocity rotated by the heading error."""
        if self._amount == 0:
            return sample
        if self._last is None:
            self._place = sample.position[:2].copy()
        else:
            walk = self._amount * np.sqrt((sample.time - self._last.time) / 60) * self._rng.standard_normal(3)
            self._yaw += np.radians(walk[2])
            cos, sin = np.cos(self._yaw), np.sin(self._yaw)
            x, y = sample.position[:2] - self._last.position[:2]
            self._place = self._place + np.array((cos * x - sin * y, sin * x + cos * y)) + walk[:2]
        self._last = sample
        turn = Rotation.from_euler("z", self._yaw)
        return replace(
            sample,
            position=np.append(self._place, sample.position[2]),
            orientation=(turn * Rotation.from_quat(sample.orientation)).as_quat(),
            velocity=turn.apply(sample.velocity),
        )


def with_noise(sample: VehicleSample, imperfections: Imperfections, rng: np.random.Generator) -> VehicleSample:
    """Sample with sensor noise; commands and ground truth are unchanged."""
    drawn = rng.standard_normal(20)
    pressure, angle, turning, engine = drawn[16:].tolist()
    # Rotate the quaternion by small angles about the body axes, to first order; 50 times faster than SciPy.
    x, y, z, w = sample.orientation.tolist()
    a, b, c = (0.5 * (ATTITUDE * drawn[3:6])).tolist()
    tilted = np.array(
        (x + w * a + y * c - z * b, y + w * b + z * a - x * c, z + w * c + x * b - y * a, w - x * a - y * b - z * c)
    )
    return replace(
        sample,
        position=sample.position + np.hypot(POSITION, imperfections.pose_noise_m) * drawn[:3],
        orientation=tilted / np.sqrt(tilted @ tilted),
        velocity=sample.velocity + VELOCITY * drawn[6:9],
        angular_velocity=sample.angular_velocity + RATE * drawn[9:12],
        brake_pressure=float(max(sample.brake_pressure + PRESSURE * pressure, 0.0)),
        steer_angle=float(sample.steer_angle + STEER_ANGLE * angle),
        steer_rate=float(sample.steer_rate + STEER_RATE * turning),
        engine_speed=float(sample.engine_speed + ENGINE_SPEED * engine),
        wheel_speed=sample.wheel_speed + WHEEL_SPEED * drawn[12:16],
    )


def random_turn(degrees: float, rng: np.random.Generator) -> Rotation:
    """Return a rotation by an angle [deg] about a random axis."""
    axis = rng.standard_normal(3)
    return Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis))


class Recorder:
    """Writes samples and sensor messages to an open log, with the imperfections of real logs.

    Args:
        wheel_radius: rolling radius, to convert wheel speeds to rotation [m].
        rng: random numbers of noise, drift and calibration errors.
    """

    def __init__(
        self, writer: McapWriter, wheel_radius: float, rng: np.random.Generator, flaws: Imperfections | None = None
    ) -> None:
        self._writer, self._wheel_radius, self._imperfections = writer, wheel_radius, flaws or Imperfections()
        self._noise_rng, drift_rng, self._mounting_rng = rng.spawn(3)
        self._drift = Drift(self._imperfections.pose_drift, drift_rng)
        self._before: VehicleSample | None = None

    def start(self, world: World, mountings: Mapping[str, Pose]) -> None:
        """Write the constant messages: recorded mountings of the sensors, and the true map."""
        if error := self._imperfections.extrinsic_error_deg:
            turned = {
                frame: Rotation.from_quat(pose.orientation) * random_turn(error, self._mounting_rng)
                for frame, pose in mountings.items()
            }
            mountings = {frame: Pose(mountings[frame].position, turn.as_quat()) for frame, turn in turned.items()}
        self._writer.write("/tf_static", mountings_message(mountings, START_NS), START_NS)
        self._writer.write(MAP_TOPIC, true_map_message(world, START_NS), START_NS)

    def vehicle(self, sample: VehicleSample) -> None:
        """Write the messages of a sample, stamped with its time."""
        stamp = stamp_ns(sample.time)
        measured = with_noise(self._drift.apply(sample), self._imperfections, self._noise_rng)
        messages = vehicle_messages(measured, stamp, wheel_radius=self._wheel_radius)
        if before := self._before:
            # The specific force is the mean acceleration since the last sample plus gravity.
            force = (sample.velocity - before.velocity) / (sample.time - before.time) + np.array((0, 0, GRAVITY))
            force = in_body(sample, force) + ACCELERATION * self._noise_rng.standard_normal(3)
            messages["/imu"] = imu_message(force, measured.angular_velocity, stamp)
        if sample.events:
            messages["/events"] = events_message(sample.events, stamp)
        messages[WHEELS_TOPIC] = true_wheels_message(sample.truth, stamp)
        for topic, message in messages.items():
            self._writer.write(topic, message, stamp)
        self._before = sample

    def sensor(self, topic: str, message: Any) -> None:
        """Write a message of a camera or LiDAR, stamped by `sensor_stamp_ns`."""
        stamp = message.header.stamp
        self._writer.write(topic, message, stamp.sec * 10**9 + stamp.nanosec)

    def sensor_stamp_ns(self, time: float) -> int:
        """Return the stamp [ns] of a camera or LiDAR measurement at a time since the start of the drive [s]."""
        return stamp_ns(time + self._imperfections.stamp_offset_ms / 1000)
