"""Small files that need gigabytes or hours to read end in one line, and run no code."""

import bz2
import re
import sqlite3
import struct
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import lz4.frame
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, ChunkIndex, Footer, Header, McapRecord, Message, Schema
from rosbags import rosbag1
from rosbags.rosbag1 import reader as rosbag1_reader
from rosbags.rosbag2 import reader as rosbag2_reader
from rosbags.rosbag2 import storage_mcap

from offpiste.core.errors import TooLarge
from offpiste.core.limits import zstd
from offpiste.logs.ros.bounds import inflated
from tests.fuzz.cases import verdict_of
from tests.fuzz.isolation import run_command_apart
from tests.fuzz.recordings import driven, write_db3, write_mcap, write_ros1

PART = "=" * 80 + "\nMSG: p/"
"""Begins the definition of another type."""
MEGABYTE = bytes(1 << 20)
GIGABYTES = 3
PACKERS: dict[str, Callable[[], bytes]] = {
    "zstd": lambda: zstd_frame(8),
    "bz2": lambda: bz2.compress(MEGABYTE * 8) * (128 * GIGABYTES),
    "lz4": lambda: lz4_frame(1024 * GIGABYTES),
}
"""Zeros, packed."""


def zstd_frame(gigabytes: int) -> bytes:
    """One frame of blocks that each repeat a byte 128 Ki times: 262 kB for 8 GiB."""
    block, blocks = (1 << 17) << 3 | 1 << 1, gigabytes << 13
    sizes = [block] * (blocks - 1) + [block | 1]  # the last one is marked
    return b"\x28\xb5\x2f\xfd\x00\x38" + b"".join(size.to_bytes(4, "little") for size in sizes)


def lz4_frame(megabytes: int) -> bytes:
    """One frame: rosbags reads no second one."""
    with lz4.frame.LZ4FrameCompressor() as one:
        return one.begin() + b"".join(one.compress(MEGABYTE) for _ in range(megabytes)) + one.flush()


