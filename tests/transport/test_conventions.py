"""Keys, hashes and definitions against hand-worked ones and those of zenoh-ros2-sdk, and counts of refused messages."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from zenoh_ros2_sdk import attachment as sdk_attachment
from zenoh_ros2_sdk import keyexpr
from zenoh_ros2_sdk.entity import EndpointEntity, EntityKind, NodeEntity
from zenoh_ros2_sdk.qos import QosDurability, QosProfile

from offpiste.core.errors import TransportError
from offpiste.transport.keys import (
    Address,
    Attachment,
    BridgeKeys,
    RmwZenohKeys,
    attachment_of,
    dds_type,
    ros_type,
)
from offpiste.transport.message_types import MessageTypes
from offpiste.transport.received import MOST, OTHERS, Tally

HASH = "RIHS01_" + "0" * 64
TOPIC = Address("/camera/image", "sensor_msgs/msg/Image", HASH)
NAME = st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True)


def test_a_key_of_rmw_zenoh_is_domain_topic_type_and_hash():
    keys = RmwZenohKeys(7)
    assert keys.publication(TOPIC) == f"7/camera/image/sensor_msgs::msg::dds_::Image_/{HASH}"
    assert keys.subscription("/camera/image") == "7/camera/image/*/*"
    assert keys.parsed(keys.publication(TOPIC)) == TOPIC
    assert keys.parsed(RmwZenohKeys(8).publication(TOPIC)) is None
    assert keys.parsed("7/short") is None


@given(parts=st.lists(NAME, min_size=1, max_size=4), package=NAME, name=st.from_regex("[A-Z][a-z]+", fullmatch=True))
def test_keys_and_tokens_are_parsed_back(parts, package, name):
    address = Address("/" + "/".join(parts), f"{package}/msg/{name}", HASH)
    keys = RmwZenohKeys(0)
    assert keys.parsed(keys.publication(address)) == address
    assert ros_type(dds_type(address.type)) == address.type
    token = keys.tokens("abc", "node", 3, address, publishes=True)[1]
    assert keys.announced(token) == address


@pytest.mark.parametrize("publishes", [True, False])
@pytest.mark.parametrize("keep", [True, False])
def test_keys_and_tokens_are_those_of_another_implementation(publishes, keep):
    node = NodeEntity(domain_id=2, session_id="a1b2", node_id=0, node_name="offpiste", namespace="/")
    durability = QosDurability.TRANSIENT_LOCAL if keep else QosDurability.VOLATILE
    quality = QosProfile(durability=durability, history_depth=1 if keep else 10).encode()
    theirs = EndpointEntity(
        node=node, entity_id=5, kind=EntityKind.PUBLISHER if publishes else EntityKind.SUBSCRIPTION, name="/a/b",
        dds_type_name="std_msgs::msg::dds_::String_", type_hash=HASH, qos=quality, gid=b"",
    )  # fmt: skip
    address = Address("/a/b", "std_msgs/msg/String", HASH)
    ours = RmwZenohKeys(2).tokens("a1b2", "offpiste", 5, address, publishes=publishes, keep=keep)
    assert ours == [keyexpr.node_liveliness_keyexpr(node), keyexpr.endpoint_liveliness_keyexpr(theirs)]
    key = RmwZenohKeys(2).publication(address)
    assert key == keyexpr.topic_keyexpr(2, "/a/b", "std_msgs::msg::dds_::String_", HASH)


def test_a_key_of_the_bridge_is_the_topic():
    assert BridgeKeys().publication(TOPIC) == "camera/image"
    assert BridgeKeys("/robot1").subscription("/camera/image") == "robot1/camera/image"
    assert BridgeKeys("robot1").parsed("robot1/camera/image") == Address("/camera/image")
    assert BridgeKeys("robot1").parsed("robot2/camera/image") is None
    token = "@/1f/@ros2_lv/MP/camera§image/sensor_msgs§msg§Image/::,10:"
    assert BridgeKeys().announced(token) == Address("/camera/image", "sensor_msgs/msg/Image")


def test_an_attachment_is_that_of_another_implementation():
    ours = Attachment(42, 1_700_000_000_000_000_001, bytes(range(16)))
    assert len(ours.packed()) == 33
    assert ours.packed() == sdk_attachment.Attachment(*ours).to_bytes()
    assert attachment_of(ours.packed()) == ours
    for data in (None, b"", ours.packed()[:-1], ours.packed()[:16] + b"\x0f" + bytes(16)):  # last: another length
        assert attachment_of(data) == (-1, 0, b"")


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
        ("my_msgs/msg/Wheels.msg", "float32 [", "not a message definition"),
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
