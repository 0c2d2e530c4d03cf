"""Message types with their hashes and definitions, and counts of refused messages."""

from pathlib import Path

import numpy as np
import pytest

from offpiste.core.errors import TransportError
from offpiste.transport.message_types import MessageTypes
from offpiste.transport.received import MOST, OTHERS, Tally

STRING = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
"""Hash of std_msgs/msg/String in ROS 2 (`ros2 topic info -v`)."""


def test_hashes_are_those_of_ros_also_for_types_that_rosbags_lacks():
    types = MessageTypes()
    assert types.hash_of("std_msgs/msg/String") == STRING
    for name in ("ackermann_msgs/msg/AckermannDriveStamped", "grid_map_msgs/msg/GridMap"):
        assert name in types
        assert types.hash_of(name).startswith("RIHS01_")
        assert "float" in types.definition(name)


def test_a_definition_is_read_from_a_file(tmp_path):
    file = tmp_path / "my_msgs" / "msg" / "Wheels.msg"
    file.parent.mkdir(parents=True)
    file.write_text("std_msgs/Header header\nfloat32[4] speed\nstring[] names\nbool locked\nuint8[] raw\n")
    types = MessageTypes([file])
    empty = types.empty("my_msgs/msg/Wheels")
    np.testing.assert_array_equal(empty.speed, np.zeros(4, np.float32))
    assert empty.header.frame_id == ""
    data = types.store.serialize_cdr(empty, "my_msgs/msg/Wheels", little_endian=True)
    back = types.store.deserialize_cdr(data, "my_msgs/msg/Wheels")
    assert back.locked is False
    assert back.names == []
    assert "my_msgs/msg/Wheels" not in MessageTypes(), "unless its file is given"


@pytest.mark.parametrize(
    ("name", "text", "what"),
    [
        ("my_msgs/msg/Wheels.msg", "float32 [", "no message definition"),
        ("my_msgs/msg/Wheels.msg", "Other other", "Other"),
        ("Wheels.msg", "float32 x", "message type"),
    ],
)
def test_an_invalid_definition_is_named(tmp_path, name, text, what):
    file = tmp_path / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    with pytest.raises(TransportError, match=what) as raised:
        MessageTypes([file])
    assert str(file) in str(raised.value)


def test_an_unknown_type_has_no_hash():
    with pytest.raises(TransportError, match=r"live\.definitions"):
        MessageTypes().hash_of("my_msgs/msg/Wheels")
    with pytest.raises(TransportError, match="a message definition"):
        MessageTypes([Path("/nowhere/my_msgs/msg/Wheels.msg")])


def test_the_number_of_reasons_is_limited():
    tally = Tally()
    for k in range(2 * MOST):
        tally.add(str(k))
    assert tally.snapshot()[OTHERS] == MOST
    assert len(tally) == MOST + 1
