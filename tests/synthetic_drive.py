"""Vehicle samples to record: a kinematic bicycle on rolling ground with known equations, and the simulated vehicle."""

from functools import cache

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from offpiste.rig.rig import load_rig
from offpiste.simulation.sample import VehicleSample, WheelTruth
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.simulation.vehicle.vehicle import VehicleSimulation
from offpiste.simulation.world.world import Bushes, Trees, World, WorldSettings

DT = 0.02


NOTHING, NO_FEET = np.zeros(0), np.zeros((0, 3))
NO_TREES = Trees(NO_FEET, NOTHING, NOTHING, NOTHING)
NO_BUSHES = Bushes(NO_FEET, NOTHING, NOTHING, NOTHING)


def bare_world(elevation: np.ndarray, origin: tuple[float, float], resolution: float, **more: object) -> World:
    """A world of the first kind of ground without grass and trails; `more` replaces any of its attributes."""
    kinds = np.zeros((7, *elevation.shape))
    kinds[0] = 1
    flat = np.zeros(elevation.shape)
    plain = {"settings": WorldSettings(), "kinds": kinds, "wetness": flat, "properties": np.ones((*flat.shape, 4)),
             "grass_height": flat, "trees": NO_TREES, "bushes": NO_BUSHES, "trails": ()}  # fmt: skip
    return World(origin=origin, resolution=resolution, elevation=elevation, **(plain | more))


def small_world() -> World:
    """A plain that tilts, neither square nor symmetric: 7 x 4 nodes."""
    ny, nx = 4, 7
    y, x = np.meshgrid(np.arange(ny), np.arange(nx), indexing="ij")
    properties = np.stack([100.0 * k + x + 10.0 * y for k in range(4)], axis=2)
    kinds = np.full((7, ny, nx), 1 / 7)
    return bare_world(x + 10.0 * y, (-3.0, 5.0), 0.5, kinds=kinds, properties=properties)


@cache
def samples(seconds: float = 60.0, seed: int = 0) -> tuple[VehicleSample, ...]:
    """Throttle, brake and steering vary; the pose point is the middle of the wheelbase, which does not slip there."""
    rig = load_rig("proving_ground").vehicle
    random, time = np.random.default_rng(seed), np.arange(0, seconds, DT)
    throttle = np.clip(0.6 * _wander(random, time, 4.0) + 0.3, 0, 1)
    brake = np.where(throttle < 0.02, np.clip(_wander(random, time, 3.0), 0, 1), 0.0)
    steer = np.clip(0.4 * _wander(random, time, 2.5), -1, 1)
    angle, pressure = lagged(rig.max_steer * steer, 0.12), lagged(brake, 0.08)
    v = np.zeros(len(time))
    for i in range(1, len(time)):
        v[i] = max(v[i - 1] + DT * (3.0 * throttle[i - 1] - 5.0 * pressure[i - 1] - 0.15 * v[i - 1]), 0.0)
    slip = np.arctan(0.5 * np.tan(angle))
    yaw_rate = v * np.cos(slip) * np.tan(angle) / rig.wheelbase
    yaw = 0.3 + np.cumsum(yaw_rate) * DT
    x, y = np.cumsum(v * np.cos(yaw + slip)) * DT, np.cumsum(v * np.sin(yaw + slip)) * DT
    z = 0.5 * np.sin(x / 20)
    rate = np.gradient(angle, DT)
    pitch = -np.arctan(np.gradient(z, DT) / np.maximum(v, 0.1))
    return tuple(
        VehicleSample(
            time=float(time[i]),
            position=np.array((x[i], y[i], z[i])),
            orientation=Rotation.from_euler("ZYX", (yaw[i], pitch[i], 0.0)).as_quat(),
            velocity=np.array((v[i] * np.cos(yaw[i] + slip[i]), v[i] * np.sin(yaw[i] + slip[i]), 0.0)),
            angular_velocity=np.array((-np.sin(pitch[i]) * yaw_rate[i], 0.0, np.cos(pitch[i]) * yaw_rate[i])),
            command=np.array((throttle[i], brake[i], steer[i])),
            brake_pressure=float(pressure[i]),
            steer_angle=float(angle[i]),
            steer_rate=float(rate[i]),
            engine_speed=1200.0 + 4000.0 * throttle[i],
            wheel_speed=np.full(4, v[i]),
            truth=_truth(i),
        )
        for i in range(len(time))
    )


def _truth(row: int) -> WheelTruth:
    """Every number in it is another one."""
    return WheelTruth(
        contact=row + np.arange(12.0).reshape(4, 3) / 16,
        properties=np.arange(16.0).reshape(4, 4) / 32,
        kind=np.array((0, 1, 2, row % 7)),
        load=2000.0 + np.arange(4.0) + row,
        slip_ratio=np.array((-1.0, -0.5, 0.25, 1.0)),
        slip_angle=np.array((0.0, 0.125, -0.25, 0.5)),
    )


def lagged(command: np.ndarray, seconds: float) -> np.ndarray:
    """A command behind which a first-order actuator lags."""
    out = np.empty(len(command))
    out[0] = command[0]
    for i in range(1, len(command)):
        out[i] = out[i - 1] + DT / seconds * (command[i - 1] - out[i - 1])
    return out


def _wander(random: np.random.Generator, time: np.ndarray, period: float) -> np.ndarray:
    """A smooth random signal of unit spread."""
    knots = np.arange(time[0], time[-1] + 2 * period, period / 2)
    return CubicSpline(knots, random.standard_normal(len(knots)))(time)


def plain(friction: float, size: float = 400.0, resolution: float = 1.0) -> World:
    """Flat ground of one grip, around the origin."""
    n = int(size / resolution) + 1
    properties = np.broadcast_to((friction, 10 * friction, 0.05, 0.05), (n, n, 4)).copy()
    return bare_world(np.zeros((n, n)), (-size / 2, -size / 2), resolution, properties=properties)


@cache
def simulated(seconds: float = 60.0, seed: int = 0, friction: float = 0.7) -> tuple[VehicleSample, ...]:
    """The proving ground's vehicle under a driver whose speed and steering in mind wander smoothly."""
    random, time = np.random.default_rng(seed), np.arange(0, seconds, DT)
    wanted = np.clip(5 + 2.5 * _wander(random, time, 5.0), 0, 12)
    steer = np.clip(0.5 * _wander(random, time, 3.0), -1, 1)
    vehicle = VehicleSimulation(plain(friction), load_vehicle(), x=0.0, y=0.0, yaw=0.3)
    found = []
    for row in range(len(time)):
        found.append(vehicle.sample())
        speed = float(np.hypot(*found[-1].velocity[:2]))
        lack = wanted[row] - speed
        throttle = np.clip(0.15 + 0.3 * lack, 0, 1) if lack > -0.5 else 0.0
        brake = np.clip(-0.8 * (lack + 0.5), 0, 1)
        vehicle.step(float(throttle), float(brake), float(steer[row] * min(1.0, 5 / max(speed, 1.0))))
    return tuple(found)
