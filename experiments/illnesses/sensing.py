"""What a logger's sensors make of a true drive: rates, stamps, noise, resolution and latency of real ones."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from experiments.illnesses.true_drive import TrueDrive
from offpiste.core.geometry import rotation_from_quaternion, yaw_from_quaternion, yaw_rate_from_body_rates

START: Final = 1_750_000_000.0
"""Stamp of the start of a drive [s]."""


@dataclass(frozen=True)
class PoseSource:
    """Errors of a source of poses.

    Attributes:
        rates: that it comes at [Hz].
        white: noise of each position [m].
        wander: slow error of the position [m] with a correlation time of 20 s.
        heading: noise of each heading [rad], half of it slow.
        sizes: smallest and largest wheelbase of the vehicles that carry it [m].
    """

    rates: tuple[float, ...]
    white: float
    wander: float
    heading: float
    sizes: tuple[float, float]


POSE_SOURCES: Final = {
    "GNSS/INS": PoseSource((20.0, 50.0, 100.0, 200.0), 0.002, 0.03, 0.002, (0.8, 10.0)),
    "RTK at a low rate": PoseSource((10.0,), 0.01, 0.01, 0.004, (0.8, 10.0)),
    "LiDAR SLAM": PoseSource((10.0, 20.0), 0.01, 0.05, 0.003, (0.3, 10.0)),
    "visual-inertial odometry": PoseSource((30.0, 100.0, 200.0), 0.002, 0.1, 0.002, (0.15, 10.0)),
    "motion capture": PoseSource((100.0, 120.0, 240.0, 1000.0), 0.0003, 0.0005, 0.001, (0.0, 0.6)),
}
"""Sources of poses by name; typical errors from data sheets and papers of such systems."""


class Sensing:
    """Samples a true drive at any moments.

    Args:
        pose_point: of the vehicle, forward and up from the middle of the wheelbase [m].
        random: random numbers of noise and stamps.
    """

    def __init__(self, drive: TrueDrive, pose_point: tuple[float, float], random: np.random.Generator) -> None:
        self.drive, self.random = drive, random
        self._forward, self._up = pose_point
        arm = np.array((self._forward, 0.0, self._up))
        rotation = rotation_from_quaternion(drive.orientation)
        self._position = _spline(drive.time, drive.position + rotation @ arm)
        spin = np.cross(drive.angular_velocity, arm)
        self._velocity = _spline(drive.time, drive.velocity + np.einsum("nij,nj->ni", rotation, spin))
        self._orientation = _spline(drive.time, _continuous(drive.orientation))
        self._rates = _spline(drive.time, drive.angular_velocity)

    def stamps(self, rate: float, *, jitter: float) -> Float[np.ndarray, " n"]:
        """Moments of measurement at about this rate [s since the start of the drive].

        Args:
            jitter: standard deviation of the intervals, as a share of one.
        """
        first = self.random.uniform(0, min(1 / rate, 0.2))
        count = int((self.drive.seconds - first) * rate * 0.999)
        even = first + np.arange(count) / (rate * self.random.uniform(0.999, 1.001))
        moved = even + np.clip(jitter * self.random.standard_normal(count), -0.4, 0.4) / rate
        return np.clip(moved, 0.0, self.drive.seconds)

    def noise(self, time: Float[np.ndarray, " n"], width: int, *, white: float, slow: float) -> np.ndarray:
        """White noise, and slow noise with a correlation time of 20 s."""
        knots = np.arange(-20.0, self.drive.seconds + 60.0, 20.0)
        wander = _spline(knots, self.random.standard_normal((len(knots), width)))(time)
        noise: np.ndarray = white * self.random.standard_normal((len(time), width)) + slow * wander
        return noise

    def position(self, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Pose point in the world frame [m]."""
        return np.asarray(self._position(time))

    def orientation(self, time: Float[np.ndarray, " n"], *, error: float) -> Float[np.ndarray, "n 4"]:
        """world_from_body, xyzw, with errors of this size about all axes [rad]."""
        turn = self.noise(time, 3, white=error / 2, slow=error / 2)
        true = Rotation.from_quat(self._orientation(time))
        return np.asarray((true * Rotation.from_rotvec(turn)).as_quat())

    def velocity(self, time: Float[np.ndarray, " n"], frame: str) -> Float[np.ndarray, "n 3"]:
        """Velocity of the pose point in the frame "world" or "body" [m/s]."""
        world = np.asarray(self._velocity(time))
        if frame == "world":
            return world
        return np.asarray(Rotation.from_quat(self._orientation(time)).apply(world, inverse=True))

    def body_rates(self, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Angular velocity in the body frame [rad/s]."""
        return np.asarray(self._rates(time))

    def yaw(self, orientation: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, " n"]:
        """Heading, unwrapped [rad]."""
        return yaw_from_quaternion(orientation)

    def yaw_rate(self, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """d(yaw)/dt [rad/s]."""
        return yaw_rate_from_body_rates(_unit(self._orientation(time)), self.body_rates(time))

    def measured(self, name: str, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n k"]:
        """A quantity of the drive, interpolated."""
        values = getattr(self.drive, name)
        columns = values.reshape(len(values), -1).T
        return np.stack([np.interp(time, self.drive.time, column) for column in columns], axis=1)

    def commanded(self, index: int, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """A command (0 throttle, 1 brake, 2 steer) as it is held at each moment."""
        row = np.searchsorted(self.drive.time, time, side="right") - 1
        held: np.ndarray = self.drive.command[np.maximum(row, 0), index]
        return held

    def arrivals(self, stamps: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """When messages stamped so arrive: after milliseconds of transport, in order."""
        latency = self.random.uniform(0.001, 0.02)
        late = stamps + latency + self.random.exponential(0.2 * latency, len(stamps))
        return np.maximum.accumulate(late)


def quantised(values: np.ndarray, step: float) -> np.ndarray:
    """Values in whole steps; 0 for no steps."""
    return np.round(values / step) * step if step else values


def _spline(time: np.ndarray, values: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    return CubicSpline(time, values)  # type: ignore[no-any-return]


def _continuous(quaternion: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 4"]:
    """The same rotations without changes of the sign from row to row."""
    flips = np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0
    return quaternion * np.where(np.append(0, np.cumsum(flips)) % 2, -1.0, 1.0)[:, None]


def _unit(quaternion: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 4"]:
    unit: np.ndarray = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    return unit
