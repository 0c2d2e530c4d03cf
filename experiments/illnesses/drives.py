"""Simulates drives of many vehicles, and keeps them in a folder."""

import logging
from dataclasses import replace
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from experiments.illnesses.behaviours import BEHAVIOURS, world_of
from experiments.illnesses.true_drive import TrueDrive, load, save, scaled
from offpiste.core.conventions import DT
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.simulate import FINAL_EVENTS, Controller, Start
from offpiste.simulation.vehicle.parameters import VehicleParameters, load_vehicle
from offpiste.simulation.vehicle.vehicle import VehicleSimulation
from offpiste.simulation.world.world import World

logger = logging.getLogger("experiments")

_SECONDS: Final = (60.0, 180.0)
"""Shortest and longest drive, on the clock of the vehicle's own size [s]."""
_LEAST: Final = 40.0
"""A drive that ends earlier than this, by a rollover or stuck, is driven again [s]."""
_DRIVES_PER_WORLD: Final = 8
_WORLDS: Final = 40
_SIZES: Final = ((1.0, 0.5), (0.1, 0.15), (0.2, 0.1), (0.5, 0.1), (1.3, 0.1), (1.6, 0.05))
"""Sizes relative to a side-by-side, and their shares: cars of 1:10 and 1:5, a quad, the side-by-side, a truck."""


def varied_vehicle(random: np.random.Generator) -> VehicleParameters:
    """A vehicle of about the side-by-side's size: another geometry, balance, engine, brakes and steering."""
    standard = load_vehicle()

    def around(spread: float) -> float:
        return float(np.exp(random.uniform(-spread, spread)))

    mass, length, width = around(0.25), around(0.25), around(0.12)
    changed = {
        "wheelbase": length,
        "length": length,
        "track": width,
        "width": width,
        "mass": mass,
        "roll_inertia": mass * width**2,
        "pitch_inertia": mass * length**2,
        "yaw_inertia": mass * length**2 * around(0.15),
        **dict.fromkeys(("spring_front", "spring_rear", "damper_front", "damper_rear"), mass * around(0.15)),
        **dict.fromkeys(("tyre_stiffness", "unsprung_mass"), mass),
        "anti_roll_front": mass * around(0.3),
        "anti_roll_rear": mass * around(0.3),
        "com_height": width * around(0.1),
        "engine_torque": mass * around(0.3),
        "engine_inertia": around(0.3),
        "brake_torque": mass * around(0.3),
        "brake_delay": around(0.5),
        "brake_time": around(0.5),
        "max_steer": around(0.2),
        "max_steer_rate": around(0.4),
        "steer_frequency": around(0.4),
        "shift_time": around(0.5),
    }
    values = {name: getattr(standard, name) * factor for name, factor in changed.items()}
    # No body's inertia about one axis exceeds those about the two others together.
    values["yaw_inertia"] = min(values["yaw_inertia"], 0.98 * (values["roll_inertia"] + values["pitch_inertia"]))
    return msgspec.structs.replace(standard, **values, front_share=float(random.uniform(0.38, 0.58)))


def drive_of(seed: int, cache: Path) -> TrueDrive:
    """The drive of a seed: simulated once, then read from the folder.

    Args:
        cache: folder of simulated drives.
    """
    path = cache / f"drive-{seed:06d}.npz"
    if not path.exists():
        save(simulated_drive(seed), path)
    return load(path)


def simulated_drive(seed: int) -> TrueDrive:
    """Simulate the drive of a seed; a drive that ends too early is begun again with the next random numbers."""
    world = world_of(seed // _DRIVES_PER_WORLD % _WORLDS)
    random = np.random.default_rng([seed, 0xD81])
    sizes, shares = zip(*_SIZES, strict=True)
    size = float(random.choice(sizes, p=shares))
    seconds = float(random.uniform(*_SECONDS))
    names = list(BEHAVIOURS)
    while True:
        behaviour = names[int(random.choice(len(names), p=[BEHAVIOURS[name].share for name in names]))]
        vehicle = varied_vehicle(random)
        ground = BEHAVIOURS[behaviour].ground(world, random)
        start, controller = BEHAVIOURS[behaviour].driver(ground, vehicle, random)
        samples = _samples(ground, vehicle, start, controller, seconds=seconds / np.sqrt(size))
        if samples[-1].time * np.sqrt(size) > _LEAST and _moved(samples):
            return scaled(_drive_from(samples, behaviour, vehicle), size)


def _samples(
    world: World, vehicle: VehicleParameters, start: Start, controller: Controller, *, seconds: float
) -> list[VehicleSample]:
    """Samples every `DT` until the time is over, the vehicle rolls over or the driver gives up."""
    simulation = VehicleSimulation(world, vehicle, x=start.x, y=start.y, yaw=start.yaw, speed=start.speed)
    samples: list[VehicleSample] = []
    while len(samples) * DT < seconds:
        sample = simulation.sample()
        command = controller.command(sample)
        # A sample's own command is the one before: what is held from its moment on is the next.
        samples.append(replace(sample, command=command[:3]))
        if controller.stuck or set(sample.events) & set(FINAL_EVENTS):
            # What a vehicle does on its roof is no driving.
            return samples[: -round(3.0 / DT)] or samples
        simulation.step(*command)
    return samples


def _moved(samples: list[VehicleSample]) -> bool:
    """Whether it drove for a third of the time: it did not dig itself in."""
    speed = np.array([np.hypot(*sample.velocity[:2]) for sample in samples])
    return bool((speed > 1.0).mean() > 1 / 3)


def _drive_from(samples: list[VehicleSample], behaviour: str, vehicle: VehicleParameters) -> TrueDrive:
    def column(name: str) -> np.ndarray:
        return np.array([getattr(sample, name) for sample in samples])

    names = (
        "time position orientation velocity angular_velocity command brake_pressure steer_angle steer_rate engine_speed"
        " wheel_speed"
    )
    return TrueDrive(
        behaviour=behaviour,
        mass=vehicle.mass,
        wheelbase=vehicle.wheelbase,
        track=vehicle.track,
        max_steer=vehicle.max_steer,
        **{name: column(name) for name in names.split()},
    )
