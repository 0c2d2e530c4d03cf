"""Messages of commands, and refusals of outputs that cannot be sent."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from live.synthetic_robot import RIG, rig
from offpiste.core.errors import RigError
from offpiste.live.command_messages import Command, CommandMessages
from offpiste.logs.channel import convert
from offpiste.rig.channels import ChannelSource
from offpiste.rig.outputs import OutputField
from offpiste.rig.rig import parse_rig
from offpiste.runtime.prediction import Prediction
from offpiste.transport.message_types import MessageTypes

TYPES = MessageTypes()
STATES = np.arange(60.0).reshape(10, 6)


def outputs(text):
    return CommandMessages(parse_rig(RIG.split("[outputs")[0] + text, where="test"), TYPES)


def output(msgtype, fields):
    return f'[outputs.a]\ntopic = "/a"\ntype = "{msgtype}"\n[outputs.a.fields]\n{fields}\n'


def test_an_ackermann_command_has_angle_speed_and_stamp():
    command = Command(7.0, np.array((0.5, 0.2, -0.4)), prediction=Prediction(6.8, STATES))
    message = CommandMessages(rig(), TYPES).messages(command)["/drive"]
    assert message.drive.steering_angle == pytest.approx(-0.2), "of 0.5 rad at full lock"
    assert message.drive.acceleration == pytest.approx(0.3)
    assert message.drive.speed == STATES[9, 3], "0.2 s ahead: the prediction's last row, as it ends before"
    assert (message.header.stamp.sec, message.header.frame_id) == (7, "base_link")
    stopping = CommandMessages(rig(), TYPES).messages(Command(7.0, np.array((0.0, 0.5, 0.1))))["/drive"]
    assert stopping.drive.speed == 0.0


def test_speed_and_yaw_rate_are_predicted():
    twist = '"linear.x" = { of = "speed", ahead = 0.1, unit = "km/h" }\n"angular.z" = { of = "yaw_rate", ahead = 0.0 }'
    made = outputs(output("geometry_msgs/msg/Twist", twist))
    message = made.messages(Command(1.0, np.zeros(3), prediction=Prediction(0.96, STATES)))["/a"]
    assert message.linear.x == pytest.approx(3.6 * STATES[6, 3]), "0.14 s after its start: the 7th step"
    assert message.angular.z == STATES[1, 5]


@pytest.mark.parametrize("direction", [1, -1])
def test_speed_and_yaw_rate_are_limited(direction):
    twist = output("geometry_msgs/msg/Twist", '"linear.x" = { of = "speed" }\n"angular.z" = { of = "yaw_rate" }\n')
    planned = Prediction(1.0, direction * np.tile((0.0, 0, 0, 8.0, 0, 3.0), (50, 1)))
    for limit, speed, yaw_rate in (("speed = 4.0", 4.0, 1.5), ("yaw_rate = 0.7", 8.0, 0.7)):  # on the same curve
        made = outputs(f"{twist}[live.limits]\n{limit}")
        message = made.messages(Command(1.0, np.zeros(3), prediction=planned))["/a"]
        assert message.linear.x == pytest.approx(direction * speed)
        assert message.angular.z == pytest.approx(direction * yaw_rate)


def test_arrays_numbers_and_constants():
    joy = '"axes[3]" = { of = "steer", sign = -1 }\n"buttons[1]" = { of = "constant", value = 1 }'
    message = outputs(output("sensor_msgs/msg/Joy", joy)).messages(Command(1.0, np.array((0, 0, 0.25))))["/a"]
    assert message.axes.tolist() == [0, 0, 0, -0.25]
    assert message.buttons.tolist() == [0, 1]
    number = outputs(output("std_msgs/msg/Float64", '"data" = { of = "brake", scale = 0.01, clip = [0, 80] }'))
    assert number.messages(Command(1.0, np.array((0, 0.5, 0))))["/a"].data == pytest.approx(50.0)
    assert number.messages(Command(1.0, np.array((0, 1.0, 0))))["/a"].data == 80.0
    switch = outputs(output("std_msgs/msg/Bool", '"data" = { of = "constant", value = 1 }'))
    assert switch.messages(Command(1.0, np.zeros(3)))["/a"].data is True


@given(
    value=st.floats(-1, 1),
    scale=st.floats(0.01, 100),
    offset=st.floats(-5, 5),
    sign=st.sampled_from((-1, 1)),
    unit=st.sampled_from(("", "percent", "rad", "deg")),
)
def test_a_channel_with_the_same_entries_restores_the_command(value, scale, offset, sign, unit):
    given = {"unit": unit, "scale": scale, "offset": offset, "sign": sign}
    sent = OutputField("steer", **given).written(value, 0.5)
    channel = msgspec.convert({"fields": ["x"], **given}, ChannelSource)
    assert convert("steer", channel, np.array([[sent]]), rig().vehicle)[0, 0] == pytest.approx(value, abs=1e-9)


@pytest.mark.parametrize(
    ("msgtype", "fields", "what"),
    [
        ("my_msgs/msg/Drive", '"speed" = { of = "speed" }', "my_msgs/msg/Drive is unknown"),
        ("geometry_msgs/msg/Twist", '"linear.forward" = { of = "speed" }', "forward"),
        ("geometry_msgs/msg/Twist", '"linear" = { of = "speed" }', "linear is not a number"),
        ("geometry_msgs/msg/Twist", '"linear.x[2]" = { of = "speed" }', "x is not a sequence"),
        ("std_msgs/msg/String", '"data" = { of = "speed" }', "data is not a number"),
        ("geometry_msgs/msg/PoseWithCovariance", '"covariance[36]" = { of = "speed" }', "array length"),
    ],
)
def test_missing_fields_are_named(msgtype, fields, what):
    with pytest.raises(RigError, match=what) as raised:
        outputs(output(msgtype, fields))
    assert "outputs.a" in str(raised.value)


@pytest.mark.parametrize("element", [False, True])
@pytest.mark.parametrize(
    ("kind", "refused", "fits"),
    [
        ("UInt8", 'of = "brake", scale = 0.0039', 'of = "brake", scale = 0.004'),
        ("UInt8", 'of = "steer", scale = 0.01', 'of = "steer", scale = 0.01, offset = -1'),
        ("UInt8", 'of = "gear"', 'of = "gear", clip = [0, 1]'),
        ("UInt8", 'of = "constant", value = 300', 'of = "constant", value = 200'),
        ("Int8", 'of = "pedal", scale = 0.005', 'of = "pedal", scale = 0.01'),
        ("Int16", 'of = "speed", scale = 0.001', 'of = "speed", scale = 0.001, clip = [-30000, 30000]'),
        ("Int16", 'of = "yaw_rate", scale = 0.0001', 'of = "yaw_rate", scale = 0.001'),
    ],
)
def test_a_field_that_cannot_hold_every_value_is_refused(kind, refused, fits, element):
    path, msgtype = ("data[1]", f"std_msgs/msg/{kind}MultiArray") if element else ("data", f"std_msgs/msg/{kind}")
    with pytest.raises(RigError, match=r"cannot hold .*scale, offset or clip") as raised:
        outputs(output(msgtype, f'"{path}" = {{ {refused} }}'))
    assert f"'{path}'" in str(raised.value)
    assert "outputs.a" in str(raised.value)
    assert "\n" not in str(raised.value)
    outputs(output(msgtype, f'"{path}" = {{ {fits} }}'))


def test_limits_bound_the_values_of_a_field_and_integers_are_rounded():
    outputs(output("std_msgs/msg/Int16", '"data" = { of = "speed", scale = 0.001 }') + "[live.limits]\nspeed = 20.0\n")
    fields = '"data[0]" = { of = "steer", scale = 0.01 }\n"data[1]" = { of = "brake", scale = 0.01 }'
    made = outputs(output("std_msgs/msg/Int32MultiArray", fields))
    assert made.messages(Command(1.0, np.array((0, 0.297, -0.298))))["/a"].data.tolist() == [-30, 30]
