"""Numbers and stamps of all topics of an indexed MCAP file in one pass, without decoding single messages.

Each chunk is decompressed once. Its message index gives the messages' positions; those of a topic with a constant
layout (lengths of texts and sequences, order of joints) are read as columns of a byte matrix. Of images and clouds only
the stamps are read. Everything else is left to the reference reader, `BagLog._messages`.
"""

import struct
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
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
from offpiste.logs.ros.bag_files import NUMBERS, field_getter, reported, typestore_of
from offpiste.logs.ros.bounds import fields_in

_HEAD: Final = 31
"""Size of a message record's head: opcode, length, channel, sequence, two times [bytes]."""
_LONGEST: Final = 4096
"""Size of messages above which no numbers are kept: images, clouds, maps [bytes]."""
_ENTRIES: Final = 8
"""Length of arrays above which entries are not kept (covariances) but read again on demand."""
_HEADS: Final = {"header": "std_msgs/msg/Header", "stamp": "builtin_interfaces/msg/Time"}


@dataclass
class _Layout:
    """Positions of the numbers of a message, valid while texts and sequences keep their lengths.

    Attributes:
        at: position while walking along the message.
        lengths: position and value of lengths and of texts in sequences.
        fields: position and type of each kept number, by its path.
    """

    store: Typestore
    raw: bytes
    at: int = 4
    lengths: list[tuple[int, int]] = field(default_factory=list)
    fields: dict[str, tuple[int, str]] = field(default_factory=dict)

    def add_message(self, msgtype: str, prefix: str | None) -> None:
        """Walk along a message; a `prefix` of None keeps no field."""
        for name, kind, inner, element, size in fields_in(self.store.fielddefs, msgtype):
            path = None if prefix is None else prefix + name
            if kind in (Nodetype.BASE, Nodetype.NAME):
                self._add(inner, element, path)
                continue
            count, begin = size if kind == Nodetype.ARRAY else self._length(), self.at
            if count > _LONGEST:
                raise ValueError("too long")
            for k in range(count):
                kept = inner == Nodetype.BASE and path is not None and count <= _ENTRIES
                self._add(inner, element, f"{path}[{k}]" if kept else None)
            if count and inner == Nodetype.BASE and element[0] == "string":  # names of entries must not change
                places = (*range(begin, self.at - 4, 4), self.at - 4)
                self.lengths += [(at, int.from_bytes(self.raw[at : at + 4], "little")) for at in places]

    def _add(self, kind: Nodetype, detail: Any, path: str | None) -> None:
        if kind == Nodetype.NAME:
            header = detail == "std_msgs/msg/Header"
            self.add_message(detail, None if path is None or header else f"{path}.")
        elif detail[0] == "string":
            length = self._length()
            self.at += length
        else:
            number = NUMBERS[detail[0]]
            self._align(int(number[1]))
            if path:
                self.fields[path] = self.at, number
            self.at += int(number[1])

    def _length(self) -> int:
        self._align(4)
        (value,) = struct.unpack_from("<I", self.raw, self.at)
        self.lengths.append((self.at, value))
        self.at += 4
        return int(value)

    def _align(self, width: int) -> None:
        self.at += -(self.at - 4) % width


def _layout(store: Typestore, msgtype: str, raw: bytes) -> _Layout | None:
    """Return the layout of a topic's first message in CDR; None if it contradicts the plain decoder."""
    if not 4 <= len(raw) <= _LONGEST or raw[1] != 1:
        return None
    result, row = _Layout(store, raw), np.frombuffer(raw, np.uint8)[None]
    try:
        with reported(Path(), "no layout"):
            result.add_message(msgtype, "")
            message = store.deserialize_cdr(raw, msgtype)
    except LogError:  # left to the plain decoder
        return None
    found = ((_numbers_at(row, at, kind)[0], field_getter(path)(message)) for path, (at, kind) in result.fields.items())
    return result if all(np.array_equal(one, other, equal_nan=True) for one, other in found) else None


@dataclass(frozen=True)
class Columns:
    """Numbers of a topic in order of arrival."""

    arrival: Int[np.ndarray, " n"]  # arrival, stamp: by the recorder and by the message, 0 if it has none [ns]
    stamp: Int[np.ndarray, " n"]
    filed: Int[np.ndarray, " n"]  # `arrival` in file order [ns]
    fields: tuple[str, ...]  # a column of `values` each; empty for messages that are long or change their layout
    values: Float[np.ndarray, "n k"]

    def seconds(self, stamps: str) -> Float[np.ndarray, " n"]:
        """Return header or receive times [s], rounded as by `stamp_of`."""
        chosen = np.where(self.stamp != 0, self.stamp, self.arrival) if stamps == "header" else self.arrival
        return np.array([time / 10**9 for time in chosen.tolist()])


