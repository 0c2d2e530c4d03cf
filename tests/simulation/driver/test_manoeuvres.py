"""Manoeuvres between stretches of trail: the whole range of speeds, within limits, from a seed."""

from dataclasses import replace

import numpy as np
import pytest

from offpiste.core.conventions import DT
from offpiste.simulation.driver.driver import WITH_MANOEUVRES, DriverSettings
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.simulate import drive, start_and_driver
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import World, WorldSettings
from simulation.drives import with_tree_ahead

VEHICLE = load_vehicle()
DRIVES = (("mojave", 3), ("mojave", 4), ("dunes", 2), ("dunes", 3), ("coastal-scrub", 1), ("halter-ranch", 3))
Drives = dict[tuple[str, int], list[VehicleSample]]


def small(preset: str, seed: int) -> World:
    return make_world(WorldSettings(preset, seed=seed, size=200.0, resolution=0.5))


def driven(world: World, seed: int, settings: DriverSettings | None, seconds: float = 60.0) -> list[VehicleSample]:
    start, driver = start_and_driver(world, VEHICLE, seed=seed, settings=settings)
    return list(drive(world, VEHICLE, start, driver, steps=round(seconds / DT)))


def speeds(samples: list[VehicleSample]) -> np.ndarray:
    """Speed forwards [m/s]."""
    return np.array([sample.forward_speed for sample in samples])


@pytest.fixture(scope="module")
def drives() -> Drives:
    """Drives of 60 s with manoeuvres, or until they end."""
    return {key: driven(small(*key), key[1], WITH_MANOEUVRES) for key in DRIVES}


@pytest.fixture(scope="module")
def world() -> World:
    return small("mojave", 3)


def test_speeds_cover_the_whole_range(drives):
    assert sum(map(len, drives.values())) > 0.8 * len(DRIVES) * 3000
    speed = np.concatenate([speeds(samples) for samples in drives.values()])
    shares = np.histogram(speed, (-10, -0.1, 0.1, 1.5, 8, 30))[0] / len(speed)
    reverse, standing, crawling, driving, fast = shares
    assert 0.03 < reverse < 0.25
    assert 0.03 < standing < 0.25
    assert 0.05 < crawling < 0.30
    assert 0.35 < driving < 0.75
    assert 0.05 < fast < 0.40
    assert speed.max() > 10
    assert -6 < speed.min() < -2


def test_gears_change_at_a_standstill_only(drives):
    changes = 0
    for samples in drives.values():
        wanted, engaged = np.array([(s.command[3], s.gear) for s in samples]).T
        moving = np.array([np.hypot(*s.velocity[:2]) for s in samples])
        for gear, most in ((wanted, 0.1), (engaged, 0.3)):
            at = np.flatnonzero(np.diff(gear))
            changes += len(at)
            assert moving[at + 1].max(initial=0.0) <= most
    assert changes > 20


def test_it_reverses_along_its_own_path(drives):
    """What is driven backwards lies near what was driven forwards before; on banks the vehicle slides off."""
    away = []
    for samples in drives.values():
        places, speed = np.array([s.position[:2] for s in samples]), speeds(samples)
        for row in np.flatnonzero(speed < -0.5)[::10]:
            before = places[:row][speed[:row] > 0.1]
            away.append(np.hypot(*(before - places[row]).T).min(initial=99.0))
    assert len(away) > 100
    assert np.median(away) < 0.3
    assert np.quantile(away, 0.75) < 0.8


def test_a_vehicle_with_its_nose_at_a_trunk_rocks_free(world):
    """No throttle forwards helps, reverse does."""
    start, _ = start_and_driver(world, VEHICLE, seed=3)
    planted, _ = with_tree_ahead(world, start, 2.3, radius=0.5)
    start = replace(start, speed=0.0)

    def farthest(settings: DriverSettings) -> float:
        _, driver = start_and_driver(planted, VEHICLE, seed=3, settings=settings)
        places = np.array([s.position[:2] for s in drive(planted, VEHICLE, start, driver, steps=2000)])
        return float(np.hypot(*(places - places[0]).T).max())

    assert farthest(DriverSettings()) < 3
    assert farthest(DriverSettings(manoeuvres=1e-6)) > 8
