"""Sensors from the first messages are those that a log of the same messages has."""

import numpy as np

import sensor_bags
from offpiste.live.sensor_messages import SensorMessages
from offpiste.logs import open_log


def taken(messages, rig, **options):
    sensors = SensorMessages(rig, **options)
    return sensors, [sensors.take(topic, message, 0.0) for topic, message in messages]


def recorded(path):
    """Messages of a log in the order of its topics: transforms and calibrations first."""
    log = open_log(path)
    order = sorted(log.topics, key=lambda topic: topic not in ("/tf_static", "/info"))
    return [(topic, message) for topic in order for _, message in log.messages(topic)]


def test_sensors_images_and_scans_are_those_of_the_log(tmp_path):
    path, rig = sensor_bags.record(tmp_path / "a.mcap"), sensor_bags.sensor_rig()
    log = sensor_bags.opened(path)
    sensors, found = taken(recorded(path), rig, cameras=True)
    cameras, lidars = sensors.sensors
    assert sensors.waiting_for == ""
    np.testing.assert_array_equal(cameras["front"].body_from_camera, log.cameras["front"].body_from_camera)
    np.testing.assert_array_equal(lidars["top"].body_from_lidar, log.lidars["top"].body_from_lidar)
    expected = {(type(m), m.time): m for m in log.stream()}
    found = [m for m in found if m is not None]
    assert len(found) >= len(expected) - 2, "but for the first of each, which the sensors are set up from"
    for measured in found:
        same = expected[type(measured), measured.time]
        for name in ("pixels", "points", "offset"):
            if hasattr(same, name):
                np.testing.assert_array_equal(getattr(measured, name), getattr(same, name))


def test_it_says_what_it_waits_for(tmp_path):
    path, rig = sensor_bags.record(tmp_path / "a.mcap"), sensor_bags.sensor_rig()
    without = [(topic, message) for topic, message in recorded(path) if topic != "/tf_static"]
    sensors, found = taken(without, rig, cameras=True)
    assert found == [None] * len(found)
    assert "no fixed transform joins" in sensors.waiting_for
    nothing = SensorMessages(rig, cameras=True)
    assert nothing.waiting_for == "messages on /image, /points"
    assert SensorMessages(rig, cameras=False).topics == ("/points", "/tf_static")


def test_optional_sensors_are_left_out_once_the_others_are_settled(tmp_path):
    text = sensor_bags.SENSORS + '[lidars.rear]\ntopic = "/rear"\noptional = true\n'
    path, rig = sensor_bags.record(tmp_path / "a.mcap"), sensor_bags.sensor_rig(text)
    sensors, _ = taken(recorded(path), rig, cameras=False)
    assert sensors.sensors is None
    assert sensors.waiting_for == "messages on /rear"
    sensors.settle()
    assert list(sensors.sensors[1]) == ["top"]


def test_what_cannot_be_decoded_is_counted(tmp_path):
    path, rig = sensor_bags.record(tmp_path / "a.mcap"), sensor_bags.sensor_rig()
    messages = recorded(path)
    sensors, _ = taken(messages, rig, cameras=True)
    image = next(message for topic, message in messages if topic == "/image")
    image.data = image.data[:3]
    assert sensors.take("/image", image, 0.0) is None
    scan = next(message for topic, message in messages if topic == "/points")
    scan.point_step += 1
    assert sensors.take("/points", scan, 0.0) is None
    assert sum(sensors.dropped.values()) == 2
