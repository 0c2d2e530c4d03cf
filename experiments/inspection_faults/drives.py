"""Simulated drives of many vehicles: the truth that logs are recorded from."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from jaxtyping import Float

from experiments.arrays import load_arrays, save_arrays
from offpiste.core.conventions import DT
from offpiste.simulation.driver.driver import DriverSettings
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.simulate import FINAL_EVENTS, drive, start_and_driver
from offpiste.simulation.vehicle.parameters import VehicleParameters, load_vehicle
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import World, WorldSettings

_SECONDS: Final = (60.0, 180.0)
"""Shortest and longest drive [s]."""
_LEAST: Final = 40.0
"""A drive that ends earlier, by a rollover or stuck, is repeated [s]."""
_DRIVES_PER_WORLD, _WORLDS = 8, 40
_PRESETS: Final = ("mojave", "halter-ranch", "coastal-scrub", "dunes", "uniform")
_SIZES: Final = {1.0: 0.5, 0.1: 0.15, 0.2: 0.1, 0.5: 0.1, 1.3: 0.1, 1.6: 0.05}
"""Sizes relative to a side-by-side and their shares: 1:10 and 1:5 cars, a quad, larger side-by-sides, a truck."""
BEHAVIOURS: Final = {
    "ordinary": 0.40, "slow": 0.08, "bumpy": 0.08, "stops and reverse": 0.18, "wheel spin": 0.08, "drifting": 0.08,
    "cornering": 0.10,
}  # fmt: skip
"""Ways of driving and their shares; all of them are healthy."""


@dataclass(frozen=True)
class TrueDrive:
    """What happened; the pose point is the middle of the wheelbase at the height of the wheel centres at rest."""

    behaviour: str
    mass: float  # [kg]
    wheelbase: float  # [m]
    track: float  # [m]
    max_steer: float  # road-wheel angle at a command of 1 [rad]
    time: Float[np.ndarray, " n"]  # evenly spaced [s]
    position: Float[np.ndarray, "n 3"]  # in the world frame [m]
    orientation: Float[np.ndarray, "n 4"]  # world_from_body, xyzw
    velocity: Float[np.ndarray, "n 3"]  # in the world frame [m/s]
    angular_velocity: Float[np.ndarray, "n 3"]  # in the body frame [rad/s]
    command: Float[np.ndarray, "n 3"]  # throttle, brake [0..1], steer [-1..1, + left], held from each time on
    brake_pressure: Float[np.ndarray, " n"]  # [0..1]
    steer_angle: Float[np.ndarray, " n"]  # of the road wheels, + left [rad]
    steer_rate: Float[np.ndarray, " n"]  # [rad/s]
    engine_speed: Float[np.ndarray, " n"]  # [rev/min]
    wheel_speed: Float[np.ndarray, "n 4"]  # rolling speed [m/s]

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return float(self.time[-1] - self.time[0])


def scaled(drive: TrueDrive, size: float) -> TrueDrive:
    """Return the drive of a vehicle, and on ground, `size` times as large.

    Froude similarity: with gravity, friction and density kept, lengths grow by the size, times and speeds by its square
    root and masses by its cube. Accelerations, angles and ratios of forces stay, so the scaled drive solves the scaled
    vehicle's equations of motion exactly.
    """
    time = np.sqrt(size)
    powers = {
        "mass": size**3, "wheelbase": size, "track": size, "time": time, "position": size, "velocity": time,
        "angular_velocity": 1 / time, "steer_rate": 1 / time, "engine_speed": 1 / time, "wheel_speed": time,
    }  # fmt: skip
    return replace(drive, **{name: getattr(drive, name) * factor for name, factor in powers.items()})


def drive_of(seed: int, cache: Path) -> TrueDrive:
    """Return the drive of a seed, simulated once and kept in the folder `cache`."""
    path = cache / f"drive-{seed:06d}.npz"
    if not path.exists():
        save_arrays(_simulated(seed), path)
    return load_arrays(TrueDrive, path)


def _simulated(seed: int) -> TrueDrive:
    """Simulate the drive of a seed; one that ends early or hardly moves is repeated with the next random numbers."""
    world, random = world_of(seed), np.random.default_rng([seed, 0xD81])
    size = float(random.choice(list(_SIZES), p=list(_SIZES.values())))
    seconds = float(random.uniform(*_SECONDS) / np.sqrt(size))
    while True:
        behaviour = str(random.choice(list(BEHAVIOURS), p=list(BEHAVIOURS.values())))
        vehicle = _varied_vehicle(random)
        ground, settings = ground_and_style(behaviour, world, random)
        start, driver = start_and_driver(ground, vehicle, seed=int(random.integers(1 << 30)), settings=settings)
        samples = list(drive(ground, vehicle, start, driver, steps=round(seconds / DT)))
        if driver.stuck or set(samples[-1].events) & set(FINAL_EVENTS):
            samples = samples[: -round(3.0 / DT)] or samples  # the fall is not driving
        speed = np.array([np.hypot(*sample.velocity[:2]) for sample in samples])
        if samples[-1].time * np.sqrt(size) > _LEAST and (speed > 1.0).mean() > 1 / 3:
            return scaled(true_drive(samples, behaviour, vehicle), size)


def true_drive(samples: Sequence[VehicleSample], behaviour: str, vehicle: VehicleParameters) -> TrueDrive:
    """Return samples of a vehicle as a true drive."""
    columns = [field.name for field in fields(TrueDrive) if field.name in vars(samples[0])]
    values: dict[str, Any] = {name: np.array([getattr(sample, name) for sample in samples]) for name in columns}
    values["command"] = np.array([sample.command[:3] for sample in samples])
    body = {name: getattr(vehicle, name) for name in ("mass", "wheelbase", "track", "max_steer")}
    return TrueDrive(behaviour, **body, **values)


@lru_cache(maxsize=1)
def _world(number: int) -> World:
    preset = _PRESETS[number % len(_PRESETS)]
    return make_world(WorldSettings(preset=preset, seed=100 + number, size=260.0, resolution=0.35))


def world_of(seed: int) -> World:
    """Return the world of a seed; eight consecutive seeds share one."""
    return _world(seed // _DRIVES_PER_WORLD % _WORLDS)


def ground_and_style(behaviour: str, world: World, random: np.random.Generator) -> tuple[World, DriverSettings]:
    """Return the ground and the driver's settings of a behaviour."""
    swerves = behaviour in ("drifting", "cornering")
    if swerves:
        world = _open(world)
    if behaviour in ("wheel spin", "drifting"):
        world = _slippery(world, random)
    elif behaviour == "bumpy":
        world = _bumpy(world, random)
    median = random.uniform(1.0, 1.8) if behaviour == "slow" else random.uniform(3.5, 7.5)
    hard = random.uniform(4.0, 8.0)
    return world, DriverSettings(
        median_speed=median,
        top_speed=min(2 * median + 1, 14.0),
        cornering=(0.5 * hard, hard),
        pause=random.uniform(1.0, 2.0) if swerves else random.uniform(2.5, 8.0),
        off_trail=0.8 if swerves else 0.35,
        manoeuvres=8.0 if behaviour == "stops and reverse" else 0.0,
    )


