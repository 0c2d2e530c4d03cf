"""Sensors beside a vehicle that drives on."""

import threading
from dataclasses import replace
from unittest.mock import create_autospec

import numpy as np
import pytest

from offpiste.core.conventions import DT
from offpiste.simulation.sample import VehicleSample
from offpiste.simulation.sensors.suite import AHEAD, Sensing, SensorSuite, light_suite, observed
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import WorldSettings
from synthetic_drive import samples as driven


def samples(count):
    for n in range(count):
        sample = create_autospec(VehicleSample, instance=True)
        sample.time = float(n)
        yield sample


@pytest.mark.parametrize("count", [0, 3 * AHEAD])
def test_each_sample_comes_with_its_own_measurements_in_order(count):
    sensing = create_autospec(Sensing, instance=True)
    sensing.observe.side_effect = lambda sample, stamp_ns: [("/topic", stamp_ns(sample.time))]
    found = list(observed(samples(count), sensing, lambda time: int(10 * time)))
    assert [sample.time for sample, _ in found] == list(range(count))
    assert [messages for _, messages in found] == [[("/topic", 10 * n)] for n in range(count)]


def test_an_error_of_a_sensor_reaches_the_drive_and_leaves_no_thread():
    sensing, before = create_autospec(Sensing, instance=True), threading.active_count()
    sensing.observe.side_effect = OSError("broken")
    with pytest.raises(OSError, match="broken"):
        list(observed(samples(100), sensing, int))
    assert threading.active_count() == before


@pytest.mark.parametrize("apart", [True, False])
def test_a_lidar_measures_the_same_without_cameras_where_sensors_are_apart(apart, monkeypatch):
    monkeypatch.setattr(Sensing, "_image", lambda *_: [])
    world, suite, clouds = make_world(WorldSettings("mojave", size=80.0, resolution=1.0)), light_suite(), []
    seen = SensorSuite((replace(suite.cameras[0], rate=10.0),), suite.lidars)
    there = np.array((0.0, 0.0, float(world.elevation.max())))
    drive = [replace(sample, position=there) for sample in driven(1.0)[: round(0.3 / DT)]]
    for one in (seen, SensorSuite((), suite.lidars)):
        sensing = Sensing(world, one, np.random.default_rng([3, 2]), apart=apart)
        found = [sensing.observe(sample, lambda time: round(1e9 * time)) for sample in drive]
        clouds.append([message.data for messages in found for _, message in messages])
    assert [len(cloud) > 1000 for cloud in clouds[0]] == [True, True]
    same = [np.array_equal(one, other) for one, other in zip(*clouds, strict=True)]
    assert same == [apart, apart]
