"""Readings from messages: as the simulator makes them, and from what there is where a robot measures less."""

import numpy as np
import pytest

from live.made_up_robot import RIG, START, odometry, rig
from offpiste.closed_loop.lockstep import reading_of
from offpiste.core.conventions import ACTUATORS
from offpiste.core.errors import RigError
from offpiste.core.geometry import local_from_geographic
from offpiste.live.vehicle_messages import VehicleMessages
from offpiste.logs.ros.writer import floats, header, make, vector
from offpiste.rig.rig import load_rig, parse_rig, rig_text
from offpiste.simulation.messages import stamp_ns, vehicle_messages
from synthetic_drive import samples

NOW = START / 1e9


def test_readings_are_those_of_the_simulator():
    vehicle = VehicleMessages(load_rig("proving_ground"))
    assert vehicle.position_topic == "/odometry"
    for sample in samples(0.5)[5:20]:
        messages = vehicle_messages(sample, stamp_ns(sample.time), wheel_radius=0.359)
        odom = messages.pop("/odometry")
        for topic, message in messages.items():
            assert vehicle.take(topic, message, 0.0) is None
        reading, expected = vehicle.take("/odometry", odom, 0.0), reading_of(sample)
        for name in ("position", "orientation", "velocity", "actuators"):
            np.testing.assert_allclose(getattr(reading, name), getattr(expected, name), atol=1e-6, err_msg=name)
        assert reading.yaw_rate == pytest.approx(expected.yaw_rate)
        assert reading.time == pytest.approx(expected.time, abs=1e-6)
        np.testing.assert_allclose(vehicle.given(reading.time).control, sample.command[:3], atol=1e-6)
    assert not vehicle.dropped


def test_velocities_that_are_not_measured_come_from_poses():
    parts = RIG.split("[channels.linear_velocity]")
    vehicle = VehicleMessages(parse_rig(parts[0] + "[lidars" + parts[1].split("[lidars")[1], where="test"))
    readings = [vehicle.take("/odom", odometry(t, 3.0 * t, 99.0), NOW) for t in np.arange(0.0, 0.4, 0.02)]
    assert readings[0] is None, "there is no speed yet"
    np.testing.assert_allclose(readings[-1].velocity, (3.0, 0.0, 0.0), atol=1e-6)
    assert readings[-1].yaw_rate == pytest.approx(0.0, abs=1e-9)


def test_what_is_not_finite_is_dropped_and_what_is_old_does_not_count():
    vehicle = VehicleMessages(rig())
    assert vehicle.take("/odom", odometry(0.0, 1.0), NOW).position[0] == 1.0
    bad = odometry(0.02, 2.0)
    bad.pose.pose.position.x = np.nan
    assert vehicle.take("/odom", bad, NOW).time == NOW, "the reading before, whose stamp repeats"
    assert vehicle.dropped == {"position: not finite or not valid": 1}
    still = odometry(1.0, 2.0)
    still.pose.pose.orientation.w = np.nan
    assert vehicle.take("/odom", still, NOW) is None, "the heading is a second old"
    assert vehicle.given(NOW + 1) == (None, None), "the rig has no channels of commands"


def test_a_command_that_is_published_on_change_does_not_grow_old():
    text = rig_text("proving_ground")
    steady, changing = (
        VehicleMessages(parse_rig(each, where="test"))
        for each in (text, text.replace('interpolation = "hold"', 'interpolation = "on change"'))
    )
    sample = samples(0.5)[5]
    for vehicle in (steady, changing):
        for topic, message in vehicle_messages(sample, stamp_ns(sample.time), wheel_radius=0.359).items():
            vehicle.take(topic, message, 0.0)
    later = sample.time + 30.0
    assert steady.given(later).control is None
    np.testing.assert_allclose(changing.given(later).control, sample.command[:3], atol=1e-6)


@pytest.mark.parametrize(("silent", "rate"), [("on change", 0.0), ("linear", np.nan)])
def test_the_rate_of_a_wheel_that_is_held_still_and_silent_is_zero(silent, rate):
    before, _, behind = rig_text("proving_ground").partition("[channels.steer_rate]")
    text = before + behind[behind.index("\n[") :]
    text = text.replace("[channels.steer_angle]", f'[channels.steer_angle]\ninterpolation = "{silent}"')
    vehicle = VehicleMessages(parse_rig(text, where="test"))
    readings = []
    for sample in samples(3.0):
        messages = vehicle_messages(sample, stamp_ns(sample.time), wheel_radius=0.359)
        for topic, message in messages.items():
            if topic != "/steering" or sample.time < 1.0:  # then it is silent
                reading = vehicle.take(topic, message, 0.0)
                readings += [] if reading is None else [reading]
    np.testing.assert_allclose(readings[-1].actuators[ACTUATORS.index("steer_rate")], rate, atol=1e-6)


def test_a_message_of_another_shape_is_counted():
    vehicle = VehicleMessages(rig())
    assert vehicle.take("/odom", object(), NOW) is None
    assert sum(vehicle.dropped.values()) == 4