def _open(world: World) -> World:
    """Nearly level ground without plants."""

    def none_of(plants: Any) -> Any:
        return replace(plants, **{name: values[:0] for name, values in vars(plants).items()})

    return replace(world, elevation=0.15 * world.elevation, trees=none_of(world.trees), bushes=none_of(world.bushes))


def _slippery(world: World, random: np.random.Generator) -> World:
    """Uniform grip between ice and wet grass."""
    properties = world.properties.copy()
    properties[..., 0], properties[..., 1] = random.uniform(0.15, 0.35), random.uniform(1.5, 4.0)
    return replace(world, properties=properties)


def _bumpy(world: World, random: np.random.Generator) -> World:
    """Bumps of some centimetres, about a metre apart."""
    rows, columns = world.elevation.shape
    bumps = random.standard_normal((-(-rows // 2), -(-columns // 2))).repeat(2, 0).repeat(2, 1)[:rows, :columns]
    return replace(world, elevation=world.elevation + random.uniform(0.015, 0.035) * bumps)


def _varied_vehicle(random: np.random.Generator) -> VehicleParameters:
    """A vehicle about as large as the side-by-side, with another geometry, balance, engine, brakes and steering."""
    standard = load_vehicle()

    def around(spread: float) -> float:
        return float(np.exp(random.uniform(-spread, spread)))

    mass, length, width = around(0.25), around(0.25), around(0.12)
    factors = {
        "wheelbase": length, "length": length, "track": width, "width": width, "mass": mass,
        "roll_inertia": mass * width**2, "pitch_inertia": mass * length**2,
        "yaw_inertia": mass * length**2 * around(0.15),
        **dict.fromkeys(("spring_front", "spring_rear", "damper_front", "damper_rear"), mass * around(0.15)),
        **dict.fromkeys(("tyre_stiffness", "unsprung_mass"), mass),
        "anti_roll_front": mass * around(0.3), "anti_roll_rear": mass * around(0.3),
        "com_height": width * around(0.1), "engine_torque": mass * around(0.3), "engine_inertia": around(0.3),
        "brake_torque": mass * around(0.3), "brake_delay": around(0.5), "brake_time": around(0.5),
        "max_steer": around(0.2), "max_steer_rate": around(0.4), "steer_frequency": around(0.4),
        "shift_time": around(0.5),
    }  # fmt: skip
    values = {name: getattr(standard, name) * factor for name, factor in factors.items()}
    # A body's inertia about one axis is at most the sum of the others.
    values["yaw_inertia"] = min(values["yaw_inertia"], 0.98 * (values["roll_inertia"] + values["pitch_inertia"]))
    return msgspec.structs.replace(standard, **values, front_share=float(random.uniform(0.38, 0.58)))
