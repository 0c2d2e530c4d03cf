"""Numbers and stamps of all topics of an indexed MCAP file in one pass, without decoding message by message.

Each chunk is decompressed once. Its message index says where messages begin; those of a topic whose layout stays the
same (each text and sequence its length, each joint its place) are read as columns of a byte matrix. Of images and
clouds nothing is read but the stamp. What does not fit is left to the plain reader, `BagLog._messages`, the reference.
"""

import struct
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Int, UInt8
from rosbags.interfaces import Connection, Nodetype
from rosbags.rosbag2 import Reader as Rosbag2
from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader, decompress
from rosbags.typesys.store import Typestore

from offpiste.core.errors import LogError
from offpiste.core.limits import LARGEST
from offpiste.logs.ros.bag_files import frames_reader, reported, typestore_of
from offpiste.logs.ros.message_layout import LONGEST, Layout, layout, numbers_at

_AHEAD: Final = 4
"""Chunks that are decompressed at the same time, at most; together no more than `LARGEST` bytes."""
_HEAD: Final = 31
"""Bytes of a message record before its data: opcode, length, channel, sequence, two times."""
_HEADS: Final = {"header": "std_msgs/msg/Header", "stamp": "builtin_interfaces/msg/Time"}


@dataclass(frozen=True)
class Columns:
    """Numbers of a topic in the order of arrival.

    Attributes:
        arrival, stamp: by the recorder's clock, and by the message, 0 where it has none [ns].
        filed: `arrival` in the order of the file [ns].
        frames: the different ones that messages have (`frames_reader`); none without a header.
        sender: index into `frames` of each message.
        fields, values: one column each; none for messages that are long or change their layout.
    """

    arrival: Int[np.ndarray, " n"]
    stamp: Int[np.ndarray, " n"]
    filed: Int[np.ndarray, " n"]
    frames: tuple[tuple[str, str], ...]
    sender: Int[np.ndarray, " n"]
    fields: tuple[str, ...]
    values: Float[np.ndarray, "n k"]

    def seconds(self, stamps: str) -> Float[np.ndarray, " n"]:
        """Header or receive times [s], rounded as by `stamp_of`."""
        chosen = np.where(self.stamp != 0, self.stamp, self.arrival) if stamps == "header" else self.arrival
        return np.array([time / 10**9 for time in chosen.tolist()])


@dataclass
class _Topic:
    """What is gathered of a connection while chunks go by."""

    store: Typestore
    msgtype: str
    headed: bool
    frames_of: Callable[[bytes], tuple[str, str, int]] | None
    layout: Layout | None = None
    regular: bool = True
    arrival: list[np.ndarray] = field(default_factory=list)
    stamp: list[np.ndarray] = field(default_factory=list)
    values: list[np.ndarray] = field(default_factory=list)
    frames: dict[tuple[str, str], int] = field(default_factory=dict)
    sender: list[np.ndarray] = field(default_factory=list)


def columns_of(reader: object, path: Path) -> dict[int, Columns]:
    """Columns by a connection's id of an opened file; none for formats other than MCAP, and for damaged files."""
    files = [reader.storage] if isinstance(reader, Rosbag2) else []
    if not files or not isinstance(files[0], McapReader):
        return {}
    try:
        with reported(path, "cannot be read by columns"):
            return read_columns(files[0], files[0].connections, lambda connection: typestore_of(connection, path))
    except LogError:  # damage is the plain reader's to name, and to read around
        return {}


def read_columns(
    reader: McapReader, connections: Sequence[Connection], store_of: Callable[[Connection], Typestore]
) -> dict[int, Columns]:
    """Columns by a connection's id; connections that cannot be read so are left out.

    On a damaged file errors of rosbags, lz4 and zstd pass through; the plain reader names the place.
    """
    topics = {c.id: topic for c in connections if (topic := _topic(c, store_of)) is not None}
    if not reader.chunks or not topics:
        return {}
    for chunk, data in _chunks(reader.path, sorted(reader.chunks, key=lambda one: one.chunk_start_offset)):
        for channel, index in chunk.items():
            if channel in topics:
                _gather(topics[channel], data, index)
    result = {}
    for connection in connections:
        topic = topics.get(connection.id)
        if topic is not None and topic.arrival and sum(map(len, topic.arrival)) == connection.msgcount:
            result[connection.id] = _joined(topic)
    return result


def _topic(connection: Connection, store_of: Callable[[Connection], Typestore]) -> _Topic | None:
    if getattr(connection.ext, "serialization_format", "") != "cdr":
        return None
    try:
        store = store_of(connection)
        fields = store.get_msgdef(connection.msgtype).fields
    except LogError:  # the plain reader says what is wrong with a definition
        return None
    headed = bool(fields) and fields[0][1] == (Nodetype.NAME, _HEADS.get(fields[0][0]))
    if set(_HEADS) & {name for name, _ in fields[headed:]}:
        return None
    return _Topic(store, connection.msgtype, headed, frames_reader(connection, Path()))


_Index = dict[int, Int[np.ndarray, "_ 2"]]


