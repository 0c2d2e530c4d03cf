"""A simulated drive without any sensor in between, and the same drive of a vehicle of another size."""

from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from offpiste.core.files import write_whole


@dataclass(frozen=True)
class TrueDrive:
    """What happened; the pose point is the middle of the wheelbase at the height of the wheel centres at rest.

    Attributes:
        behaviour: how it was driven (`behaviours.BEHAVIOURS`).
        mass: [kg].
        wheelbase, track: [m].
        max_steer: road-wheel angle at a command of 1 [rad].
        time: evenly spaced [s].
        position: in the world frame [m].
        orientation: world_from_body, xyzw.
        velocity: in the world frame [m/s].
        angular_velocity: in the body frame [rad/s].
        command: throttle [0..1], brake [0..1], steer [-1..1, + left], held since each moment.
        brake_pressure: [0..1].
        steer_angle, steer_rate: of the road wheels, + left [rad, rad/s].
        engine_speed: [rev/min].
        wheel_speed: rolling speed of each wheel [m/s].
    """

    behaviour: str
    mass: float
    wheelbase: float
    track: float
    max_steer: float
    time: Float[np.ndarray, " n"]
    position: Float[np.ndarray, "n 3"]
    orientation: Float[np.ndarray, "n 4"]
    velocity: Float[np.ndarray, "n 3"]
    angular_velocity: Float[np.ndarray, "n 3"]
    command: Float[np.ndarray, "n 3"]
    brake_pressure: Float[np.ndarray, " n"]
    steer_angle: Float[np.ndarray, " n"]
    steer_rate: Float[np.ndarray, " n"]
    engine_speed: Float[np.ndarray, " n"]
    wheel_speed: Float[np.ndarray, "n 4"]

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return float(self.time[-1] - self.time[0])


def scaled(drive: TrueDrive, size: float) -> TrueDrive:
    """The drive of a vehicle, and on ground, `size` times as large.

    Froude similarity: with gravity, friction and the densities kept, lengths grow by the size, times and speeds by its
    square root and masses by its cube. All accelerations and angles stay as they are, and so does every ratio of
    forces: the scaled drive is an exact solution of the scaled vehicle's equations of motion.
    """
    time = np.sqrt(size)
    return replace(
        drive,
        mass=drive.mass * size**3,
        wheelbase=drive.wheelbase * size,
        track=drive.track * size,
        time=drive.time * time,
        position=drive.position * size,
        velocity=drive.velocity * time,
        angular_velocity=drive.angular_velocity / time,
        steer_rate=drive.steer_rate / time,
        engine_speed=drive.engine_speed / time,
        wheel_speed=drive.wheel_speed * time,
    )


def save(drive: TrueDrive, path: Path) -> None:
    """Write a drive to an .npz file, whole or not at all."""

    def write(part: Path) -> None:
        with part.open("wb") as file:
            np.savez(file, **{field.name: getattr(drive, field.name) for field in fields(drive)})

    write_whole(path, write)


def load(path: Path) -> TrueDrive:
    """Read a drive that `save` wrote."""
    with np.load(path, allow_pickle=False) as stored:
        return TrueDrive(**{name: stored[name] if stored[name].ndim else stored[name].item() for name in stored})
