"""The loop of vehicle and commander: how drives begin and end, and what twins are."""

from dataclasses import dataclass

import numpy as np
import pytest

from offpiste.simulation.simulate import Replay, Start, drive, on_other_ground, start_and_driver
from offpiste.simulation.vehicle.parameters import load_vehicle
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import WorldSettings
from simulation.drives import flat_world

VEHICLE = load_vehicle()


@dataclass
class Always:
    """One command, and giving up after some samples."""

    wanted: tuple[float, float, float]
    timeouts: int = 10**6

    @property
    def stuck(self):
        return self.timeouts <= 0

    def command(self, sample):
        self.timeouts -= 1
        return np.array(self.wanted)


def small(seed):
    return make_world(WorldSettings("mojave", seed=seed, size=100.0, resolution=0.5))


def test_every_step_is_one_sample_with_the_command_that_follows():
    samples = list(drive(flat_world(), VEHICLE, Start(1.0, 2.0, 0.5, 4.0), Always((0.3, 0.0, 0.1)), steps=50))
    np.testing.assert_allclose([s.time for s in samples], np.arange(50) * 0.02)
    assert all((s.command == (0.3, 0.0, 0.1)).all() for s in samples)
    np.testing.assert_allclose(samples[0].position[:2], (1.0, 2.0))
    np.testing.assert_allclose(samples[0].velocity[:2], 4.0 * np.array((np.cos(0.5), np.sin(0.5))), atol=0.02)


def test_a_rollover_ends_the_drive():
    # Full lock at 12 m/s on ground that holds: the outer wheels trip it.
    sticky = flat_world(properties=(1.6, 12.0, 0.02, 0.0))
    samples = list(drive(sticky, VEHICLE, Start(0.0, 0.0, 0.0, 12.0), Always((1.0, 0.0, 1.0)), steps=500))
    assert samples[-1].events == ("rollover",)
    assert 10 < len(samples) < 400


def test_the_border_ends_the_drive():
    samples = list(drive(flat_world(), VEHICLE, Start(110.0, 0.0, 0.0, 8.0), Always((0.5, 0.0, 0.0)), steps=500))
    assert samples[-1].events == ("left the world",)
    assert samples[-1].position[0] == pytest.approx(120 - 3, abs=0.3)


def test_giving_up_is_told_once_and_ends_the_drive():
    samples = list(drive(flat_world(), VEHICLE, Start(0.0, 0.0, 0.0, 0.0), Always((0.0, 1.0, 0.0), 30), steps=500))
    assert len(samples) == 30
    assert [s.events for s in samples if s.events] == [("stuck",)]


def test_the_same_drive_twice():
    world = small(1)
    first, second = ([*_driven(world, 3, 250)] for _ in range(2))
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.position, b.position)
        np.testing.assert_array_equal(a.command, b.command)
    other = [*_driven(world, 4, 250)]
    assert not np.array_equal(first[-1].position, other[-1].position)


def test_twins_begin_alike_and_part():
    world, other = small(1), small(2)
    ground = on_other_ground(world, other)
    np.testing.assert_array_equal(ground.elevation, world.elevation)
    np.testing.assert_array_equal(ground.properties, other.properties)
    start, driver = start_and_driver(world, VEHICLE, seed=5)
    mine = list(drive(world, VEHICLE, start, driver, steps=400))
    commands = np.stack([s.command for s in mine])
    twin = list(drive(ground, VEHICLE, start, Replay(commands), steps=len(commands)))
    # The springs settle a little differently on other ground.
    np.testing.assert_allclose(mine[0].position, twin[0].position, atol=1e-4)
    np.testing.assert_allclose(mine[0].velocity, twin[0].velocity, atol=1e-4)
    np.testing.assert_array_equal([s.command for s in twin], commands[: len(twin)])
    apart = [np.hypot(*(a.position - b.position)[:2]) for a, b in zip(mine, twin, strict=False)]
    assert apart[10] < 0.1
    assert max(apart) > 1.0


def test_a_replay_on_the_same_ground_is_the_same_drive():
    world = small(1)
    mine = [*_driven(world, 5, 300)]
    start, _ = start_and_driver(world, VEHICLE, seed=5)
    again = list(drive(world, VEHICLE, start, Replay(np.stack([s.command for s in mine])), steps=len(mine)))
    np.testing.assert_array_equal([s.position for s in mine], [s.position for s in again])


def test_twins_need_worlds_of_one_size():
    with pytest.raises(ValueError, match="one size"):
        on_other_ground(flat_world(), flat_world(size=(100.0, 100.0)))


def _driven(world, seed, steps):
    start, driver = start_and_driver(world, VEHICLE, seed=seed)
    return drive(world, VEHICLE, start, driver, steps=steps)
