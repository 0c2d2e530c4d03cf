"""MCAP files that other readers understand, also after interruptions."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from offpiste.core.errors import LogError
from offpiste.logs import open_log
from offpiste.logs.ros.writer import McapWriter, header, make

START = 1_700_000_000 * 10**9
PERIOD = 20_000_000


def speed(i: int) -> object:
    """Message i: pressure i Pa, stamped START + i * 20 ms, half a second before it is recorded."""
    return make(
        "sensor_msgs/FluidPressure", header=header(at(i) - 500_000_000, "b"), fluid_pressure=float(i), variance=0.0
    )


def at(i: int) -> int:
    return START + i * PERIOD


def write(path: Path, count: int) -> Path:
    with McapWriter(path) as writer:
        for i in range(count):
            writer.write("/brake", speed(i), at(i))
    return path


def pressures(path: Path) -> list[float]:
    return open_log(path).read("/brake", ["fluid_pressure"]).values[:, 0].tolist()


def test_any_reader_reads_it(tmp_path: Path) -> None:
    path = write(tmp_path / "drive.mcap", 200)
    with AnyReader([path]) as reader:
        assert [(c.topic, c.msgtype) for c in reader.connections] == [("/brake", "sensor_msgs/msg/FluidPressure")]
        read = [(stamp, reader.deserialize(raw, c.msgtype)) for c, stamp, raw in reader.messages()]
    assert [stamp for stamp, _ in read] == [at(i) for i in range(200)]
    assert [message.fluid_pressure for _, message in read] == list(range(200))
    assert read[3][1].header.frame_id == "b"


def test_it_is_chunked_compressed_indexed_and_says_what_its_types_are(tmp_path: Path) -> None:
    path = write(tmp_path / "drive.mcap", 200)
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
    assert summary is not None
    assert summary.statistics.message_count == 200
    # A chunk ends with the first message a second after its first one: 51 messages of 20 ms.
    assert [chunk.message_end_time - chunk.message_start_time for chunk in summary.chunk_indexes] == [
        10**9, 10**9, 10**9, 46 * PERIOD,
    ]  # fmt: skip
    assert {chunk.compression for chunk in summary.chunk_indexes} == {"lz4"}
    (schema,) = summary.schemas.values()
    assert (schema.name, schema.encoding) == ("sensor_msgs/msg/FluidPressure", "ros2msg")
    assert b"MSG: std_msgs/Header" in schema.data
    assert b"MSG: builtin_interfaces/Time" in schema.data


def test_the_same_messages_give_the_same_bytes(tmp_path: Path) -> None:
    first = write(tmp_path / "a.mcap", 120).read_bytes()
    time.sleep(0.01)
    assert write(tmp_path / "b.mcap", 120).read_bytes() == first


def test_files_that_cannot_be(tmp_path: Path) -> None:
    path = write(tmp_path / "drive.mcap", 3)
    before = path.read_bytes()
    for name, what in (
        ("drive.mcap", "exists already; remove it, or give another name"),
        ("drive.bag", r"give it the ending \.mcap"),
        ("drive.mcap/drive.mcap", "cannot be written: File exists"),
    ):
        with pytest.raises(LogError, match=what):
            McapWriter(tmp_path / name)
    assert path.read_bytes() == before
    assert write(tmp_path / "new" / "folder" / "drive.mcap", 1).is_file()


def test_a_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("offpiste.logs.ros.writer.Writer.flush", full)
    with pytest.raises(LogError, match=r"drive\.mcap: cannot be written: No space left on device; make room"):
        write(tmp_path / "drive.mcap", 200)


@pytest.mark.parametrize("seed", range(3))
def test_a_file_cut_anywhere_gives_its_first_messages(tmp_path: Path, seed: int) -> None:
    whole = write(tmp_path / "whole.mcap", 400).read_bytes()
    random = np.random.default_rng(seed)
    for i, size in enumerate(random.integers(2000, len(whole), 5)):
        path = tmp_path / f"cut_{i}.mcap"
        path.write_bytes(whole[:size])
        found = pressures(path)
        assert found == list(range(len(found)))
        # All chunks that are whole are found: the loss is a chunk at most, and what follows the cut.
        assert len(found) >= 400 * (size - 2000) / len(whole) - 51


RECORD = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # shells start background jobs deaf to it
sys.path.insert(0, {tests!r})
from test_writer import McapWriter, at, speed
with McapWriter({path!r}) as writer:
    for i in range(10**9):
        writer.write("/brake", speed(i), at(i))
        if i == 300:
            print("started", flush=True)
"""


def killed(path: Path, by: signal.Signals, after: float) -> subprocess.CompletedProcess[str]:
    """Send a signal to a recording process after some seconds."""
    script = RECORD.format(tests=str(Path(__file__).parent), path=str(path))
    with subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "started\n"
        time.sleep(after)
        os.kill(process.pid, by)
        try:
            out, err = process.communicate(timeout=60)
        finally:
            process.kill()
        return subprocess.CompletedProcess(process.args, process.returncode, out, err)


@pytest.mark.parametrize("by", [signal.SIGKILL, signal.SIGINT])
def test_a_recorder_that_is_stopped_at_any_moment_leaves_what_the_reader_reads(tmp_path: Path, by) -> None:
    path = tmp_path / "drive.mcap"
    done = killed(path, by, 0.2)
    log = open_log(path)
    if by == signal.SIGKILL:
        assert done.returncode == -signal.SIGKILL
        assert "the recorder was killed" in log.warnings[0]
    else:
        assert "KeyboardInterrupt" in done.stderr
        assert log.warnings == ()
    found = log.read("/brake", ["fluid_pressure"]).values[:, 0]
    assert len(found) > 100
    np.testing.assert_array_equal(found, np.arange(len(found)))
