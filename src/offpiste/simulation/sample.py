"""State of a simulated vehicle: pose, motion during a sensor's sweep, and a sample of all measurements."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from offpiste.logs.poses import interpolated


@dataclass(frozen=True)
class Pose:
    """Pose of a frame in another, e.g. `world_from_body`: position [m] and quaternion xyzw."""

    position: Float[np.ndarray, " 3"]
    orientation: Float[np.ndarray, " 4"]

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """Rotation matrix from the frame to the other frame."""
        return Rotation.from_quat(self.orientation).as_matrix()

    @property
    def matrix(self) -> Float[np.ndarray, "4 4"]:
        """Homogeneous matrix from the frame to the other frame."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.position
        return matrix

    def apply(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Transform points of the frame into the other frame [m]."""
        return points @ self.rotation.T + self.position


@dataclass(frozen=True)
class Motion:
    """Poses `world_from_body` at increasing times [s], interpolated linearly; positions [m], quaternions xyzw."""

    time: Float[np.ndarray, " n"]
    position: Float[np.ndarray, "n 3"]
    orientation: Float[np.ndarray, "n 4"]

    @classmethod
    def of(cls, samples: "list[VehicleSample]") -> "Motion":
        """Return the motion through some samples."""
        columns = ([s.time for s in samples], [s.position for s in samples], [s.orientation for s in samples])
        return cls(*map(np.array, columns))

    def at(self, time: Float[np.ndarray, " m"]) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3 3"]]:
        """Return positions [m] and rotations `world_from_body` at given times, clamped to the first and last one."""
        samples = self.time, self.position, self.time, self.orientation
        matrix = interpolated(np.clip(time, self.time[0], self.time[-1]), *samples, np.inf)
        return np.ascontiguousarray(matrix[:, :3, 3]), np.ascontiguousarray(matrix[:, :3, :3])


@dataclass(frozen=True)
class WheelTruth:
    """Ground truth at the wheels: front-left, front-right, rear-left, rear-right."""

    contact: Float[np.ndarray, "4 3"]  # contact points with the ground in the world frame [m]
    properties: Float[np.ndarray, "4 4"]  # `logs.ground_truth.GROUND_PROPERTIES` at the contacts
    kind: Int[np.ndarray, " 4"]  # main kind of ground at the contacts (index into `logs.ground_truth.GROUND_KINDS`)
    load: Float[np.ndarray, " 4"]  # normal load [N]
    slip_ratio: Float[np.ndarray, " 4"]  # (wheel speed - ground speed) / ground speed, limited to [-1, 1]
    slip_angle: Float[np.ndarray, " 4"]  # [rad]


@dataclass(frozen=True)
class VehicleSample:
    """The vehicle at a time of a drive."""

    time: float  # time since the start of the drive [s]
    position: Float[np.ndarray, " 3"]  # pose point in the world frame [m]
    orientation: Float[np.ndarray, " 4"]  # world_from_body, xyzw
    velocity: Float[np.ndarray, " 3"]  # velocity of the pose point in the world frame [m/s]
    angular_velocity: Float[np.ndarray, " 3"]  # in the body frame [rad/s]
    # Throttle [0..1], brake [0..1], steer [-1..1] and optionally gear, applied from this time on
    command: Float[np.ndarray, " U"]
    brake_pressure: float  # [0..1 of full pressure]
    steer_angle: float  # angle of the road wheels, positive left [rad]
    steer_rate: float  # [rad/s]
    engine_speed: float  # [rev/min]
    wheel_speed: Float[np.ndarray, " 4"]  # rolling speed (rotation times radius) of each wheel [m/s]
    truth: WheelTruth
    events: tuple[str, ...] = ()  # events since the last sample: "rollover", "collision with a tree", "left the world"
    gear: float = 1.0  # engaged gear: 1 forward, 0 neutral, -1 reverse

    @property
    def pose(self) -> Pose:
        """Pose `world_from_body`."""
        return Pose(self.position, self.orientation)

    @property
    def yaw(self) -> float:
        """Heading in the world frame [rad]."""
        x, y, z, w = self.orientation.tolist()
        return math.atan2(2 * (x * y + z * w), 1 - 2 * (y * y + z * z))

    @property
    def forward_speed(self) -> float:
        """Horizontal forward speed, negative in reverse [m/s]."""
        vx, vy, _ = self.velocity.tolist()
        return vx * math.cos(self.yaw) + vy * math.sin(self.yaw)
