"""Poses, and how a vehicle moves during one sweep of a sensor.

What a simulated vehicle can say of itself at one moment: what its sensors measure, and the truth.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation, Slerp


@dataclass(frozen=True)
class Pose:
    """Where a frame stands in another, e.g. `world_from_body`.

    Attributes:
        position: of the frame's origin [m].
        orientation: quaternion xyzw.
    """

    position: Float[np.ndarray, " 3"]
    orientation: Float[np.ndarray, " 4"]

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """Turns vectors of the frame into vectors of the other."""
        return Rotation.from_quat(self.orientation).as_matrix()

    def apply(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Points of the frame, seen from the other."""
        return points @ self.rotation.T + self.position

    def inverse(self) -> "Pose":
        """The other frame, seen from this one."""
        turned = Rotation.from_quat(self.orientation).inv()
        return Pose(-turned.apply(self.position), turned.as_quat())

    def __matmul__(self, inner: "Pose") -> "Pose":
        """`world_from_body @ body_from_sensor` is `world_from_sensor`."""
        orientation = Rotation.from_quat(self.orientation) * Rotation.from_quat(inner.orientation)
        return Pose(self.apply(inner.position[None])[0], orientation.as_quat())


@dataclass(frozen=True)
class Motion:
    """Poses `world_from_body` at a few moments, straight lines and even turns between them.

    Attributes:
        time: rising [s].
        position: [m].
        orientation: xyzw.
    """

    time: Float[np.ndarray, " n"]
    position: Float[np.ndarray, "n 3"]
    orientation: Float[np.ndarray, "n 4"]

    def at(self, time: Float[np.ndarray, " m"]) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3 3"]]:
        """Positions [m] and rotations `world_from_body`; before the first and after the last moment, those."""
        time = np.clip(time, self.time[0], self.time[-1])
        position = np.stack([np.interp(time, self.time, axis) for axis in self.position.T], axis=1)
        if len(self.time) == 1:
            rotation = np.repeat(Rotation.from_quat(self.orientation).as_matrix(), len(time), axis=0)
        else:
            rotation = Slerp(self.time, Rotation.from_quat(self.orientation))(time).as_matrix()
        return position, rotation


def standing(pose: Pose) -> Motion:
    """A vehicle that does not move."""
    return Motion(np.zeros(1), pose.position[None], pose.orientation[None])


@dataclass(frozen=True)
class WheelTruth:
    """What no real log has; front-left, front-right, rear-left, rear-right.

    Attributes:
        contact: where the wheels touch the ground, in the world frame [m].
        properties: of the ground there (`logs.ground_truth.GROUND_PROPERTIES`).
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
    """One moment of a drive.

    Attributes:
        time: since the start of the drive [s].
        position: of the pose point, in the world frame [m].
        orientation: world_from_body, xyzw.
        velocity: of the pose point, in the world frame [m/s].
        angular_velocity: in the body frame [rad/s].
        command: throttle [0..1], brake [0..1], steer [-1..1], held since this moment.
        brake_pressure: [0..1 of full pressure].
        steer_angle: road wheels, + left [rad].
        steer_rate: [rad/s].
        engine_speed: [rev/min].
        wheel_speed: rolling speed of each wheel (its rotation times its radius) [m/s].
        suspension: compression of each from full droop [m].
        events: what happened since the last sample: "rollover", "collision with a tree", "left the world".
    """

    time: float
    position: Float[np.ndarray, " 3"]
    orientation: Float[np.ndarray, " 4"]
    velocity: Float[np.ndarray, " 3"]
    angular_velocity: Float[np.ndarray, " 3"]
    command: Float[np.ndarray, " 3"]
    brake_pressure: float
    steer_angle: float
    steer_rate: float
    engine_speed: float
    wheel_speed: Float[np.ndarray, " 4"]
    suspension: Float[np.ndarray, " 4"]
    truth: WheelTruth
    events: tuple[str, ...] = ()
