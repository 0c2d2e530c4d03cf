"""The Foxglove server, as a client of its protocol sees it."""

import json
import struct
from base64 import b64decode
from contextlib import closing

import cv2
import numpy as np
import pytest

from live.shown_drive import CAMERAS, LOOPBACK, ORIGIN, WHEELS, addresses_of, show
from offpiste.core.errors import LiveError
from offpiste.live.viewers import VIEWERS
from transport.routers import until

pytest.importorskip("foxglove")
client = pytest.importorskip("websockets.sync.client")
protobuf = pytest.importorskip("google.protobuf.descriptor_pb2")
factory = pytest.importorskip("google.protobuf.message_factory")


@pytest.fixture
def served():
    """A viewer and its port."""
    with closing(VIEWERS["foxglove"]("127.0.0.1:0", WHEELS, CAMERAS)) as viewer:
        yield viewer, int(viewer.where.split("127.0.0.1:")[1].split(" ")[0])


def received(port, show_more, *topics):
    """Return what a client like the app is told of server and channels, and a message of each topic with its time."""
    with client.connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], close_timeout=0.1) as socket:
        info, advertised = (json.loads(socket.recv(timeout=10)) for _ in range(2))
        channels = {channel["topic"]: channel for channel in advertised["channels"]}
        wanted = [{"id": number, "channelId": channels[topic]["id"]} for number, topic in enumerate(topics)]
        socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        got = {}
        while len(got) < len(topics):
            show_more()
            data = socket.recv(timeout=10)
            _, number, nanoseconds = struct.unpack_from("<BIQ", data)
            got[topics[number]] = nanoseconds / 1e9, decoded(channels[topics[number]], data[13:])
    return info, channels, got


def decoded(channel, data):
    if channel["encoding"] == "json":
        return json.loads(data)
    files = protobuf.FileDescriptorSet.FromString(b64decode(channel["schema"])).file
    return factory.GetMessages(files)[channel["schemaName"]].FromString(data)


def test_a_drive_arrives_by_typed_channels(served):
    viewer, port = served
    info, channels, got = received(port, lambda: show(viewer), "/tf", "/plan", "/map", "/images/front", "/latencies")
    assert info["capabilities"] == [], "clients may not publish"
    assert {"/pose", "/course", "/vehicle", "/mode", "/command", "/speed"} <= set(channels)
    time, transform = got["/tf"]
    assert (time, transform.parent_frame_id, transform.child_frame_id) == (1000.5, "map", "base_link")
    assert (transform.translation.x, transform.translation.y, transform.translation.z) == tuple(ORIGIN)
    assert transform.rotation.z == pytest.approx(np.sin(0.5))
    path = got["/plan"][1].entities[0].lines[0]
    assert [point.x - ORIGIN[0] for point in path.points] == list(range(50))
    assert path.colors[1].b == pytest.approx(5 / 255)
    cloud = got["/map"][1]
    points = np.frombuffer(cloud.data, [(field.name, {1: "u1", 7: "<f4"}[field.type]) for field in cloud.fields])
    assert [field.offset for field in cloud.fields] == [points.dtype.fields[name][1] for name in points.dtype.names]
    np.testing.assert_allclose(points["x"] + cloud.pose.position.x, ORIGIN[0] + np.arange(50.0))
    np.testing.assert_allclose(points["slope"], np.arange(50))
    assert points[["red", "green", "blue", "alpha"]][0].tolist() == (1, 2, 3, 255)
    pixels = cv2.imdecode(np.frombuffer(got["/images/front"][1].data, np.uint8), cv2.IMREAD_COLOR)
    assert pixels.shape == (320, 640, 3)
    assert np.abs(pixels[..., ::-1].astype(int) - (200, 100, 50)).max() < 8, "RGB stays RGB"
    assert got["/latencies"] == (1000.5, {"plan_ms": 80.0})


def test_later_clients_get_the_last_messages_and_a_taken_port_is_one_line(served):
    viewer, port = served
    show(viewer)
    _, _, got = received(port, lambda: None, "/course", "/mode", "/vehicle")
    assert got["/course"][0] == 1000.5
    line = got["/course"][1].entities[0].lines[0]
    assert (len(line.points), len(line.colors), line.color.b) == (50, 0, pytest.approx(3 / 255))
    assert got["/mode"][1] == {"mode": "stopping", "why": "no plan"}
    assert got["/vehicle"][1].entities[0].cubes[0].size.x == pytest.approx(2.06)
    assert addresses_of(port) == {LOOPBACK}
    with pytest.raises(LiveError, match=r"cannot listen there.*--view-at"):
        VIEWERS["foxglove"](f"127.0.0.1:{port}", WHEELS, CAMERAS)
    viewer.close()
    assert until(lambda: not addresses_of(port)), "closed"
