"""The Foxglove server, as a client of its protocol sees it."""

import json
import struct
from base64 import b64decode
from contextlib import contextmanager

import cv2
import numpy as np
import pytest

from live.shown_drive import CAMERAS, LOOPBACK, ORIGIN, WHEELS, addresses_of, show
from offpiste.core.errors import LiveError
from offpiste.live.viewers import VIEWERS
from transport.routers import until

pytest.importorskip("foxglove")
client = pytest.importorskip("websockets.sync.client")
protobuf = pytest.importorskip("google.protobuf")
for name in ("descriptor_pb2", "descriptor_pool", "message_factory"):
    pytest.importorskip(f"google.protobuf.{name}")


class App:
    """Client like the Foxglove app: reads channels, subscribes, and decodes by their schemas."""

    def __init__(self, port):
        self._open = client.connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], max_size=None)
        self._socket = self._open.__enter__()
        self.subprotocol = self._socket.subprotocol
        self.info, advertised = (json.loads(self._socket.recv(timeout=10)) for _ in range(2))
        self.channels = {channel["topic"]: channel for channel in advertised["channels"]}

    def subscribe(self, *topics):
        self._topics = dict(enumerate(topics))
        wanted = [{"id": number, "channelId": self.channels[topic]["id"]} for number, topic in self._topics.items()]
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def receive(self):
        """Return topic, time [s] and content of the next message."""
        data = self._socket.recv(timeout=10)
        operation, number, nanoseconds = struct.unpack_from("<BIQ", data)
        assert operation == 1
        topic = self._topics[number]
        return topic, nanoseconds / 1e9, self._decoded(self.channels[topic], data[13:])

    def received(self, count):
        return {topic: (time, message) for topic, time, message in (self.receive() for _ in range(count))}

    def close(self):
        self._open.__exit__(None, None, None)

    def _decoded(self, channel, data):
        if channel["encoding"] == "json":
            return json.loads(data)
        pool = protobuf.descriptor_pool.DescriptorPool()
        files = protobuf.descriptor_pb2.FileDescriptorSet.FromString(b64decode(channel["schema"]))
        for file in files.file:
            pool.Add(file)
        kind = protobuf.message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))
        return kind.FromString(data)


@contextmanager
def served():
    viewer = VIEWERS["foxglove"]("127.0.0.1:0", WHEELS, CAMERAS)
    port = int(viewer.where.split("127.0.0.1:")[1].split(" ")[0])
    try:
        yield viewer, port
    finally:
        viewer.close()


@contextmanager
def watched(*topics):
    """A viewer, and a client that subscribes before anything is shown."""
    with served() as (viewer, port):
        app = App(port)
        app.subscribe(*topics)
        viewer.numbers(1.0, "speed", {"speed": 0.0})
        assert app.receive()[0] == "/speed", "the subscriptions are there"
        yield viewer, app
        app.close()


def test_the_channels_have_schemas_and_clients_may_not_publish():
    with served() as (viewer, port):
        app = App(port)
        assert app.subprotocol == "foxglove.sdk.v1"
        assert app.info["capabilities"] == []
        schemas = {topic: channel["schemaName"] for topic, channel in app.channels.items()}
        assert schemas["/tf"] == "foxglove.FrameTransform"
        assert schemas["/map"] == "foxglove.PointCloud"
        assert schemas["/images/front"] == "foxglove.CompressedImage"
        assert {"/pose", "/course", "/plan", "/vehicle", "/mode", "/latencies", "/command", "/speed"} <= set(schemas)
        assert f"ds.url=ws%3A%2F%2F127.0.0.1%3A{port}" in viewer.where
        app.close()


def test_pose_plan_and_course_arrive():
    with watched("/speed", "/tf", "/pose", "/plan", "/course") as (viewer, app):
        show(viewer)
        got = app.received(5)
    time, transform = got["/tf"]
    assert (time, transform.parent_frame_id, transform.child_frame_id) == (1000.5, "map", "base_link")
    place = transform.translation
    assert (place.x, place.y, place.z) == tuple(ORIGIN)
    assert transform.timestamp.seconds == 1000
    pose = got["/pose"][1].pose
    assert pose.orientation.z == pytest.approx(np.sin(0.5))
    time, update = got["/plan"]
    path, region = update.entities[0].lines
    assert time == 1000.6
    assert [(p.x, p.y, p.z) for p in path.points[:2]] == [tuple(ORIGIN), tuple(ORIGIN + np.array((1, 0, 0)))]
    assert len(path.colors) == len(path.points) == 50
    assert (path.colors[0].r, path.colors[0].b) != (path.colors[-1].r, path.colors[-1].b), "colours of speed"
    assert len(region.points) == 5
    assert len(got["/course"][1].entities[0].lines[0].points) == 50


def test_the_map_is_a_cloud_with_layers_and_colours():
    with watched("/speed", "/map") as (viewer, app):
        show(viewer)
        cloud = app.received(2)["/map"][1]
    kinds = {1: "u1", 7: "<f4"}
    columns = {"names": [field.name for field in cloud.fields], "offsets": [field.offset for field in cloud.fields],
               "formats": [kinds[field.type] for field in cloud.fields], "itemsize": cloud.point_stride}  # fmt: skip
    points = np.frombuffer(cloud.data, np.dtype(columns))
    corner = cloud.pose.position
    np.testing.assert_allclose(points["x"] + corner.x, ORIGIN[0] + np.arange(50.0))
    np.testing.assert_allclose(points["z"] + corner.z, ORIGIN[2])
    np.testing.assert_allclose(points["slope"], np.arange(50))
    assert [points[name][0] for name in ("red", "green", "blue", "alpha")] == [1, 2, 3, 255]


def test_images_are_scaled_jpegs():
    with watched("/speed", "/images/front", "/mode", "/latencies") as (viewer, app):
        show(viewer)
        got = app.received(4)
    image = got["/images/front"][1]
    assert image.format == "jpeg"
    pixels = cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_COLOR)
    assert pixels.shape == (320, 640, 3)
    assert np.abs(pixels[..., ::-1].astype(int) - (200, 100, 50)).max() < 8, "RGB stays RGB"
    assert got["/mode"][1] == {"mode": "stopping", "why": "no plan"}
    assert got["/latencies"] == (1000.5, {"plan_ms": 80.0})


def test_later_subscribers_are_sent_the_last_message():
    with served() as (viewer, port):
        show(viewer)
        app = App(port)
        app.subscribe("/course", "/mode", "/vehicle")
        got = app.received(3)
        app.close()
    assert got["/course"][0] == 1000.5
    box = got["/vehicle"][1].entities[0].cubes[0]
    assert (box.size.x, box.size.y) == (pytest.approx(2.06), pytest.approx(1.32))


def test_a_slow_client_delays_nothing():
    with watched("/speed", "/map", "/images/front") as (viewer, app):
        for _ in range(100):
            show(viewer)
        newest = [app.receive()[1] for _ in range(10)]
        assert newest, "it is still served"


def test_foxglove_listens_on_the_loopback_alone_and_refuses_a_taken_port():
    with served() as (_, port):
        assert addresses_of(port) == {LOOPBACK}
        with pytest.raises(LiveError, match=r"cannot listen there.*--view-at"):
            VIEWERS["foxglove"](f"127.0.0.1:{port}", WHEELS, CAMERAS)
    assert until(lambda: not addresses_of(port)), "closed"
