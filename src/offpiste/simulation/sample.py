"""State of a simulated vehicle: its pose, its motion during a sweep of a sensor, and all measurements at one moment."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from offpiste.logs.poses import put_poses


@dataclass(frozen=True)
class Pose:
    """Pose of a frame in another, e.g. `world_from_body`.

    Attributes:
        position: origin of the frame [m].
        orientation: quaternion xyzw.
    """

    position: Float[np.ndarray, " 3"]
    orientation: Float[np.ndarray, " 4"]

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """Rotation matrix from the frame to the other."""
        return Rotation.from_quat(self.orientation).as_matrix()

    def apply(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Points of the frame, in the other [m]."""
        return points @ self.rotation.T + self.position

    def inverse(self) -> "Pose":
        """Pose of the other frame in this one."""
        rotation = Rotation.from_quat(self.orientation).inv()
        return Pose(-rotation.apply(self.position), rotation.as_quat())

    def __matmul__(self, inner: "Pose") -> "Pose":
        """`world_from_body @ body_from_sensor` is `world_from_sensor`."""
        orientation = Rotation.from_quat(self.orientation) * Rotation.from_quat(inner.orientation)
        return Pose(self.apply(inner.position[None])[0], orientation.as_quat())


@dataclass(frozen=True)
class Motion:
    """Poses `world_from_body` at a few moments, interpolated linearly between them.

    Attributes:
        time: rising [s].
        position: [m].
        orientation: xyzw.
    """

    time: Float[np.ndarray, " n"]
    position: Float[np.ndarray, "n 3"]
    orientation: Float[np.ndarray, "n 4"]

    def at(self, time: Float[np.ndarray, " m"]) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3 3"]]:
        """Positions [m] and rotations `world_from_body` at given times; clamped to the first and last moment."""
        if len(self.time) == 1:
            rotation = Rotation.from_quat(self.orientation).as_matrix()
            return np.repeat(self.position, len(time), axis=0), np.repeat(rotation, len(time), axis=0)
        matrix, samples = np.empty((len(time), 4, 4)), (self.time, self.position, self.time, self.orientation)
        put_poses(np.clip(time, self.time[0], self.time[-1]), *samples, np.zeros((0, 2)), np.inf, matrix)
        return np.ascontiguousarray(matrix[:, :3, 3]), np.ascontiguousarray(matrix[:, :3, :3])


def motionless(pose: Pose) -> Motion:
    """Motion of a vehicle at a standstill."""
    return Motion(np.zeros(1), pose.position[None], pose.orientation[None])


@dataclass(frozen=True)
class WheelTruth:
    """Ground truth at the wheels, which no real log has; front-left, front-right, rear-left, rear-right.

    Attributes:
        contact: contact points with the ground, in the world frame [m].
        properties: properties of the ground there (`logs.ground_truth.GROUND_PROPERTIES`).
        kind: the ground's main kind there (index into `logs.ground_truth.GROUND_KINDS`).
        load: normal load [N].
        slip_ratio: (wheel speed - ground speed) / ground speed, limited to [-1, 1].
        slip_angle: [rad].
    """

    contact: Float[np.ndarray, "4 3"]
    properties: Float[np.ndarray, "4 4"]
    kind: Int[np.ndarray, " 4"]
    load: Float[np.ndarray, " 4"]
    slip_ratio: Float[np.ndarray, " 4"]
    slip_angle: Float[np.ndarray, " 4"]


@dataclass(frozen=True)
class VehicleSample:
    """The vehicle at one moment of a drive.

    Attributes:
        time: since the start of the drive [s].
        position: pose point in the world frame [m].
        orientation: world_from_body, xyzw.
        velocity: velocity of the pose point in the world frame [m/s].
        angular_velocity: in the body frame [rad/s].
        command: throttle [0..1], brake [0..1], steer [-1..1], and a gear if one is commanded; held since this moment.
        brake_pressure: [0..1 of full pressure].
        steer_angle: road wheels, + left [rad].
        steer_rate: [rad/s].
        engine_speed: [rev/min].
        wheel_speed: rolling speed of each wheel (its rotation times its radius) [m/s].
        suspension: compression of each spring from full droop [m].
        events: events since the last sample: "rollover", "collision with a tree", "left the world".
        gear: engaged: 1 forward, 0 neutral, -1 reverse.
    """

    time: float
    position: Float[np.ndarray, " 3"]
    orientation: Float[np.ndarray, " 4"]
    velocity: Float[np.ndarray, " 3"]
    angular_velocity: Float[np.ndarray, " 3"]
    command: Float[np.ndarray, " U"]
    brake_pressure: float
    steer_angle: float
    steer_rate: float
    engine_speed: float
    wheel_speed: Float[np.ndarray, " 4"]
    suspension: Float[np.ndarray, " 4"]
    truth: WheelTruth
    events: tuple[str, ...] = ()
    gear: float = 1.0