def _chunks(path: Any, chunks: Sequence[ChunkInfo]) -> Iterator[tuple[_Index, UInt8[np.ndarray, " n"]]]:
    """Message index and content of every chunk, some decompressed ahead by threads."""
    with Path(str(path)).open("rb") as file, ThreadPoolExecutor(2) as pool:

        def load(chunk: ChunkInfo) -> tuple[_Index, Any]:
            file.seek(chunk.chunk_start_offset)
            record = file.read(chunk.chunk_length + chunk.message_index_length)
            return _message_index(memoryview(record)[chunk.chunk_length :]), pool.submit(_content, record, chunk)

        ahead, loaded = deque[tuple[_Index, Any]](), 0
        for number in range(len(chunks)):
            while loaded < len(chunks) and loaded < number + _AHEAD:
                if loaded > number and sum(one.uncompressed_size for one in chunks[number : loaded + 1]) > LARGEST:
                    break
                ahead.append(load(chunks[loaded]))
                loaded += 1
            index, content = ahead.popleft()
            yield index, content.result()


def _content(record: bytes, chunk: ChunkInfo) -> UInt8[np.ndarray, " n"]:
    (crc,) = struct.unpack_from("<I", record, 9 + 24)
    begin = 9 + 40 + len(chunk.compression)
    packed = record[begin : begin + chunk.compressed_size]
    return np.frombuffer(decompress(packed, chunk.compression, chunk.uncompressed_size, crc), np.uint8)


def _message_index(records: memoryview) -> _Index:
    """Time of arrival [ns] and place in the chunk of the messages of each channel, in the order of the file."""
    result: _Index = {}
    at = 0
    while at + 9 <= len(records):
        opcode, length = struct.unpack_from("<BQ", records, at)
        if opcode == 0x07:
            channel, size = struct.unpack_from("<HI", records, at + 9)
            entries = np.frombuffer(records[at + 15 : at + 15 + size], "<i8").reshape(-1, 2)
            if len(entries):
                result[channel] = entries[np.argsort(entries[:, 1], kind="stable")]
        at += 9 + length
    return result


def _gather(topic: _Topic, data: UInt8[np.ndarray, " n"], index: Int[np.ndarray, "m 2"]) -> None:
    begin = index[:, 1] + _HEAD
    size = numbers_at(_rows(data, begin - _HEAD + 1, 8), 0, "i8") - (_HEAD - 9)
    topic.arrival.append(index[:, 0].copy())
    head = _rows(data, begin, 12) if topic.headed else None
    if head is not None and (size.min() < 12 or not (head[:, 1] == 1).all()):
        raise ValueError("messages without a little-endian header")
    topic.stamp.append(np.zeros(len(index), np.int64) if head is None else _stamps(head))
    topic.sender.append(_senders(topic, data, begin, size))
    if not topic.regular:
        return
    if topic.layout is None:
        first = data[begin[0] : begin[0] + size[0]].tobytes()
        topic.layout = None if len(first) > LONGEST else layout(topic.store, topic.msgtype, first)
    known = topic.layout
    topic.regular = known is not None and bool((size == known.size).all())
    if known is None or not topic.regular:
        return
    if len(begin) * (_HEAD + known.size) > len(data):
        raise ValueError("the index counts messages several times")
    rows = _rows(data, begin, known.size)
    topic.regular = all((numbers_at(rows, at, "u4") == value).all() for at, value in known.lengths)
    if not topic.regular:
        return
    topic.values.append(np.zeros((len(rows), len(known.fields))))
    for column, (at, kind) in zip(topic.values[-1].T, known.fields.values(), strict=True):
        column[:] = numbers_at(rows, at, kind)


def _senders(
    topic: _Topic, data: UInt8[np.ndarray, " n"], begin: Int[np.ndarray, " m"], size: Int[np.ndarray, " m"]
) -> Int[np.ndarray, " m"]:
    """Index into the topic's frames of each message."""
    if topic.frames_of is None:
        return np.zeros(len(begin), np.int64)
    first, child, end = topic.frames_of(data[begin[0] : begin[0] + size[0]].tobytes())
    number = topic.frames.setdefault((first, child), len(topic.frames))
    if size.min() >= end:
        rows = _rows(data, begin + 12, end - 12)
        if (rows == rows[0]).all():
            return np.full(len(begin), number)
    each = (topic.frames_of(data[at : at + n].tobytes())[:2] for at, n in zip(begin, size, strict=True))
    return np.array([topic.frames.setdefault(frames, len(topic.frames)) for frames in each])


def _joined(topic: _Topic) -> Columns:
    arrival, stamp = np.concatenate(topic.arrival), np.concatenate(topic.stamp)
    order, filed, sender = np.argsort(arrival, kind="stable"), arrival, np.concatenate(topic.sender)
    fields = tuple(topic.layout.fields) if topic.regular and topic.layout is not None else ()
    values = np.concatenate(topic.values) if fields else np.zeros((len(arrival), 0))
    if not (np.diff(order) == 1).all():
        arrival, stamp, values, sender = arrival[order], stamp[order], values[order], sender[order]
    return Columns(arrival, stamp, filed, tuple(topic.frames), sender, fields, values)


def _rows(data: UInt8[np.ndarray, " n"], begin: Int[np.ndarray, " m"], size: int) -> UInt8[np.ndarray, "m k"]:
    return np.asarray(data[begin[:, None] + np.arange(size)])


def _stamps(head: UInt8[np.ndarray, "m k"]) -> Int[np.ndarray, " m"]:
    seconds, rest = numbers_at(head, 4, "i4").astype(np.int64), numbers_at(head, 8, "u4").astype(np.int64)
    return seconds * 10**9 + rest
