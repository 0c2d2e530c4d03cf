"""Readings, images and scans from messages: complete, reduced, and invalid ones."""

from types import SimpleNamespace

import numpy as np
import pytest

import sensor_bags
from live.synthetic_robot import EARTH, RIG, START, cloud, odometry, planner, rig, small_settings, tree, write_course
from offpiste.closed_loop.lockstep import reading_of
from offpiste.core.conventions import ACTUATORS
from offpiste.core.errors import RigError
from offpiste.core.geometry import local_from_geographic
from offpiste.live.reception import CourseRequest, Reception
from offpiste.live.replay import StepDriver
from offpiste.live.robot_messages import SensorMessages, VehicleMessages
from offpiste.logs import open_log
from offpiste.logs.measurements import Cloud
from offpiste.logs.ros.writer import floats, header, make, quaternion, vector
from offpiste.rig.rig import load_rig, parse_rig, rig_text
from offpiste.simulation.messages import stamp_ns, vehicle_messages
from offpiste.transport.message_types import MessageTypes
from synthetic_drive import samples

NOW = START / 1e9
STEER = ACTUATORS.index("steer")


def simulated(sample):
    return vehicle_messages(sample, stamp_ns(sample.time), wheel_radius=0.359)


def test_readings_are_those_of_the_simulator():
    vehicle = VehicleMessages(load_rig("proving_ground"))
    for sample in samples(0.5)[5:20]:
        messages = simulated(sample)
        odom = messages.pop("/odometry")
        for topic, message in messages.items():
            assert vehicle.take(topic, message, 0.0) is None
        reading, expected = vehicle.take("/odometry", odom, 0.0), reading_of(sample)
        for name in ("position", "orientation", "velocity", "actuators", "yaw_rate", "time"):
            np.testing.assert_allclose(getattr(reading, name), getattr(expected, name), atol=1e-6, err_msg=name)
        np.testing.assert_allclose(vehicle.given(reading.time).control, sample.command[:3], atol=1e-6)
    assert not vehicle.dropped


def test_velocities_that_are_not_measured_come_from_poses():
    parts = RIG.split("[channels.linear_velocity]")
    vehicle = VehicleMessages(parse_rig(parts[0] + "[lidars" + parts[1].split("[lidars")[1], where="test"))
    readings = []
    for t in np.arange(0.0, 0.4, 0.02):
        message, half = odometry(t, 3.0 * t, 99.0), 0.5 * (2.97 + 0.5 * t)  # the yaw passes pi at last
        message.pose.pose.orientation = quaternion((0.0, 0.0, np.sin(half), np.cos(half)))
        readings.append(vehicle.take("/odom", message, NOW))
    assert readings[0] is None, "the speed is still unknown"
    np.testing.assert_allclose(readings[-1].velocity, (3.0, 0.0, 0.0), atol=1e-6)
    assert readings[-1].yaw_rate == pytest.approx(0.5, abs=1e-6)


def test_values_that_are_not_finite_are_dropped_and_old_ones_do_not_count():
    vehicle = VehicleMessages(rig())
    assert vehicle.take("/odom", odometry(0.0, 1.0), NOW).position[0] == 1.0
    bad = odometry(0.02, 2.0)
    bad.pose.pose.position.x = np.nan
    assert vehicle.take("/odom", bad, NOW).time == NOW, "the previous reading, whose stamp repeats"
    assert vehicle.dropped == {"position: not finite or not valid": 1}
    still = odometry(1.0, 2.0)
    still.pose.pose.orientation.w = np.nan
    assert vehicle.take("/odom", still, NOW) is None, "the heading is a second old"
    assert vehicle.given(NOW + 1) == (None, None), "the rig has no channels of commands"
    vehicle.take("/odom", odometry(5.0, 10.0), NOW)
    assert vehicle.take("/odom", odometry(2.0, 2.0), NOW).position[0] == 2.0, "the clock went back"


@pytest.mark.parametrize("silent", ["hold", "on change"])
def test_a_command_that_is_published_on_change_stays_valid(silent):
    text = rig_text("proving_ground").replace('interpolation = "hold"', f'interpolation = "{silent}"')
    vehicle, sample = VehicleMessages(parse_rig(text, where="test")), samples(0.5)[5]
    for topic, message in simulated(sample).items():
        vehicle.take(topic, message, 0.0)
    given = vehicle.given(sample.time + 30.0).control
    assert given is None if silent == "hold" else given == pytest.approx(sample.command[:3], abs=1e-6)


