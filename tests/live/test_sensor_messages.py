"""Sensors from the first messages are those that a log of the same messages has."""

import threading
from pathlib import Path

import numpy as np

import sensor_bags
from live.made_up_robot import write_course, write_rig
from offpiste.core.errors import LogError
from offpiste.live.commands import run_live
from offpiste.live.reception import CourseRequest
from offpiste.live.sensor_messages import SensorMessages
from offpiste.live.session import LiveSettings
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
    messages = recorded(path)
    sensors, _ = taken(messages, rig, cameras=False)
    assert sensors.sensors is None
    assert sensors.waiting_for == "messages on /rear"
    sensors.settle()
    assert list(sensors.sensors[1]) == ["top"]
    assert sensors.left_out == []
    scan = next(message for topic, message in messages if topic == "/points")
    assert [sensors.take("/rear", scan, 0.0) for _ in range(2)] == [None, None]
    assert sensors.left_out == ["rear"], "named, now that it comes"


def test_what_was_left_out_is_named_after_a_replay(tmp_path, monkeypatch, caplog):
    def replayed(settings, rig, driver, reception, *_):
        reception.sensors.left_out.append("rear")

    monkeypatch.setattr("offpiste.live.commands._replay", replayed)
    rig, course = write_rig(tmp_path, actuators=True), CourseRequest(write_course(tmp_path))
    settings = LiveSettings(rig, "pretrained:proving-ground/parametric", None, course)
    run_live(settings, lockstep=False, replay=Path("a.mcap"), commands=None)
    assert "rear was left out" in caplog.text


def test_a_camera_that_cannot_be_set_up_is_not_lost_where_two_threads_try(tmp_path, monkeypatch):
    path, rig = sensor_bags.record(tmp_path / "a.mcap"), sensor_bags.sensor_rig()
    messages = recorded(path)
    sensors, _ = taken([one for one in messages if one[0] != "/points"], rig, cameras=True)
    other, tries, ended = threading.Thread(target=sensors.settle), threading.Event(), threading.Event()

    def no_camera(*_):
        if threading.current_thread() is other:
            tries.set()
            ended.wait(1.0)
        raise LogError("images without calibration")

    def lidar(*_):
        if threading.current_thread() is not other:
            other.start()
            tries.wait(0.5)

    monkeypatch.setattr("offpiste.live.sensor_messages.camera_of", no_camera)
    monkeypatch.setattr("offpiste.live.sensor_messages.lidar_of", lidar)
    sensors.take("/points", next(message for topic, message in messages if topic == "/points"), 0.0)
    ended.set()
    other.join()
    assert sensors.sensors is None
    assert "without calibration" in sensors.waiting_for


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
