"""Poses, and how a vehicle moves during one sweep of a sensor."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
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
