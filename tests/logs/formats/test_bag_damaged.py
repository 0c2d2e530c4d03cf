"""Damaged bags: partial data with a warning, or an error in one line."""

import struct
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType
from rosbags.rosbag2.enums import StoragePlugin

from bag_files import mcap_file, ros1_bag, ros2_folder, speeds, twists
from offpiste.core.errors import LogError
from offpiste.logs.formats.bag import BagLog


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunking", [True, False])
def test_mcap_whose_recorder_was_killed(tmp_path: Path, compression: CompressionType, chunking: bool) -> None:
    path = mcap_file(tmp_path / "a.mcap", twists(30), compression=compression, chunking=chunking, finish=False)
    log = BagLog(path)
    count = log.topics["/odom"].count
    assert speeds(log) == list(range(count))
    assert 25 <= count <= 30
    (warning,) = log.warnings
    assert "the MCAP file is truncated" in warning
    assert f"its {count} whole messages are read; `mcap recover a.mcap -o REPAIRED.mcap` repairs it" in warning


@pytest.mark.parametrize("index", [IndexType.NONE, IndexType.CHUNK, IndexType.MESSAGE])
def test_an_mcap_without_an_index_is_whole(tmp_path: Path, index: IndexType) -> None:
    folder = ros2_folder(tmp_path / "drive", StoragePlugin.MCAP, twists(30))
    path = mcap_file(folder / "drive.mcap", twists(30), index=index)
    log = BagLog(path)
    assert log.warnings == ()
    assert speeds(log) == list(range(30))
    assert len(log.stamps("/odom")) == len(list(log.messages("/odom"))) == 30
    assert speeds(BagLog(folder)) == list(range(30))


def test_mcap_that_ends_in_zeros(tmp_path: Path) -> None:
    path = mcap_file(tmp_path / "a.mcap", twists(30), finish=False)
    path.write_bytes(path.read_bytes() + bytes(100_000_000))
    assert "is truncated" in BagLog(path).warnings[0]


def test_damaged_chunk_is_an_error_or_skipped(tmp_path: Path) -> None:
    path = mcap_file(tmp_path / "a.mcap", twists(30))
    data = bytearray(path.read_bytes())
    data[data.index(struct.pack("<d", 7.0))] ^= 1  # in the message with speed 7
    path.write_bytes(data)
    with pytest.raises(LogError, match=r"topic '/odom' is damaged: .*checksum.*; repair it with `mcap recover FILE"):
        speeds(BagLog(path))
    path.write_bytes(data[:-30])
    log = BagLog(path)
    assert 7.0 not in speeds(log)
    assert speeds(log)[-1] == 29.0
    assert log.warnings == (f"{path}: damaged records that are skipped: 1",)


def truncated(path: Path, size: int) -> Path:
    path.write_bytes(path.read_bytes()[:size])
    return path


def test_truncated_and_wrong_files(tmp_path: Path) -> None:
    database = ros2_folder(tmp_path / "drive", StoragePlugin.SQLITE3, twists(300))
    for path, what in (
        (
            truncated(ros1_bag(tmp_path / "cut.bag", 30), -300),
            "cannot be read: .*; repair it with `rosbag reindex FILE`, or",
        ),
        (truncated(database / "drive.db3", 20_000), "cannot be read: .*malformed; repair it with `sqlite3 FILE .recov"),
        (database, "cannot be read: .*malformed; repair it with `ros2 bag reindex FOLDER`"),
        (mcap_file(tmp_path / "a.bag", twists(1)), r"not a \.bag file; it is a \.mcap file: rename it"),
    ):
        with pytest.raises(LogError, match=rf"{path.name}: {what}"):
            BagLog(path)
    for ending in (".bag", ".mcap", ".db3"):
        path = tmp_path / f"b{ending}"
        for content, what in ((b"", "the file is empty"), (b"\x89PNG\r\n\x1a\n" + bytes(100), f"not a {ending} file")):
            path.write_bytes(content)
            with pytest.raises(LogError, match=rf"b{ending}: {what}; .*copy it again"):
                BagLog(path)


def test_messages_left_in_the_write_ahead_file_are_told(tmp_path: Path) -> None:
    path = ros2_folder(tmp_path / "drive", StoragePlugin.SQLITE3, twists(3)) / "drive.db3"
    path.with_name("drive.db3-wal").write_bytes(b"x")
    (warning,) = BagLog(path).warnings
    assert "drive.db3-wal: messages not yet moved into the .db3 are not read" in warning


def write_db3(path: Path) -> None:
    folder = ros2_folder(path.with_suffix(""), StoragePlugin.SQLITE3, twists(20))
    (folder / f"{folder.name}.db3").rename(path)


WRITERS = {
    ".bag": lambda path: ros1_bag(path, 20),
    ".mcap": lambda path: mcap_file(path, twists(20), compression=CompressionType.ZSTD),
    ".db3": write_db3,
}


def trouble(path: Path) -> str:
    """Return the error of reading a whole bag, or ""; other exceptions fail the test."""
    try:
        log = BagLog(path)
        for name, topic in log.topics.items():
            if topic.count and topic.fields:
                log.read(name, topic.fields)
    except LogError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("ending", WRITERS)
@pytest.mark.parametrize("damage", ["cut", "flip"])
def test_damage_anywhere_ends_in_samples_or_one_line(tmp_path: Path, ending: str, damage: str) -> None:
    path = tmp_path / f"a{ending}"
    WRITERS[ending](path)
    whole = path.read_bytes()
    random = np.random.default_rng(0)
    for place in random.integers(0, len(whole), 60):
        data = bytearray(whole[:place] if damage == "cut" else whole)
        if damage == "flip":
            data[place] ^= 1 << random.integers(8)
        path.write_bytes(data)
        message = trouble(path)
        assert message == "" or str(path) in message
        assert "\n" not in message
        assert len(message) < 600 + 2 * len(str(path))


@pytest.mark.parametrize("count", ["-inf", '"text"', "null", "[]"])
def test_a_folder_whose_metadata_count_nonsense_is_read_file_by_file(tmp_path: Path, count: str) -> None:
    folder = ros2_folder(tmp_path / "drive", StoragePlugin.MCAP, twists(30))
    head, key, tail = (folder / "metadata.yaml").read_text().partition("topics_with_message_count:")
    assert "message_count: 30" in tail
    (folder / "metadata.yaml").write_text(head + key + tail.replace("message_count: 30", f"message_count: {count}"))
    log = BagLog(folder)
    assert log.topics["/odom"].count == 30
    assert speeds(log) == list(range(30))
    assert any("files are read as one drive" in note for note in log.warnings)
