"""Where the numbers of a message lie, checked against the plain decoder."""

from offpiste.logs.ros.message_layout import layout
from offpiste.logs.ros.writer import floats, header, make, message_types
from sensor_bags import SECOND


def test_a_layout_is_checked_against_the_decoder():
    store = message_types()
    joints = make(
        "sensor_msgs/JointState",
        header=header(SECOND, "base"),
        name=["a", "b"],
        position=floats([1.0, 2.0]),
        velocity=floats([]),
        effort=floats([]),
    )
    raw = bytes(store.serialize_cdr(joints, "sensor_msgs/msg/JointState"))
    found = layout(store, "sensor_msgs/msg/JointState", raw)
    assert found is not None
    assert set(found.fields) == {"position[0]", "position[1]"}
    big_endian = bytes([0, 0]) + raw[2:]
    assert layout(store, "sensor_msgs/msg/JointState", big_endian) is None
    assert layout(store, "sensor_msgs/msg/JointState", raw[:20]) is None