def serialised(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()


def channel(definition: str = "float64 x", encoding: str = "ros2msg", qos: str = "") -> tuple[Schema, Channel]:
    """A schema and its channel."""
    metadata = {"offered_qos_profiles": qos} if qos else {}
    return Schema(1, definition.encode(), encoding, "p/msg/T"), Channel(1, "/t", "cdr", metadata, 1)


MAGIC, HEADER = b"\x89MCAP0\r\n", Header("ros2", "")


def mcap(path: Path, *records: McapRecord, summary: tuple[McapRecord, ...] = ()) -> Path:
    """A file with these records, and with others as its summary."""
    body = MAGIC + serialised(HEADER, *records)
    path.write_bytes(body + serialised(*summary, Footer(len(body) if summary else 0, 0, 0)) + MAGIC)
    return path


def chunk(data: bytes, compression: str, size: int) -> Chunk:
    return Chunk(compression, data, 2, 1, 0, size)


def message(data: bytes, time: int = 1) -> Message:
    return Message(1, time, data, time, 0)


@pytest.mark.parametrize(
    ("compression", "indexed", "told"),
    [("zstd", False, True), ("zstd", True, False), ("lz4", False, False), ("lz4", True, True)],
)
def test_a_chunk_of_an_mcap(tmp_path: Path, compression: str, indexed: bool, told: bool) -> None:
    size = (8 if compression == "zstd" else GIGABYTES) << 30 if told else 1 << 20
    whole, start = chunk(PACKERS[compression](), compression, size), len(MAGIC + serialised(HEADER))
    index = ChunkIndex(len(serialised(whole)), start, compression, len(whole.data), 2, 31, {}, 1, size)
    path = mcap(tmp_path / "a.mcap", whole, message(b""), summary=(*channel(), index) if indexed else ())
    why = refused(path, tmp_path)
    assert indexed or "takes more than 256 MB" in why, why


def test_a_chunk_of_a_ros_1_bag(tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    write_ros1(driven(), path)
    data = bytearray(path.read_bytes())
    reader = rosbag1.Reader(path)
    reader.open()
    first = min(reader.chunks.values(), key=lambda one: one.datapos)
    reader.close()
    packed = PACKERS["lz4"]()
    # Move the chunk to the end of the file, before its index.
    header = b"".join(
        struct.pack("<I", len(field)) + field
        for field in (b"op=\x05", b"compression=lz4", b"size=" + struct.pack("<I", 1 << 20))
    )
    begin, index = len(data), first.datapos + first.datasize
    infos = [found.end() for found in re.finditer(b"chunk_pos=", data)]
    data += struct.pack("<I", len(header)) + header + struct.pack("<I", len(packed)) + packed
    data += data[index : index + 2 * (55 + 12 * 2000)]
    for at in infos:
        data[at : at + 8] = struct.pack("<Q", begin)
    path.write_bytes(data)
    assert "takes more than 256 MB" in refused(path, tmp_path)


@pytest.mark.parametrize("compression", sorted(PACKERS))
def test_every_compression(compression: str) -> None:
    with pytest.raises(TooLarge, match="takes more than 256 MB"):
        inflated(PACKERS[compression](), compression)
    packed = {"zstd": zstd.compress, "bz2": bz2.compress, "lz4": lz4.frame.compress}[compression](MEGABYTE)
    assert inflated(packed, compression) == MEGABYTE
    with pytest.raises(EOFError):
        inflated(packed[:-8], compression)


def test_rosbags_decompresses_with_limits() -> None:
    with pytest.raises(TooLarge):
        rosbag1_reader.decompressors["bz2"](PACKERS["bz2"]())
    with pytest.raises(TooLarge):
        storage_mcap.DECOMPRESSORS["lz4"](PACKERS["lz4"](), 1)
    for packed in (PACKERS["zstd"](), zstd.compress(MEGABYTE) * 300):
        with pytest.raises(TooLarge):
            rosbag2_reader.zstd.decompress(packed)


@pytest.mark.parametrize("mode", ["message", "file"])
def test_a_compressed_db3(tmp_path: Path, mode: str) -> None:
    folder = tmp_path / "drive"
    write_db3(driven(), folder)
    edits = {"compression_format: ''": "compression_format: zstd", "compression_mode: ''": f"compression_mode: {mode}"}
    edits |= {"drive.db3": "d.db3.zstd"} if mode == "file" else {}
    metadata = (folder / "metadata.yaml").read_text()
    for old, new in edits.items():
        metadata = metadata.replace(old, new)
    (folder / "metadata.yaml").write_text(metadata)
    if mode == "file":
        (folder / "drive.db3").unlink()
        (folder / "d.db3.zstd").write_bytes(PACKERS["zstd"]())
    else:
        with sqlite3.connect(folder / "drive.db3") as database:
            database.execute("UPDATE messages SET data = ? WHERE id = 1", (PACKERS["zstd"](),))
    refused(folder, tmp_path)


@pytest.mark.parametrize(
    "sql",
    [
        "ALTER TABLE schema RENAME TO s; CREATE VIEW schema AS WITH RECURSIVE r(schema_version) AS "
        "(SELECT 1 UNION ALL SELECT schema_version + 1 FROM r) SELECT schema_version FROM r WHERE schema_version < 0",
        "ALTER TABLE messages RENAME TO m; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp "
        "INTEGER, data AS (zeroblob(900000000))); INSERT INTO messages SELECT id, topic_id, timestamp FROM m",
    ],
    ids=["view", "generated column"],
)
def test_sql_of_a_db3_is_not_run(tmp_path: Path, sql: str) -> None:
    write_db3(driven(), tmp_path / "drive")
    with sqlite3.connect(tmp_path / "drive" / "drive.db3") as database:
        database.executescript(sql)
    assert "is not stored but computed" in refused(tmp_path / "drive" / "drive.db3", tmp_path)


TREE = "".join(f"{PART}T{k}\nT{k + 1} a\nT{k + 1} b\n" for k in range(40)) + f"{PART}T40\nint8 x\n"
MERGES = "a0: &a0 {x: 1}\n" + "".join(f"a{k}: &a{k} {{<<: [*a{k - 1}, *a{k - 1}]}}\n" for k in range(1, 40))
BRACKETS = "module p { module msg { const long A = " + "(" * 30 + "1" + ")" * 30 + "; struct T { long x; }; }; };"
SHIFT = "module p { module msg { const long A = 1 << 99999999999; struct T { long x; }; }; };"


@pytest.mark.parametrize(
    "described",
    [
        channel("T0 x\n" + TREE),
        channel(f"E[4000000000] x\n{PART}E\n"),
        channel("string[4000000000] x"),
        channel("int32[" + "9" * 5000 + "] x"),
        channel("float32 X=1e999\nint8 x"),
        channel("T x"),
        channel(BRACKETS, "ros2idl"),
        channel(SHIFT, "ros2idl"),
        channel(qos=MERGES),
    ],
    ids=["tree", "array of nothing", "array of texts", "digits", "infinite", "itself", "brackets", "shift", "merges"],
)
def test_a_definition(tmp_path: Path, described: tuple[Schema, Channel]) -> None:
    refused(mcap(tmp_path / "a.mcap", *described, *(message(bytes(12), k) for k in range(1, 9))), tmp_path)


def test_a_sequence_of_nothing_in_ros_1(tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    with rosbag1.Writer(path) as writer:
        topic = writer.add_connection("/t", "p/msg/T", msgdef=f"E[] x\n{PART}E\n", md5sum="0" * 32)
        for k in range(1, 9):
            writer.write(topic, k, struct.pack("<I", 2**32 - 1))
    refused(path, tmp_path)


def test_messages_that_become_many_objects(tmp_path: Path) -> None:
    definition = f"E[] x\n{PART}E\nint8 y\n"
    data = struct.pack("<II", 1 << 8, 1 << 27) + bytes(1 << 27)
    packed = zstd.compress(serialised(*channel(definition), message(data)))
    refused(mcap(tmp_path / "a.mcap", chunk(packed, "zstd", 1 << 27)), tmp_path)


def test_an_index_whose_entries_share_a_chunk(tmp_path: Path) -> None:
    write_mcap(driven(), tmp_path / "drive")
    data = (tmp_path / "drive" / "drive.mcap").read_bytes()
    (start,) = struct.unpack_from("<Q", data, len(data) - 28)
    summary = make_reader(BytesIO(data)).get_summary()
    described = *summary.schemas.values(), *summary.channels.values(), summary.statistics
    end = serialised(*described, *(3000 * summary.chunk_indexes), Footer(start, 0, 0))
    (tmp_path / "a.mcap").write_bytes(data[:start] + end + MAGIC)
    assert inspected(tmp_path / "a.mcap", tmp_path)[0] in ("ok", "refused")


def test_a_table_of_repeated_numbers(tmp_path: Path) -> None:
    rows = pa.table({name: pa.array(np.zeros(1 << 22)) for name in ("time", "a", "b")})
    with pq.ParquetWriter(tmp_path / "a.parquet", rows.schema) as writer:
        for _ in range(32):
            writer.write_table(rows)
    assert "more than 1024 MB" in refused(tmp_path / "a.parquet", tmp_path)


def test_a_table_of_a_long_word(tmp_path: Path) -> None:
    words = pa.DictionaryArray.from_arrays(np.zeros(4096, np.int32), ["x" * (1 << 20)])
    pq.write_table(pa.table({"time": np.arange(4096.0), "a": np.zeros(4096), "w": words}), tmp_path / "a.parquet")
    assert "more than 1024 MB" in refused(tmp_path / "a.parquet", tmp_path)


@pytest.mark.parametrize(
    "lines",
    [
        ["time,a" + "," * 1_000_000, "1,2"],
        ["time,a", *(f"{k}," + "9" * 900_000 + " x" for k in range(9))],
        ["time,a", "1," + "9" * 50_000_000],
        ["time,a", '"' * 900_000],
        [" " * 900_000 + "x", "1 2"],
    ],
    ids=["columns", "cell", "line", "quotes", "spaces"],
)
def test_lines_of_a_table(tmp_path: Path, lines: list[str]) -> None:
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    assert inspected(tmp_path / "a.csv", tmp_path)[0] in ("ok", "refused")


@pytest.mark.parametrize("shape", ["(1, 1099511627776)", "(4000000000, 0)", "(-1,)"])
def test_the_shape_of_an_array(tmp_path: Path, shape: str) -> None:
    place = tmp_path / "drive" / "odom"
    place.mkdir(parents=True)
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    (place / "data.npy").write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + bytes(800))
    (place / "timestamps.txt").write_text("".join(f"{k}\n" for k in range(100)))
    refused(tmp_path / "drive", tmp_path)


def test_the_header_of_tensors(tmp_path: Path) -> None:
    header = ('{"__metadata__": {' + '"k": "", ' * 5_000_000 + '"k": ""}}').encode()
    (tmp_path / "a.safetensors").write_bytes(struct.pack("<Q", len(header)) + header)
    assert "its header takes more than" in refused(tmp_path / "a.safetensors", tmp_path, "check")


@pytest.mark.parametrize(
    "content", ["[" * 100_000, "a." * 500_000 + "b = 1", "a = " + "[" * 100_000, "a = [" + "1," * (1 << 25)]
)
def test_a_rig(tmp_path: Path, content: str) -> None:
    (tmp_path / "rig.toml").write_text(content)
    write_mcap(driven(), tmp_path / "drive")
    refused(tmp_path / "drive", tmp_path, "inspect", "--rig", str(tmp_path / "rig.toml"))


@pytest.mark.parametrize(
    "content", ["[" * 100_000, "9" * 10_000, "[" + "1," * (1 << 25)], ids=["deep", "digits", "long"]
)
def test_the_json_of_a_run(tmp_path: Path, content: str) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "model.json").write_text(content)
    refused(tmp_path / "run", tmp_path, "check")


def refused(path: Path, folder: Path, command: str = "inspect", *options: str) -> str:
    verdict, why = inspected(path, folder, command, *options)
    assert verdict == "refused", why
    return why


def inspected(path: Path, folder: Path, command: str = "inspect", *options: str) -> tuple[str, str]:
    """Run a command in a process with 2 GiB and 120 s; returns verdict and reason."""
    outcome = run_command_apart([command, str(path), *options], folder)
    verdict, why = verdict_of(outcome, command)
    return verdict, f"{why} ({outcome.memory >> 20} MB, {outcome.seconds:.0f} s)\n{outcome.out}{outcome.err}"
