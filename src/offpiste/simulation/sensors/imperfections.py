"""Imperfections of recorded logs: noise of the vehicle's channels, and errors of pose, calibration and stamps."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from offpiste.simulation.sample import VehicleSample


@dataclass(frozen=True)
class Noise:
    """Standard deviations of white noise in each sample.

    Attributes:
        position: fused position [m].
        attitude: angle about each axis [deg].
        velocity: [m/s].
        rate: angular velocity of the gyro [rad/s].
        acceleration: [m/s^2].
        steer_angle, steer_rate: at the road wheels [deg, deg/s].
        pressure: share of the brake's full pressure.
        engine_speed: [rev/min].
        wheel_speed: [m/s].
    """

    position: float = 0.005
    attitude: float = 0.05
    velocity: float = 0.02
    rate: float = 0.005
    acceleration: float = 0.1
    steer_angle: float = 0.1
    steer_rate: float = 0.5
    pressure: float = 0.003
    engine_speed: float = 10.0
    wheel_speed: float = 0.02


@dataclass(frozen=True)
class Imperfections:
    """Errors of a log that do not show in a single sample; none by default.

    Attributes:
        pose_noise_m: further white noise of recorded positions [m].
        pose_drift: random walk of the recorded pose, as odometry drifts: after one minute x and y are off by this many
            metres and the heading by as many degrees (standard deviations). A wrong heading bends the path.
        extrinsic_error_deg: angle between the recorded and the true mounting of each sensor [deg].
        stamp_offset_ms: how much later than it happened a camera's or LiDAR's message is stamped [ms].
    """

    pose_noise_m: float = 0.0
    pose_drift: float = 0.0
    extrinsic_error_deg: float = 0.0
    stamp_offset_ms: float = 0.0


class Drift:
    """Drift of odometry: true steps, rotated by the heading error, and a random walk."""

    def __init__(self, amount: float, rng: np.random.Generator) -> None:
        self._amount, self._rng = amount, rng
        self._last: VehicleSample | None = None
        self._place = np.zeros(2)
        self._yaw = 0.0

    def apply(self, sample: VehicleSample) -> VehicleSample:
        """The sample with the drifted position and orientation; its world velocity turns with the heading."""
        if self._amount == 0:
            return sample
        if self._last is None:
            self._place = sample.position[:2].copy()
        else:
            walk = self._amount * np.sqrt((sample.time - self._last.time) / 60) * self._rng.standard_normal(3)
            self._yaw += np.radians(walk[2])
            self._place = self._place + _turned(sample.position[:2] - self._last.position[:2], self._yaw) + walk[:2]
        self._last = sample
        turn = Rotation.from_euler("z", self._yaw)
        return replace(
            sample,
            position=np.append(self._place, sample.position[2]),
            orientation=(turn * Rotation.from_quat(sample.orientation)).as_quat(),
            velocity=turn.apply(sample.velocity),
        )


def with_noise(
    sample: VehicleSample, noise: Noise, imperfections: Imperfections, rng: np.random.Generator
) -> VehicleSample:
    """A sample with the noise of the vehicle's sensors; commands and truth stay as they are."""
    drawn = rng.standard_normal(20)
    place, tilt, velocity, rate, wheels = drawn[:3], drawn[3:6], drawn[6:9], drawn[9:12], drawn[12:16]
    pressure, angle, turning, engine = drawn[16:].tolist()
    return replace(
        sample,
        position=sample.position + np.hypot(noise.position, imperfections.pose_noise_m) * place,
        orientation=_tilted(sample.orientation, np.radians(noise.attitude) * tilt),
        velocity=sample.velocity + noise.velocity * velocity,
        angular_velocity=sample.angular_velocity + noise.rate * rate,
        brake_pressure=float(max(sample.brake_pressure + noise.pressure * pressure, 0.0)),
        steer_angle=float(sample.steer_angle + np.radians(noise.steer_angle) * angle),
        steer_rate=float(sample.steer_rate + np.radians(noise.steer_rate) * turning),
        engine_speed=float(sample.engine_speed + noise.engine_speed * engine),
        wheel_speed=sample.wheel_speed + noise.wheel_speed * wheels,
    )


def misaligned(rotation: Float[np.ndarray, " 4"], degrees: float, rng: np.random.Generator) -> Float[np.ndarray, " 4"]:
    """A mounting's quaternion (xyzw) with a calibration error: rotated by an angle [deg] about a random axis."""
    axis = rng.standard_normal(3)
    turn = Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis))
    return (Rotation.from_quat(rotation) * turn).as_quat()


def _tilted(orientation: Float[np.ndarray, " 4"], angles: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 4"]:
    """Quaternion rotated about the body's axes by small angles [rad], to first order.

    SciPy's rotations take 50 times as long for one.
    """
    x, y, z, w = orientation.tolist()
    a, b, c = (0.5 * angles).tolist()
    tilted = np.array(
        (x + w * a + y * c - z * b, y + w * b + z * a - x * c, z + w * c + x * b - y * a, w - x * a - y * b - z * c)
    )
    return tilted / np.sqrt(tilted @ tilted)


def _turned(xy: Float[np.ndarray, " 2"], angle: float) -> Float[np.ndarray, " 2"]:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array((cos * xy[0] - sin * xy[1], sin * xy[0] + cos * xy[1]))
