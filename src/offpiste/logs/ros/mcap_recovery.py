"""Recovery of MCAP files that are truncated, or that rosbags refuses, by reading them without their index."""

import struct
import zlib
from collections import Counter
from collections.abc import Collection, Iterator
from io import SEEK_CUR, BufferedReader, BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.typesys.msg import normalize_msgtype

from offpiste.core.errors import LogError
from offpiste.core.limits import refuse_larger, zstd
from offpiste.logs.ros.bounds import inflated

_FORMATS = {
    "ros1msg": MessageDefinitionFormat.MSG,
    "ros2msg": MessageDefinitionFormat.MSG,
    "ros2idl": MessageDefinitionFormat.IDL,
    "omgidl": MessageDefinitionFormat.IDL,
}
_DAMAGE = (McapError, struct.error, ValueError, OverflowError, RuntimeError, EOFError, zstd.ZstdError)
"""Errors of mcap, lz4 and zstd on damaged bytes."""


class StreamedMcap:
    """Reader with the part of rosbags' interface that `BagLog` needs; messages are in file order.

    Attributes:
        connections: one per channel, with the number of its complete messages.
        warnings: notes on missing parts.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._damaged, self._finished = 0, False
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        counts: Counter[int] = Counter()
        for record in self._records():
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            else:
                counts[record.channel_id] += 1
        if not channels:
            raise LogError("not a single complete message", where=path, how="record or copy it again")
        self.connections = [
            self._connection(channel, schemas.get(channel.schema_id), counts[channel.id])
            for channel in channels.values()
        ]
        self.warnings = self._missing(sum(counts.values()))

    def messages(self, connections: Collection[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield the connection, the arrival [ns] and the raw bytes of each complete message."""
        wanted = {connection.id: connection for connection in connections}
        for record in self._records():
            if isinstance(record, Message) and record.channel_id in wanted:
                yield wanted[record.channel_id], record.log_time, record.data

    def close(self) -> None:
        """Do nothing: no file is kept open."""

    def _connection(self, channel: Channel, schema: Schema | None, count: int) -> Connection:
        definition = MessageDefinition(MessageDefinitionFormat.NONE, "")
        if schema is not None and schema.encoding in _FORMATS:
            definition = MessageDefinition(_FORMATS[schema.encoding], schema.data.decode("utf-8", "replace"))
        return Connection(
            id=channel.id,
            topic=channel.topic,
            msgtype=normalize_msgtype(schema.name) if schema is not None else "no type",
            msgdef=definition,
            digest="",
            msgcount=count,
            ext=ConnectionExtRosbag2(channel.message_encoding, []),
            owner=self,
        )

    def _missing(self, kept: int) -> tuple[str, ...]:
        notes = []
        if not self._finished:
            repair = f"`mcap recover {self.path.name} -o REPAIRED.mcap` repairs it"
            cause = "the MCAP file is truncated (the recorder was killed, or the copy interrupted)"
            notes.append(f"{self.path}: {cause}; its {kept} whole messages are read; {repair}")
        if self._damaged:
            notes.append(f"{self.path}: damaged records that are skipped: {self._damaged}")
        return tuple(notes)

    def _records(self) -> Iterator[Schema | Channel | Message]:
        self._damaged = 0
        with self.path.open("rb") as file:
            file.seek(8)  # the magic, which `BagLog` has checked
            yield from self._walk(file, self.path.stat().st_size)

    def _walk(self, file: BufferedReader | BytesIO, size: int) -> Iterator[Schema | Channel | Message]:
        in_chunk = isinstance(file, BytesIO)
        while len(head := file.read(9)) == 9:
            opcode, length = struct.unpack("<BQ", head)
            self._finished = opcode in (Opcode.DATA_END, Opcode.FOOTER)
            if self._finished or opcode == 0:  # a crash can leave blocks of zeros at the end
                return
            if length > size - file.tell():
                return
            if opcode not in (Opcode.CHUNK, *_READERS):
                file.seek(length, SEEK_CUR)
                continue
            refuse_larger(length, "a record of it", where=self.path)
            body = file.read(length)
            try:
                if opcode == Opcode.CHUNK and not in_chunk:
                    data = _unpack(Chunk.read(ReadDataStream(BytesIO(body))))
                    yield from self._walk(BytesIO(data), len(data))
                elif opcode in _READERS:
                    yield _READERS[opcode](body)
            except _DAMAGE:
                self._damaged += 1


def _unpack(chunk: Chunk) -> bytes:
    """Decompress a chunk."""
    if chunk.compression not in ("", "lz4", "zstd"):
        raise ValueError(f"unknown compression {chunk.compression}")
    data = inflated(chunk.data, chunk.compression)
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ValueError("checksum mismatch")
    return data


_READERS = {
    Opcode.SCHEMA: lambda body: Schema.read(ReadDataStream(BytesIO(body))),
    Opcode.CHANNEL: lambda body: Channel.read(ReadDataStream(BytesIO(body))),
    Opcode.MESSAGE: lambda body: Message.read(ReadDataStream(BytesIO(body)), len(body)),
}