def test_what_has_no_stamp_of_its_own_waits_for_the_robots_clock():
    text = RIG.replace('"steer_angle", ', "").replace(
        "[lidars", '[channels.steer_angle]\ntopic = "/steer"\nfields = ["data"]\n[lidars'
    )
    vehicle = VehicleMessages(parse_rig(text, where="test"))
    steering = make("std_msgs/Float64", data=0.1)
    assert vehicle.take("/steer", steering, -np.inf) is None
    assert vehicle.dropped == {"/steer: without a stamp of its own, and the robot's clock is not known yet": 1}
    reading = vehicle.take("/odom", odometry(0.0), -np.inf)
    assert reading.time == NOW, "it has a stamp"
    assert np.isnan(reading.actuators[ACTUATORS.index("steer")])
    vehicle.take("/steer", steering, NOW + 0.02)
    assert vehicle.take("/odom", odometry(0.02), -np.inf).actuators[ACTUATORS.index("steer")] == 0.1


def test_a_clock_that_goes_back_forgets_what_was_before():
    vehicle = VehicleMessages(rig())
    vehicle.take("/odom", odometry(5.0, 10.0), NOW)
    assert vehicle.take("/odom", odometry(1.0, 2.0), NOW).position[0] == 2.0


def test_a_turn_rate_that_is_commanded_is_a_steering():
    command = '[channels.throttle]\ntopic = "/cmd_vel"\nfields = ["linear.x"]\nscale = 0.25\n'
    command += '[channels.steer]\ntopic = "/cmd_vel"\nfields = ["angular.z", "linear.x"]\nunit = "rad/s"\n'
    text = RIG.replace('absent = ["throttle", "brake", "steer", ', 'absent = ["brake", ').replace(
        "[lidars", command + "[lidars"
    )
    vehicle = VehicleMessages(parse_rig(text, where="test"))
    twist = make("geometry_msgs/Twist", linear=vector((2.0, 0.0, 0.0)), angular=vector((0.0, 0.0, 0.3)))
    assert vehicle.take("/cmd_vel", twist, NOW) is None
    throttle, brake, steer = vehicle.given(NOW).control
    assert (throttle, brake) == (0.5, 0.0)
    assert steer == pytest.approx(np.arctan(0.3 * 2.06 / 2.0) / 0.5)


def test_the_gear_is_heard_where_the_rig_has_one():
    vehicle = VehicleMessages(load_rig("proving_ground_gear"))
    assert "/gear" in vehicle.topics
    assert vehicle.given(NOW).gear is None, "nothing was heard of it yet"
    vehicle.take("/gear", make("std_msgs/Int8", data=-1), NOW)
    assert vehicle.given(NOW) == (None, -1.0)


def test_latitude_and_longitude_are_metres_from_the_origin_of_the_rig():
    entry = '[channels.position]\nunit = "lat lon"\norigin = [48.0, 11.0]\n'
    vehicle = VehicleMessages(parse_rig(RIG.replace("[channels.position]\n", entry), where="test"))
    message = odometry(0.0, 48.001)
    message.pose.pose.position.y = 11.0
    message.header.frame_id = "antenna"
    reading = vehicle.take("/odom", message, NOW)
    north = local_from_geographic(np.array([[48.001, 11.0]]), (48.0, 11.0))[0, 1]
    np.testing.assert_allclose(reading.position[:2], (0.0, north), atol=1e-9)
    assert vehicle.frame == "", "the antenna is not the frame of the poses"
    message = odometry(0.02, 0.0)
    assert vehicle.take("/odom", message, NOW + 0.02).position[1] == reading.position[1], "0, 0 is no place yet"
    message = odometry(0.04, 8.0)
    vehicle.take("/odom", message, NOW + 0.04)
    assert any("km from the places" in why for why in vehicle.dropped)


ALIGNMENT = '[alignment]\ntopics = ["/odom"]\nspeed = { fields = ["x"] }\n'


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("[channels.position]\n", '[channels.position]\nunit = "lat lon"\n', "need an origin"),
        ("[lidars.lidar]", f"{ALIGNMENT}[lidars.lidar]", "whole logs"),
        ('[channels.position]\ntopic = "/odom"', '[channels.position]\ntopic = "/tf odom -> base_link"', "logs only"),
    ],
)
def test_what_only_whole_logs_allow_is_refused(old, new, what):
    with pytest.raises(RigError, match=what):
        VehicleMessages(parse_rig(RIG.replace(old, new), where="test"))


def joints(seconds: float, **values: float):
    """Joint states in this order, stamped as `odometry` is."""
    empty, at = floats([]), round((NOW + seconds) * 1e9)
    return make(
        "sensor_msgs/JointState", header=header(at, ""), name=list(values), position=floats(list(values.values())),
        velocity=empty, effort=empty,
    )  # fmt: skip


def test_joints_are_found_by_their_names():
    text = RIG.replace('"steer_angle", ', "").replace(
        "[lidars",
        '[channels.steer_angle]\ntopic = "/joints"\nfields = ["position[1]"]\njoints = ["steer"]\n[lidars',
    )
    vehicle = VehicleMessages(parse_rig(text, where="test"))
    steer = []
    for k, message in enumerate(
        ({"wheel": 7.0, "steer": 0.1}, {"steer": 0.2, "wheel": 8.0}, {"mast": 5.0, "arm": 6.0})
    ):
        vehicle.take("/joints", joints(0.02 * k, **message), NOW)
        steer.append(vehicle.take("/odom", odometry(0.02 * k), NOW).actuators[ACTUATORS.index("steer")])
    assert steer == [0.1, 0.2, 0.2], "the last message is another publisher's"
    assert not vehicle.dropped
