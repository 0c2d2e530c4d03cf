"""A true drive of a bicycle on flat ground, for tests of known faults: no simulation, known at every moment."""

from functools import cache

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from experiments.inspection_faults.drives import TrueDrive
from experiments.inspection_faults.recording import Case, recorded

WHEELBASE, MAX_STEER = 2.0, 0.4


@cache
def made_up_drive(seconds: float = 30.0, seed: int = 0) -> TrueDrive:
    """The pose point, the middle of the wheelbase, moves along the heading: vy is 0."""
    random = np.random.default_rng(seed)
    dt = 0.02
    time = dt * np.arange(int(seconds / dt))
    throttle = np.clip(0.4 + 0.5 * _wander(random, time, 4.0), 0, 1)
    brake = np.where(throttle < 0.02, np.clip(_wander(random, time, 3.0), 0, 1), 0.0)
    steer = np.clip(0.5 * _wander(random, time, 2.5), -1, 1)
    v = np.zeros(len(time))
    for i in range(1, len(time)):
        v[i] = max(v[i - 1] + dt * (3.0 * throttle[i - 1] - 5.0 * brake[i - 1] - 0.3 * v[i - 1]), 0.0)
    rate = v * np.tan(MAX_STEER * steer) / WHEELBASE
    yaw = 0.3 + np.cumsum(rate) * dt
    zero = np.zeros(len(time))
    velocity = np.stack((v * np.cos(yaw), v * np.sin(yaw), zero), axis=1)
    return TrueDrive(
        behaviour="made up",
        mass=900.0,
        wheelbase=WHEELBASE,
        track=1.2,
        max_steer=MAX_STEER,
        time=time,
        position=np.cumsum(velocity, axis=0) * dt,
        orientation=Rotation.from_euler("z", yaw[:, None]).as_quat(),
        velocity=velocity,
        angular_velocity=np.stack((zero, zero, rate), axis=1),
        command=np.stack((throttle, brake, steer), axis=1),
        brake_pressure=brake,
        steer_angle=MAX_STEER * steer,
        steer_rate=np.gradient(MAX_STEER * steer, dt),
        engine_speed=1000 + 300 * v,
        wheel_speed=np.repeat(v[:, None], 4, axis=1),
    )


def made_up_case(*needs: str, seed: int = 0) -> Case:
    """A healthy recording of it that has these channels."""
    return recorded(made_up_drive(), np.random.default_rng(seed), needs)


def _wander(random: np.random.Generator, time: np.ndarray, period: float) -> np.ndarray:
    knots = np.arange(time[0], time[-1] + 2 * period, period / 2)
    return np.asarray(CubicSpline(knots, random.standard_normal(len(knots)))(time))
