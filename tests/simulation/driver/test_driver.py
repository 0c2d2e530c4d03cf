"""Driver: random intent, pedals, recovery, and whole drives in a small world."""

from dataclasses import replace

import numpy as np
import pytest

from offpiste.simulation.driver.driver import Driver, DriverSettings
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.simulate import drive, start_and_driver
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import World, WorldSettings
from simulation.drives import with_tree_ahead

VEHICLE = load_vehicle()
SEEDS = (0, 1, 2)


@pytest.fixture(scope="module")
def world() -> World:
    return make_world(WorldSettings("mojave", seed=1, size=160.0, resolution=0.5))


@pytest.fixture(scope="module")
def drives(world: World) -> list[list[VehicleSample]]:
    """Drives of 45 s, or until they end."""
    started = (start_and_driver(world, VEHICLE, seed=seed) for seed in SEEDS)
    return [list(drive(world, VEHICLE, start, driver, steps=2250)) for start, driver in started]


def of(drives: list[list[VehicleSample]], name: str) -> np.ndarray:
    return np.array([getattr(sample, name) for samples in drives for sample in samples])


def test_commands_cover_their_ranges(drives):
    throttle, brake, steer = of(drives, "command").T
    assert throttle.min() < 1e-3
    assert throttle.max() > 0.9
    assert brake.min() == 0
    assert brake.max() > 0.7
    assert steer.min() < -0.7
    assert steer.max() > 0.7
    assert ((brake > 0.2) & (np.abs(steer) > 0.2)).mean() > 0.01
    assert ((throttle > 0.05) & (brake > 0.05)).mean() < 0.1
    for command in (throttle, brake, steer):
        assert command.std() > 0.1


def test_speeds_and_slip_cover_their_ranges(drives):
    speed = np.hypot(*of(drives, "velocity")[:, :2].T)
    assert 3.5 < np.median(speed) < 6.0
    assert np.quantile(speed, 0.05) < 2.0
    assert np.quantile(speed, 0.95) > 7.0
    assert speed.max() < 13.5
    angles = np.array([np.abs(s.truth.slip_angle).max() for samples in drives for s in samples])
    assert (angles[speed > 1] > 0.2).mean() > 0.04
    ratios = np.array([s.truth.slip_ratio for samples in drives for s in samples])
    assert ratios.max() > 0.5
    assert ratios.min() < -0.5


def test_commands_do_not_depend_on_the_ground(drives, world):
    """They follow from shapes and the vehicle's own motion."""
    other = make_world(WorldSettings("mojave", seed=2, size=160.0, resolution=0.5))
    ground = replace(world, kinds=other.kinds, wetness=other.wetness, properties=np.ones_like(other.properties))
    _, driver = start_and_driver(ground, VEHICLE, seed=SEEDS[0])
    blind = [replace(s, truth=replace(s.truth, properties=np.zeros((4, 4)))) for s in drives[0]]
    np.testing.assert_array_equal([driver.command(s) for s in blind], [s.command for s in drives[0]])


def test_a_vehicle_that_cannot_move_tries_and_gives_up(drives, world):
    driver = Driver(world, VEHICLE, np.random.default_rng(0), DriverSettings(timeout=9.0))
    pinned = replace(drives[0][0], velocity=np.zeros(3), wheel_speed=np.zeros(4), angular_velocity=np.zeros(3))
    commands = []
    while not driver.stuck and len(commands) < 6000:
        commands.append(driver.command(pinned))
    assert 9.0 <= len(commands) * 0.02 < 30.0
    throttle, _, steer = np.array(commands).T
    assert throttle.max() > 0.7
    assert np.ptp(steer) > 0.3


def test_it_drives_around_a_tree(world):
    """A tree on the trail in front of the start."""
    start, _ = start_and_driver(world, VEHICLE, seed=0)
    planted, ahead = with_tree_ahead(world, start, 12.0)
    start, driver = start_and_driver(planted, VEHICLE, seed=0)
    samples = list(drive(planted, VEHICLE, start, driver, steps=400))
    away = np.hypot(*(np.array([s.position[:2] for s in samples]) - ahead).T)
    assert not any(sample.events for sample in samples)
    assert away.min() > 1.0
    assert len(samples) == 400