class _Topic:
    """Data of a connection gathered over chunks: rows of arrival and stamp, and of values while regular."""

    def __init__(self, connection: Connection, path: Path) -> None:
        if getattr(connection.ext, "serialization_format", "") != "cdr":
            raise LogError("is not encoded as CDR")
        self.msgtype, self.store = connection.msgtype, typestore_of(connection, path)
        fields = self.store.get_msgdef(self.msgtype).fields
        self.headed = bool(fields) and fields[0][1] == (Nodetype.NAME, _HEADS.get(fields[0][0]))
        if set(_HEADS) & {name for name, _ in fields[self.headed :]}:
            raise LogError("has its stamp elsewhere")
        self.layout: _Layout | None = None
        self.regular = True
        self.times: list[Int[np.ndarray, "m 2"]] = []
        self.values: list[Float[np.ndarray, "m k"]] = []

    def gather(self, data: UInt8[np.ndarray, " n"], index: Int[np.ndarray, "m 2"]) -> None:
        """Append the messages of a chunk, given their arrivals and positions."""
        begin = index[:, 1] + _HEAD
        size = _numbers_at(_rows(data, begin - _HEAD + 1, 8), 0, "i8") - (_HEAD - 9)
        stamp = np.zeros(len(index), np.int64)
        if self.headed:
            head = _rows(data, begin, 12)
            if size.min() < 12 or not (head[:, 1] == 1).all():
                raise ValueError("messages without a little-endian header")
            stamp = _numbers_at(head, 4, "i4").astype(np.int64) * 10**9 + _numbers_at(head, 8, "u4")
        self.times.append(np.column_stack((index[:, 0], stamp)))
        if not self.values and self.regular:
            first = data[begin[0] : begin[0] + size[0]].tobytes()
            self.layout = _layout(self.store, self.msgtype, first)
        known = self.layout
        self.regular = self.regular and known is not None and bool((size == len(known.raw)).all())
        if known is None or not self.regular:
            return
        if len(begin) * (_HEAD + len(known.raw)) > len(data):
            raise ValueError("the index counts messages several times")
        rows = _rows(data, begin, len(known.raw))
        self.regular = all((_numbers_at(rows, at, "u4") == value).all() for at, value in known.lengths)
        columns = [_numbers_at(rows, at, kind).astype(float) for at, kind in known.fields.values()]
        self.values.append(np.stack(columns, axis=1) if columns else np.zeros((len(rows), 0)))

    def columns(self) -> Columns:
        """Return all messages in order of arrival."""
        times = np.concatenate(self.times)
        order = np.argsort(times[:, 0], kind="stable")
        fields = tuple(self.layout.fields) if self.regular and self.layout is not None else ()
        values = np.concatenate(self.values)[order] if fields else np.zeros((len(times), 0))
        arrival, stamp = times[order].T
        return Columns(arrival, stamp, times[:, 0], fields, values)


def columns_of(reader: object, path: Path) -> dict[int, Columns]:
    """Return columns by connection id, without connections that cannot be read as columns.

    None are returned for formats other than MCAP and for damaged files, which the plain reader reports.
    """
    storage = reader.storage if isinstance(reader, Rosbag2) else None
    if not isinstance(storage, McapReader):
        return {}
    topics: dict[int, _Topic] = {}
    for connection in storage.connections:
        with suppress(LogError):  # the plain reader reports faulty definitions
            topics[connection.id] = _Topic(connection, path)
    try:
        with reported(path, "cannot be read by columns"):
            for index, data in _chunks(storage) if topics else ():
                for channel in topics.keys() & index.keys():
                    topics[channel].gather(data, index[channel])
    except LogError:
        return {}
    counts = {connection.id: connection.msgcount for connection in storage.connections}
    whole = (id for id, topic in topics.items() if topic.times and sum(map(len, topic.times)) == counts[id])
    return {id: topics[id].columns() for id in whole}


_Index = dict[int, Int[np.ndarray, "_ 2"]]


def _chunks(storage: McapReader) -> Iterator[tuple[_Index, UInt8[np.ndarray, " n"]]]:
    """Yield the message index and the content of each chunk while the next is decompressed.

    Up to three chunks are held, of at most `LARGEST` each.
    """
    ready: tuple[_Index, Future[Any]] | None = None
    with Path(str(storage.path)).open("rb") as file, ThreadPoolExecutor(1) as pool:
        for chunk in sorted(storage.chunks, key=lambda one: one.chunk_start_offset):
            file.seek(chunk.chunk_start_offset)
            record = file.read(chunk.chunk_length + chunk.message_index_length)
            index = _message_index(memoryview(record)[chunk.chunk_length :])
            given, ready = ready, (index, pool.submit(_content, record, chunk))
            if given is not None:
                yield given[0], given[1].result()
        if ready is not None:
            yield ready[0], ready[1].result()


def _content(record: bytes, chunk: ChunkInfo) -> UInt8[np.ndarray, " n"]:
    (crc,) = struct.unpack_from("<I", record, 9 + 24)
    begin = 9 + 40 + len(chunk.compression)
    packed = record[begin : begin + chunk.compressed_size]
    return np.frombuffer(decompress(packed, chunk.compression, chunk.uncompressed_size, crc), np.uint8)


def _message_index(records: memoryview) -> _Index:
    """Return the arrival [ns] and the position in the chunk of each channel's messages, in file order."""
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


def _rows(data: UInt8[np.ndarray, " n"], begin: Int[np.ndarray, " m"], size: int) -> UInt8[np.ndarray, "m k"]:
    return np.asarray(data[begin[:, None] + np.arange(size)])


def _numbers_at(rows: UInt8[np.ndarray, "m k"], at: int, kind: str) -> np.ndarray:
    """Decode the value of type `kind` at byte offset `at` in each row."""
    return np.ascontiguousarray(rows[:, at : at + int(kind[1])]).view(f"<{kind}")[:, 0]
