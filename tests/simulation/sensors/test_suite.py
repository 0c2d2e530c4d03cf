"""Sensors beside a vehicle that drives on."""

import threading
import time
from dataclasses import replace
from functools import partial
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


def sensing(measurements):
    made = create_autospec(Sensing, instance=True)
    made.measurements = measurements
    return made


@pytest.mark.parametrize("count", [0, 3 * AHEAD])
def test_each_sample_comes_with_its_own_measurements_in_order(count):
    threads, rng = set(), np.random.default_rng(0)

    def measurements(sample, stamp_ns):
        threads.add(threading.current_thread())
        for k in range(2):
            yield partial(measured, f"/topic{k}", stamp_ns(sample.time), rng.random() / 1000)

    def measured(topic, stamp, seconds):
        time.sleep(seconds)  # the later one is often ready first
        assert threading.current_thread() not in threads
        return [(topic, stamp)]

    found = list(observed(samples(count), sensing(measurements), lambda time: int(10 * time)))
    assert [sample.time for sample, _ in found] == list(range(count))
    assert [messages for _, messages in found] == [[("/topic0", 10 * n), ("/topic1", 10 * n)] for n in range(count)]
    assert len(threads) == min(count, 1)
    assert threading.current_thread() not in threads


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


def test_an_error_of_a_sensor_reaches_the_drive_and_leaves_no_thread():
    def broken(time):
        if time == 2:
            raise OSError("broken")
        return []

    def measurements(sample, stamp_ns):
        yield partial(broken, sample.time)

    before = threading.active_count()
    with pytest.raises(OSError, match="broken"):
        list(observed(samples(100), sensing(measurements), int))
    assert threading.active_count() == before
