"""Viewers shown a drive far from the origin of the world: Rerun, and Foxglove as a client of its protocol sees it."""

import json
import struct
import time
from base64 import b64decode
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest

from offpiste.core.errors import LiveError
from offpiste.live.viewers import VIEWERS, Ground, Line
from offpiste.logs.measurements import Image
from offpiste.runtime.estimator import VehicleReading
from runtime.stream import WHEELS
from transport.routers import free_port, until

chunks = pytest.importorskip("rerun.chunk")
client = pytest.importorskip("websockets.sync.client")
protobuf = pytest.importorskip("google.protobuf.descriptor_pb2")
factory = pytest.importorskip("google.protobuf.message_factory")

CAMERAS = ("front",)
ORIGIN = np.array((400_000.0, 5_000_000.0, 30.0))
LOOPBACK = "0100007F"


def show(viewer):
    """Show each element of a drive."""
    turned = np.array((0, 0, np.sin(0.5), np.cos(0.5)))
    viewer.pose(VehicleReading(1000.5, ORIGIN, turned, np.zeros(3), 0.0, np.zeros(4)))
    places = ORIGIN + np.column_stack((np.arange(50.0), np.zeros((50, 2))))
    shade = np.tile(np.array((1, 2, 3), np.uint8), (50, 1))
    viewer.line("course", 1000.5, Line(places, shade, 0.12))
    colours = np.arange(150, dtype=np.uint8).reshape(50, 3)
    viewer.line("plan", 1000.6, Line(places, colours, 0.16))
    viewer.ground(Ground(1000.4, places, {"slope": np.arange(50, dtype=np.float32)}, shade))
    viewer.image(Image(1000.3, "front", np.full((480, 960, 3), (200, 100, 50), np.uint8)))
    viewer.mode(1000.5, "stopping", "no plan")
    viewer.numbers(1000.5, "latencies", {"plan_ms": 80.0})
    viewer.numbers(1000.5, "speed", {"speed": 1.5})


def addresses_of(port):
    """Return the hexadecimal addresses on which a port is open."""
    rows = [line.split() for name in ("tcp", "tcp6") for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]]
    return {row[1].split(":")[0] for row in rows if row[3] == "0A" and int(row[1].split(":")[1], 16) == port}


def read_back(path):
    """Return the columns of each entity of a recording."""
    found: dict[str, dict[str, list]] = {}
    for chunk in chunks.RrdReader(str(path)).stream().to_chunks():
        if not chunk.entity_path.startswith("/__"):
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                column = batch.column(name)
                if name == "robot":
                    column = column.cast("int64")
                if name == "robot" or ":" in name:
                    found.setdefault(chunk.entity_path, {}).setdefault(name, []).extend(column.to_pylist())
    return found


def test_a_recording_by_rerun_holds_the_drive(tmp_path):
    file = tmp_path / "drive.rrd"
    viewer = VIEWERS["rerun"](str(file), WHEELS, CAMERAS)
    assert viewer.where == f"Rerun: {file}"
    show(viewer)
    viewer.close()
    found = read_back(file)
    assert found["/world/vehicle"]["robot"] == [1000_500_000_000]
    assert found["/world/vehicle"]["Transform3D:translation"] == [[[0.0, 0.0, 0.0]]], "relative to the first place"
    plan = found["/world/plan"]["LineStrips3D:strips"][0]
    assert len(plan) == 49
    assert plan[1] == [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
    assert len(set(found["/world/plan"]["LineStrips3D:colors"][0])) > 40, "colours of speed"
    course = found["/world/course"]
    assert [len(strip) for strip in course["LineStrips3D:strips"][0]] == [50], "one strip of one colour"
    assert course["LineStrips3D:colors"] == [[0x010203FF]]
    assert course["LineStrips3D:radii"] == [[pytest.approx(0.06)]]
    np.testing.assert_allclose(np.array(found["/world/map"]["Points3D:positions"][0])[:, 0], np.arange(50))
    assert found["/events"]["TextLog:text"] == [["stopping: no plan"]]
    assert found["/mode/mode"]["Scalars:scalars"] == [[1.0]]
    assert found["/latencies/plan_ms"]["Scalars:scalars"] == [[80.0]]
    assert bytes(found["/images/front"]["EncodedImage:blob"][0][0]).startswith(b"\xff\xd8")
    with pytest.raises(LiveError, match="already exists"):
        VIEWERS["rerun"](str(file), WHEELS, CAMERAS)


def test_rerun_listens_on_the_loopback_alone_and_a_taken_port_is_one_line():
    port = free_port()
    viewer = VIEWERS["rerun"](f"127.0.0.1:{port}", WHEELS, CAMERAS)
    assert viewer.where == f"Rerun: rerun rerun+http://127.0.0.1:{port}/proxy"
    show(viewer)
    time.sleep(0.5)
    assert addresses_of(port) == {LOOPBACK}
    with pytest.raises(LiveError, match="cannot listen there"):
        VIEWERS["rerun"](f"127.0.0.1:{port}", WHEELS, CAMERAS)
    viewer.close()


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