@pytest.mark.parametrize(("silent", "rate"), [("on change", 0.0), ("linear", np.nan)])
def test_the_rate_of_a_silent_steering_is_zero_only_if_it_is_published_on_change(silent, rate):
    before, _, behind = rig_text("proving_ground").partition("[channels.steer_rate]")
    text = before + behind[behind.index("\n[") :]
    text = text.replace("[channels.steer_angle]", f'[channels.steer_angle]\ninterpolation = "{silent}"')
    vehicle, readings = VehicleMessages(parse_rig(text, where="test")), []
    for sample in samples(2.5):
        for topic, message in simulated(sample).items():
            if topic != "/steering" or sample.time < 1.0:
                readings.append(vehicle.take(topic, message, 0.0))
    last = [reading for reading in readings if reading is not None][-1]
    np.testing.assert_allclose(last.actuators[ACTUATORS.index("steer_rate")], rate, atol=1e-6)


def test_a_commanded_turn_rate_is_converted_to_steering():
    command = '[channels.throttle]\ntopic = "/cmd_vel"\nfields = ["linear.x"]\nscale = 0.25\n'
    command += '[channels.steer]\ntopic = "/cmd_vel"\nfields = ["angular.z", "linear.x"]\nunit = "rad/s"\n'
    vehicle = VehicleMessages(rig(command))
    twist = make("geometry_msgs/Twist", linear=vector((2.0, 0.0, 0.0)), angular=vector((0.0, 0.0, 0.3)))
    assert vehicle.take("/cmd_vel", twist, NOW) is None
    assert vehicle.given(NOW).control.tolist() == [0.5, 0.0, pytest.approx(np.arctan(0.3 * 2.06 / 2.0) / 0.5)]


def test_the_gear_is_read_if_the_rig_has_one():
    vehicle = VehicleMessages(load_rig("proving_ground_gear"))
    assert vehicle.given(NOW).gear is None
    vehicle.take("/gear", make("std_msgs/Int8", data=-1), NOW)
    assert vehicle.given(NOW) == (None, -1.0)


def test_latitude_and_longitude_are_metres_from_the_origin_of_the_rig():
    vehicle = VehicleMessages(parse_rig(EARTH, where="test"))
    message = odometry(0.0, 48.001)
    message.pose.pose.position.y = 11.0
    message.header.frame_id = "antenna"
    reading = vehicle.take("/odom", message, NOW)
    north = local_from_geographic(np.array([[48.001, 11.0]]), (48.0, 11.0))[0, 1]
    np.testing.assert_allclose(reading.position[:2], (0.0, north), atol=1e-9)
    assert vehicle.frame == "", "the antenna is not the frame of the poses"
    assert vehicle.take("/odom", odometry(0.02, 0.0), NOW + 0.02).position[1] == reading.position[1], "0, 0: no fix yet"
    vehicle.take("/odom", odometry(0.04, 8.0), NOW + 0.04)
    assert any("km from the places" in why for why in vehicle.dropped)


ALIGNMENT = '[alignment]\ntopics = ["/odom"]\nspeed = { fields = ["x"] }\n'


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("[channels.position]\n", '[channels.position]\nunit = "lat lon"\n', "needs an origin"),
        ("[lidars.lidar]", f"{ALIGNMENT}[lidars.lidar]", "complete logs"),
        ('[channels.position]\ntopic = "/odom"', '[channels.position]\ntopic = "/tf odom -> base_link"', "logs only"),
    ],
)
def test_rigs_that_need_complete_logs_are_refused(old, new, what):
    with pytest.raises(RigError, match=what):
        VehicleMessages(parse_rig(RIG.replace(old, new), where="test"))


def test_joints_are_found_by_their_names():
    channel = '[channels.steer_angle]\ntopic = "/joints"\nfields = ["position[1]"]\njoints = ["steer"]\n'
    vehicle, steer, empty = VehicleMessages(rig(channel)), [], floats([])
    for k, values in enumerate(({"wheel": 7.0, "steer": 0.1}, {"steer": 0.2, "wheel": 8.0}, {"mast": 5.0, "arm": 6.0})):
        head, position = header(START + 20_000_000 * k, ""), floats(list(values.values()))
        joints = {"name": list(values), "position": position, "velocity": empty, "effort": empty}
        vehicle.take("/joints", make("sensor_msgs/JointState", header=head, **joints), NOW)
        steer.append(vehicle.take("/odom", odometry(0.02 * k), NOW).actuators[STEER])
    assert steer == [0.1, 0.2, 0.2], "the last message is another publisher's"
    assert not vehicle.dropped


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    return sensor_bags.record(tmp_path_factory.mktemp("bag") / "a.mcap")


def recorded(path):
    """Messages of a log in the order of its topics: transforms and calibrations first."""
    log = open_log(path)
    order = sorted(log.topics, key=lambda topic: topic not in ("/tf_static", "/info"))
    return [(topic, message) for topic in order for _, message in log.messages(topic)]


def taken(messages, vehicle, **options):
    sensors = SensorMessages(vehicle, **options)
    return sensors, [sensors.take(topic, message, 0.0) for topic, message in messages]


def first(messages, wanted):
    return next(message for topic, message in messages if topic == wanted)


