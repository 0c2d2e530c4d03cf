"""Messages of wrong types and with wrong fields: refused and counted, and those that come after them are used."""

import math
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from live.made_up_robot import RIG, cloud, odometry, planner, rig, small_settings, tree, write_course
from live.test_doctor import errors, found
from offpiste.live import doctor
from offpiste.live.driver import Heard, StepDriver
from offpiste.live.reception import CourseRequest, Reception
from offpiste.live.sensor_messages import SensorMessages
from offpiste.live.vehicle_messages import VehicleMessages
from offpiste.logs.measurements import Cloud
from offpiste.rig.rig import parse_rig
from offpiste.transport.message_types import MessageTypes
from offpiste.transport.tally import MOST, OTHERS, Tally

CAMERA = """
[cameras.eye]
topic = "/image"
info = "/camera_info"
"""
TOPICS = ("/points", "/image", "/camera_info", "/tf_static")


def hostile(topic):
    """Messages of other types, empty ones, and some whose fields do not fit together."""
    types = MessageTypes()
    kinds = ("std_msgs/msg/String", "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Image", "tf2_msgs/msg/TFMessage",
             "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/CompressedImage", "nav_msgs/msg/Odometry",
             "nav_msgs/msg/Path", "geometry_msgs/msg/TransformStamped", "std_msgs/msg/Float64MultiArray")  # fmt: skip
    found = [types.empty(kind) for kind in kinds]
    short = cloud(0.0)
    short.data, short.width = short.data[:7], 1 << 31
    odd = cloud(0.0)
    odd.fields, odd.point_step = odd.fields[:1], 0
    no_stamp = types.empty("sensor_msgs/msg/Image")
    no_stamp.header = SimpleNamespace(stamp="now", frame_id=None)
    info = types.empty("sensor_msgs/msg/CameraInfo")
    info.width = info.height = 4
    info.distortion_model, info.d, info.k = "", np.full(3, np.nan), np.full(9, np.nan)
    spoiled = tree()
    spoiled.transforms[0].transform.rotation.w = np.nan
    return [*found, short, odd, no_stamp, info, spoiled, object()]


def test_no_message_ends_the_thread_of_sensors_and_good_ones_are_used_after():
    for topic in TOPICS:
        sensors = SensorMessages(parse_rig(RIG + CAMERA, where="test"), cameras=True)
        for message in hostile(topic):
            assert sensors.take(topic, message, 0.0) is None
            assert sensors.waiting_for
    sensors = SensorMessages(rig(), cameras=False)
    for topic in ("/points", "/tf_static"):
        for message in hostile(topic):
            sensors.take(topic, message, 0.0)
    assert sensors.dropped
    sensors.take("/tf_static", tree(), 0.0)
    sensors.take("/points", cloud(0.0), 0.0)
    assert sensors.waiting_for == ""
    for message in hostile("/points"):
        sensors.take("/points", message, 0.0)
    assert isinstance(sensors.take("/points", cloud(0.1), 0.0), Cloud)


def test_no_message_ends_the_reading_of_the_vehicle():
    vehicle = VehicleMessages(rig())
    for message in hostile("/odom"):
        vehicle.take("/odom", message, 0.0)
    assert vehicle.dropped["/odom: its header has no stamp"] == 1
    assert vehicle.take("/odom", odometry(0.0, 1.0), 0.0).position[0] == 1.0


def test_a_course_of_a_wrong_kind_is_refused_and_the_last_is_kept(tmp_path):
    reception = Reception(rig(), CourseRequest(topic="/course"), cameras=False)
    assert reception.type_of("/course") == "nav_msgs/msg/Path"
    assert reception.type_of("/tf_static") == "tf2_msgs/msg/TFMessage"
    for message in hostile("/course"):
        assert reception.take("/course", message, 0.0) == []
    assert reception.course is None
    assert len(reception.refusals) == 3, "the last ones"
    assert Reception(rig(), CourseRequest(write_course(tmp_path)), cameras=False).course is not None


def test_no_message_ends_a_step(tmp_path):
    reception = Reception(rig(), CourseRequest(write_course(tmp_path)), cameras=False)
    driver = StepDriver(rig(), planner(), reception, small_settings())
    good = Heard("/odom", odometry(0.0, 1.0), 0.0)
    driver.step([*(Heard("/odom", message, 0.0) for message in hostile("/odom")), good], 0.0)
    assert reception.vehicle.dropped["/odom: its header has no stamp"] == 1
    assert reception.vehicle.frame == good.message.header.frame_id, "the last one was taken"


def test_the_doctor_says_that_headers_have_no_stamp(tmp_path, monkeypatch):
    monkeypatch.setattr(doctor, "heard_at", lambda *given: math.nan)
    assert any("/odom: nav_msgs/msg/Odometry, " in what and "its header has no stamp" in what
               for what in errors(found(tmp_path)))  # fmt: skip


@pytest.mark.parametrize("kind", ["std_msgs/msg/String", "sensor_msgs/msg/Image"])
def test_the_doctor_names_what_is_of_another_kind(tmp_path, kind):
    def publish(network):
        network.session().publisher("/points", kind)(MessageTypes().empty(kind))

    def soon(network):
        threading.Timer(0.3, publish, [network]).start()

    said = found(tmp_path, before=soon)
    assert any("lidar" in what for what in errors(said)), said


def test_reasons_are_counted_in_a_bounded_number():
    tally = Tally()
    for number in range(10 * MOST):
        tally[f"type {number}"] += 1
    tally["type 0"] += 1
    assert len(tally) == MOST + 1
    assert tally["type 0"] == 2
    assert tally[OTHERS] == 9 * MOST
