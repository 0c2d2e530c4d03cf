"""Rings: the newest win, nobody waits, and what a killed writer left is not read."""

import multiprocessing
import os
import signal
import struct
import time

import pytest

from offpiste.errors import LiveError
from offpiste.live.ring import Ring


@pytest.fixture
def ring(tmp_path):
    return Ring.create(tmp_path / "ring", slots=4, size=100)


def test_the_newest_is_read_by_all(ring):
    assert ring.newest() is None
    assert ring.since(0) == []
    for k in range(10):
        assert ring.write(bytes([k]))
    other = Ring(ring.path)
    assert other.newest() == (10, bytes([9]))
    assert [entry.data[0] for entry in other.since(0)] == [7, 8, 9], "older ones are overwritten"
    assert [entry.number for entry in other.since(9)] == [10]
    assert other.since(10) == []
    assert ring.age < 1.0


def test_a_message_that_is_too_large_is_not_written(ring):
    assert ring.write(b"x" * 100)
    assert not ring.write(b"x" * 101)
    assert ring.newest().data == b"x" * 100


def test_a_writer_that_is_started_again_continues(ring):
    ring.write(b"a")
    again = Ring(ring.path)
    again.write(b"b")
    assert [entry.data for entry in ring.since(0)] == [b"a", b"b"]


def test_what_is_half_written_is_not_read(ring):
    ring.write(b"good")
    ring.write(b"torn")
    with ring.path.open("r+b") as file:
        content = file.read()
        file.seek(content.index(b"torn"))
        file.write(b"to")
        file.seek(content.index(b"torn"))
        file.write(b"xx")
    assert ring.newest() == (1, b"good")
    assert [entry.data for entry in ring.since(0)] == [b"good"]


def test_another_file_is_refused(tmp_path):
    (tmp_path / "ring").write_bytes(b"x" * 100)
    with pytest.raises(LiveError, match="no shared memory of offpiste"):
        Ring(tmp_path / "ring")
    with pytest.raises(LiveError, match="no shared memory"):
        Ring(tmp_path / "nothing")


def write_forever(path):
    ring = Ring(path)
    number = 0
    while True:
        number += 1
        ring.write(struct.pack("<Q", number) * 12)


def test_a_reader_never_sees_a_mixture_while_the_writer_is_killed_again_and_again(ring):
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
