"""Rings: the newest win, nobody waits, and what a killed writer left is not read."""

import multiprocessing
import os
import signal
import struct
import time

import pytest

from offpiste.core.errors import LiveError
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


def half_written(ring, words):
    """Write a message as far as a number of stores, as a writer that is killed there does."""

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
def test_a_writer_that_dies_at_any_store_leaves_what_was_there(ring, stores):
    for k in range(10):
        ring.write(bytes([k]))
    half_written(ring, stores)
    reader = Ring(ring.path)
    assert (reader.written, reader.newest()) == (10, (10, bytes([9])))
    assert [entry.number for entry in reader.since(0)] == [8, 9, 10]
    assert 0 <= reader.age < 1
    again = Ring(ring.path)
    assert again.write(b"next")
    assert reader.newest() == (11, b"next")


def test_a_number_that_comes_round_again_is_not_taken_for_an_older_one(tmp_path):
    """Number 5 is looked for in the slot in which 261 was begun: its first byte is that of 5."""
    ring = Ring.create(tmp_path / "one", slots=256, size=16)
    for k in range(260):
        ring.write(bytes([k % 256]))
    half_written(ring, 6)
    ring._words[ring._slot(261)] = 5
    assert ring._read(5) is None


def test_a_reader_that_is_lapped_looks_again(ring, monkeypatch):
    ring.write(b"a")
    reader, read = Ring(ring.path), Ring._read

    def lapped(self, number):
        if ring.written < 6:
            for _ in range(5):
                ring.write(b"b")
        return read(self, number)

    monkeypatch.setattr(Ring, "_read", lapped)
    assert reader.newest() == (6, b"b")


def test_what_cannot_be_reserved_is_refused(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(LiveError, match=r"No space left.*make room"):
        Ring.create(tmp_path / "ring", slots=2, size=10)


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
