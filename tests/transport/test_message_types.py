"""Types, their hashes and definitions, also of types that rosbags does not know."""

from pathlib import Path

import numpy as np
import pytest

from offpiste.core.errors import TransportError
from offpiste.transport.message_types import MessageTypes

STRING = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
"""Hash of std_msgs/msg/String as ROS 2 has it (`ros2 topic info -v`)."""


def test_hashes_are_those_of_ros():
    assert MessageTypes().hash_of("std_msgs/msg/String") == STRING


def test_types_of_ackermann_and_of_maps_are_known():
    types = MessageTypes()
    for name in ("ackermann_msgs/msg/AckermannDriveStamped", "grid_map_msgs/msg/GridMap"):
        assert name in types
        assert types.hash_of(name).startswith("RIHS01_")
        assert "float" in types.definition(name)


def test_a_definition_of_ones_own_is_read_from_a_file(tmp_path):
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
    assert "my_msgs/msg/Wheels" not in MessageTypes(), "only where it is given"


@pytest.mark.parametrize(
    ("name", "text", "what"),
    [
        ("my_msgs/msg/Wheels.msg", "float32 [", "no message definition"),
        ("my_msgs/msg/Wheels.msg", "Other other", "Other"),
        ("Wheels.msg", "float32 x", "which type"),
    ],
)
def test_a_definition_that_is_wrong_is_named(tmp_path, name, text, what):
    file = tmp_path / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    with pytest.raises(TransportError, match=what) as raised:
        MessageTypes([file])
    assert str(file) in str(raised.value)


def test_an_unknown_type_has_no_hash():
    with pytest.raises(TransportError, match=r"live\.definitions"):
        MessageTypes().hash_of("my_msgs/msg/Wheels")
    with pytest.raises(TransportError, match="no message definition"):
        MessageTypes([Path("/nowhere/my_msgs/msg/Wheels.msg")])
