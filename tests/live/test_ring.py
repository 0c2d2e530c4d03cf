"""Rings: the newest message wins, nobody waits, and incomplete messages are never read. Values as bytes."""

import multiprocessing
import os
import signal
import struct
import time
from dataclasses import is_dataclass

import numpy as np
import pytest

from live.synthetic_robot import plan, rig
from offpiste.core.errors import LiveError
from offpiste.live import ring as rings
from offpiste.live.ring import Reader, Ring, from_fields, pack_fields, packed, unpacked
from offpiste.logs.measurements import Camera, Cloud, Image, Lidar
from offpiste.planning.course import Course
from offpiste.rig.camera import CameraModel
from offpiste.runtime.estimator import VehicleReading
from planning_maps import layers


@pytest.fixture
def ring(tmp_path):
    return Ring.create(tmp_path / "ring", slots=4, size=100)


def test_the_newest_are_read_by_all_and_a_restarted_writer_continues(ring):
    assert ring.newest() is None
    assert ring.since(0) == []
    for k in range(9):
        assert ring.write(bytes([k]))
    assert Ring(ring.path).write(bytes([9]))
    other = Ring(ring.path)
    assert other.newest() == (10, bytes([9]))
    assert [entry.data[0] for entry in other.since(0)] == [7, 8, 9], "older ones are overwritten"
    assert [entry.number for entry in other.since(9)] == [10]
    assert other.since(10) == []
    assert ring.age < 1.0
    assert not ring.write(b"x" * 101), "too large"
    assert ring.written == 10


def test_a_reader_that_was_overtaken_counts_lost_messages(ring):
    reader = Reader(ring)
    for k in range(9):
        ring.write(packed({"k": k}))
    assert (reader.new(), reader.lost, reader.number) == ([{"k": 6}, {"k": 7}, {"k": 8}], 6, 9)
    assert (reader.new(), reader.lost) == ([], 6)


def test_a_damaged_message_is_not_read(ring):
    ring.write(b"good")
    ring.write(b"torn")
    with ring.path.open("r+b") as file:
        at = file.read().index(b"torn")
        file.seek(at)
        file.write(b"xx")
    assert ring.newest() == (1, b"good")
    assert [entry.data for entry in ring.since(0)] == [b"good"]


def test_another_file_and_missing_memory_are_refused(tmp_path, monkeypatch):
    (tmp_path / "ring").write_bytes(b"x" * 100)
    with pytest.raises(LiveError, match="not shared memory of offpiste"):
        Ring(tmp_path / "ring")
    with pytest.raises(LiveError, match="no shared memory"):
        Ring(tmp_path / "nothing")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(LiveError, match=r"No space left.*make room"):
        Ring.create(tmp_path / "new", slots=2, size=10)


def half_written(ring, words):
    """Write a message up to a number of stores, like a writer that is killed there."""

    class Stopped(Exception):
        pass

    class Words:
        def __init__(self, view):
            self.view = view

        def __getitem__(self, key):
            return self.view[key]

        def __setitem__(self, key, value):
            nonlocal words
            if not words:
                raise Stopped
            words -= 1
            self.view[key] = value

    whole = ring._words, ring._view, ring._times
    ring._words, ring._view, ring._times = (Words(view) for view in whole)
    try:
        with pytest.raises(Stopped):
            ring.write(b"never finished")
    finally:
        ring._words, ring._view, ring._times = whole


@pytest.mark.parametrize("stores", range(7))
def test_a_writer_that_dies_at_any_store_leaves_the_earlier_messages(ring, stores):
    for k in range(10):
        ring.write(bytes([k]))
    half_written(ring, stores)
    reader = Ring(ring.path)
    assert (reader.written, reader.newest()) == (10, (10, bytes([9])))
    assert [entry.number for entry in reader.since(0)] == [8, 9, 10]
    assert 0 <= reader.age < 1
    assert Ring(ring.path).write(b"next")
    assert reader.newest() == (11, b"next")


def write_forever(path):
    ring, number = Ring(path), 0
    while True:
        number += 1
        ring.write(struct.pack("<Q", number) * 12)


def test_a_reader_never_sees_a_mixture_while_writers_are_killed(ring):
    context, read = multiprocessing.get_context("fork"), 0
    for _ in range(5):
        writer = context.Process(target=write_forever, args=(ring.path,), daemon=True)
        writer.start()
        end = time.monotonic() + 0.2
        while time.monotonic() < end:
            for entry in [ring.newest(), *ring.since(max(ring.written - 3, 0))]:
                if entry is not None:
                    assert len(set(struct.unpack("<12Q", entry.data))) == 1
                    read += 1
        os.kill(writer.pid, signal.SIGKILL)
        writer.join()
    assert read > 100


def same(a, b):
    for name in a.__dataclass_fields__:
        one, other = getattr(a, name), getattr(b, name)
        assert type(one) is type(other)
        same(one, other) if is_dataclass(one) else np.testing.assert_array_equal(one, other)


def test_records_are_restored():
    rng = np.random.default_rng(0)
    for record in (
        VehicleReading(3.0, rng.normal(size=3), rng.normal(size=4), rng.normal(size=3), 0.1, np.full(4, np.nan)),
        Image(1.0, "eye", rng.integers(0, 255, (4, 6, 3)).astype(np.uint8)),
        Cloud(1.0, "lidar", rng.normal(size=(5, 3)), None, np.full(5, np.nan)),
        Course(np.array([[0.0, 0.0], [5.0, 1.0]]), np.array([2.0, 3.0])),
    ):
        same(record, from_fields(type(record), unpacked(pack_fields(record, more=None))))
    values = unpacked(rings.pack_plan(plan(1.0), empty=False))
    same(plan(1.0), rings.plan_from(values))
    assert values["empty"] is False
    ground = layers(9, plane=(0.5, -0.2)).cropped(np.array([-1.0, -0.5]), np.array([0.5, 0.5]))  # not square
    same(ground, rings.layers_from(unpacked(rings.pack_layers(ground, scan_time=1.0))))
    assert rings.layers_from(unpacked(rings.pack_layers(None))) is None
    with pytest.raises(NotImplementedError):
        packed({"code": print})


def test_sensors_have_the_entries_of_the_rig():
    vehicle = rig('[cameras.eye]\ntopic = "/image"\ninfo = "/info"\n')
    model = CameraModel(8, 6, np.eye(3), (0.1, 0.0, 0.0, 0.0))
    camera = Camera("eye", model, np.eye(4), vehicle.cameras["eye"])
    lidar = Lidar("lidar", 2 * np.eye(4), vehicle.lidars["lidar"])
    cameras, lidars = rings.sensors_from(unpacked(rings.pack_sensors(({"eye": camera}, {"lidar": lidar}))), vehicle)
    assert cameras["eye"].source == vehicle.cameras["eye"]
    same(cameras["eye"].model, model)
    np.testing.assert_array_equal(lidars["lidar"].body_from_lidar, 2 * np.eye(4))