def test_sensors_images_and_scans_are_those_of_the_log(bag):
    log = sensor_bags.opened(bag)
    sensors, found = taken(recorded(bag), sensor_bags.sensor_rig(), cameras=True)
    cameras, lidars = sensors.sensors
    assert sensors.waiting_for == ""
    np.testing.assert_array_equal(cameras["front"].body_from_camera, log.cameras["front"].body_from_camera)
    np.testing.assert_array_equal(lidars["top"].body_from_lidar, log.lidars["top"].body_from_lidar)
    expected = {(type(m), m.time): m for m in log.stream()}
    found = [m for m in found if m is not None]
    assert len(found) >= len(expected) - 2, "the first of each sets up the sensors"
    for measured in found:
        same = expected[type(measured), measured.time]
        for name in ("pixels", "points", "offset"):
            if hasattr(same, name):
                np.testing.assert_array_equal(getattr(measured, name), getattr(same, name))


def test_missing_calibrations_and_silent_sensors_are_named(bag):
    vehicle = sensor_bags.sensor_rig()
    without = [(topic, message) for topic, message in recorded(bag) if topic != "/tf_static"]
    sensors, found = taken(without, vehicle, cameras=True)
    assert found == [None] * len(found)
    assert "no fixed transform joins" in sensors.waiting_for
    assert SensorMessages(vehicle, cameras=True).waiting_for == "messages on /image, /points"
    assert SensorMessages(vehicle, cameras=False).topics == ("/points", "/tf_static")


def test_silent_optional_sensors_are_left_out(bag):
    messages = recorded(bag)
    vehicle = sensor_bags.sensor_rig(sensor_bags.SENSORS + '[lidars.rear]\ntopic = "/rear"\noptional = true\n')
    sensors, _ = taken(messages, vehicle, cameras=False)
    assert sensors.waiting_for == "messages on /rear"
    sensors.settle()
    assert (list(sensors.sensors[1]), sensors.left_out) == (["top"], [])
    assert [sensors.take("/rear", first(messages, "/points"), 0.0) for _ in range(2)] == [None, None]
    assert sensors.left_out == ["rear"], "named once it is heard"


def hostile():
    """Messages of other types, empty ones, and some whose fields do not fit together."""
    types = MessageTypes()
    kinds = ("std_msgs/msg/String", "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Image", "tf2_msgs/msg/TFMessage",
             "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/CompressedImage", "nav_msgs/msg/Odometry",
             "nav_msgs/msg/Path", "geometry_msgs/msg/TransformStamped", "std_msgs/msg/Float64MultiArray")  # fmt: skip
    short, odd, spoiled = cloud(0.0), cloud(0.0), tree()
    short.data, short.width = short.data[:7], 1 << 31
    odd.fields, odd.point_step = odd.fields[:1], 0
    no_stamp, info = types.empty("sensor_msgs/msg/Image"), types.empty("sensor_msgs/msg/CameraInfo")
    no_stamp.header = SimpleNamespace(stamp="now", frame_id=None)
    info.width = info.height = 4
    info.distortion_model, info.d, info.k = "", np.full(3, np.nan), np.full(9, np.nan)
    spoiled.transforms[0].transform.rotation.w = np.nan
    return [*map(types.empty, kinds), short, odd, no_stamp, info, spoiled, object()]


def test_good_messages_are_used_after_any_wrong_ones(tmp_path):
    eye = '[cameras.eye]\ntopic = "/image"\ninfo = "/camera_info"\n'
    for topic in ("/points", "/image", "/camera_info", "/tf_static"):
        sensors = SensorMessages(rig(eye), cameras=True)
        for message in hostile():
            assert sensors.take(topic, message, 0.0) is None
            assert sensors.waiting_for
    sensors = SensorMessages(rig(), cameras=False)
    for topic in ("/points", "/tf_static"):
        for message in hostile():
            sensors.take(topic, message, 0.0)
    assert sensors.dropped
    sensors.take("/tf_static", tree(), 0.0)
    sensors.take("/points", cloud(0.0), 0.0)
    assert sensors.waiting_for == ""
    for message in hostile():
        sensors.take("/points", message, 0.0)
    assert isinstance(sensors.take("/points", cloud(0.1), 0.0), Cloud)
    reception = Reception(rig(), CourseRequest(topic="/course"), cameras=False)
    for message in hostile():
        assert reception.take("/course", message, 0.0) == []
    assert len(reception.refusals) == 3, "the last ones"
    reception = Reception(rig(), CourseRequest(write_course(tmp_path)), cameras=False)
    driver, good = StepDriver(rig(), planner(), reception, small_settings()), ("/odom", odometry(0.0, 1.0))
    driver.step([*(("/odom", message) for message in hostile()), good], 0.0)
    assert reception.vehicle.dropped["/odom: its header has no stamp"] == 1
    assert reception.vehicle._kept["position"][-1][1][0] == 1.0
