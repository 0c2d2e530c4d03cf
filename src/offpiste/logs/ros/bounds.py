"""Limits of a ROS bag's decompression, definitions, indexes, YAML and SQL.

rosbags decompresses whatever a file holds, unrolls definitions into Python code and expands YAML. Importing this module
replaces its decompression, YAML and storage by bounded ones.
"""

import bz2
import re
import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any, Final
from urllib.parse import quote

import lz4.frame  # type: ignore[import-untyped]
from rosbags import rosbag1
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import reader as rosbag1_reader
from rosbags.rosbag2 import metadata, storage_mcap
from rosbags.rosbag2 import reader as rosbag2_reader
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from rosbags.typesys import TypesysError
from ruamel.yaml import YAML

from offpiste.core.limits import LARGEST, LARGEST_TEXT, refuse_larger, zstd

_PIECE: Final = 1 << 22
"""Number of bytes decompressed at a time."""
_SMALLER: Final = "`mcap compress FILE -o SMALLER.mcap` writes smaller chunks, of ROS 1 `rosbag record --chunksize=768`"
MOST_OBJECTS: Final = 1 << 25
"""Longest message with sequences of messages or texts, whose entries take at least 30 times their size [bytes]."""
_MOST_FIELDS: Final = 1 << 14
"""Largest number of fields in a message's definition, including entries of arrays of messages."""
_LARGEST_DEFINITION: Final = 1 << 20
"""Longest definition of a message [characters]."""
_MOST_EXPANSION: Final = 100
"""Largest expansion of a compressed bag file on disk, beyond `LARGEST`."""

_DECOMPRESSORS: Final[dict[str, Callable[[], Any]]] = {
    "bz2": bz2.BZ2Decompressor,
    "lz4": lz4.frame.LZ4FrameDecompressor,
    "zstd": zstd.ZstdDecompressor,
}


def inflated(data: bytes, compression: str) -> bytes:
    """Decompress a chunk or a message by bz2, lz4, zstd, or "" for none, up to `LARGEST`."""
    parts: list[bytes] = []
    size = 0
    if not compression:
        parts, size, data = [data], len(data), b""
    while data:  # each frame
        one = _DECOMPRESSORS[compression]()
        given = data
        while not one.eof and size <= LARGEST:
            parts.append(one.decompress(given, _PIECE))
            given = b""
            size += len(parts[-1])
            if not parts[-1] and one.needs_input:
                raise EOFError("compressed data are cut short")
        data = (one.unused_data or b"") if one.eof and size <= LARGEST else b""
    if size > LARGEST:
        parts.clear()  # the error keeps this frame alive
    refuse_larger(size, "a chunk of it", how=_SMALLER)
    return parts[0] if len(parts) == 1 else b"".join(parts)


def _opened(source: IO[bytes], mode: str) -> Any:
    """Open a compressed bag file whose expansion on disk is bounded."""
    assert mode == "rb"
    free = shutil.disk_usage(tempfile.gettempdir()).free
    return _Bounded(source, min(LARGEST + _MOST_EXPANSION * Path(source.name).stat().st_size, free // 2))


class _Bounded(zstd.ZstdFile):
    def __init__(self, source: IO[bytes], most: int) -> None:
        super().__init__(source, "rb")
        self._left, self._most, self._of = most, most, source.name

    def read(self, size: int | None = -1) -> bytes:
        """Read decompressed bytes up to the limit."""
        data: bytes = super().read(_PIECE if size is None or size < 0 else min(size, _PIECE))
        self._left -= len(data)
        refuse_larger(self._most - self._left, "it, decompressed,", self._most, where=self._of, how=_SMALLER)
        return data


class _PlainYaml(YAML):
    """YAML without merge keys, by which a few lines expand to gigabytes."""

    def load(self, stream: Any) -> Any:
        """Load as ruamel.yaml does."""
        text = stream if isinstance(stream, str) else stream.read()
        refuse_larger(len(text), "its YAML", LARGEST_TEXT >> 5)
        if "<<" in text:
            raise ValueError("its YAML has merge keys, which no bag needs")
        return super().load(text)


class Rosbag1(rosbag1.Reader):
    """ROS 1 bag whose index has no more entries than the file has room for."""

    def read_index_data(self, pos: int, indexes: dict[int, list[Any]]) -> None:
        """Read an index record as rosbags does."""
        super().read_index_data(pos, indexes)
        if 12 * sum(map(len, indexes.values())) > self.path.stat().st_size:
            raise ValueError("its index counts messages several times")


class _Mcap(McapReader):
    """MCAP file whose chunks that overlap in time, all of which rosbags holds in memory, are bounded."""

    def _open(self) -> None:
        super()._open()
        chunks = sorted(self.chunks, key=lambda chunk: chunk.chunk_start_offset)
        ends = [0, *(chunk.chunk_start_offset + chunk.chunk_length for chunk in chunks)]
        if any(chunk.chunk_start_offset < end for chunk, end in zip(chunks, ends, strict=False)):
            raise ValueError("its index has chunks that overlap")
        steps, held = [], 0
        for chunk in chunks:
            refuse_larger(chunk.uncompressed_size, "a chunk of it", how=_SMALLER)
            steps.append((chunk.message_start_time, chunk.uncompressed_size))
            steps.append((chunk.message_end_time + 1, -chunk.uncompressed_size))
        for _, size in sorted(steps):
            held += size
            refuse_larger(held, "what of it overlaps in time", 2 * LARGEST, how="`mcap sort` puts it in order")


class _Sqlite(Sqlite3Reader):
    """SQLite file without views, generated columns and virtual tables, which would run SQL of the file."""

    def open(self) -> None:
        """Open as rosbags does."""
        file = f"file:{quote(str(Path(str(self.path)).absolute()))}?mode=ro&immutable=1"
        with closing(sqlite3.connect(file, uri=True)) as database:
            for kind, name, sql in database.execute("SELECT type, name, sql FROM sqlite_master").fetchall():
                columns = database.execute("SELECT hidden FROM pragma_table_xinfo(?)", (name,)).fetchall()
                virtual = re.match(r"\s*create\s+virtual", str(sql), re.IGNORECASE)
                if kind == "view" or virtual or any(hidden for (hidden,) in columns):
                    raise ValueError(f"its '{name}' is not stored but computed, which no bag needs")
        super().open()


def refuse_text(text: str, *, idl: bool) -> None:
    """Refuse the text of a definition that takes too long to parse."""
    if len(text) > _LARGEST_DEFINITION:
        raise TypesysError(f"{len(text)} characters, more than {_LARGEST_DEFINITION}")
    # rosbags' parser of IDL tries each part in brackets 64 times, and computes with numbers of any length.
    code = re.sub(r'"(?:\\.|[^"\\])*"|/\*.*?\*/|//[^\n]*', "", text, flags=re.DOTALL) if idl else ""
    if re.search(r"<<|\*|\([^()]*\(", code):
        raise TypesysError("computed constants are not supported")


def fields_in(types: Mapping[str, Any], name: str) -> Iterator[tuple[str, Nodetype, Nodetype, Any, int]]:
    """Yield the name, kind, kind of entries, type of entries and number of entries of a type's fields.

    Single values are their own entry; sequences have 0, and undefined types have no fields.
    """
    for field, (kind, detail) in types[name][1] if name in types else ():
        (inner, element), size = ((kind, detail), 1) if kind in (Nodetype.BASE, Nodetype.NAME) else detail
        yield field, kind, inner, element, 0 if kind == Nodetype.SEQUENCE else size


def refuse_expansion(types: Mapping[str, Any], name: str, *, ros1: bool) -> None:
    """Refuse definitions that expand to very many fields, or to a sequence of empty messages, in rosbags' `types`."""
    counts: dict[str, int] = {}

    def count(one: str) -> int:
        if one not in counts:
            total = 0
            for _, kind, inner, element, size in fields_in(types, one):
                unrolled = kind == Nodetype.ARRAY and (inner == Nodetype.NAME or element[0] == "string")
                total += (count(element) if inner == Nodetype.NAME else 1) * (size if unrolled else 1)
            counts[one] = max(1, total)
            if counts[one] > _MOST_FIELDS:
                raise TypesysError(f"more than {_MOST_FIELDS} fields")
        return counts[one]

    count(name)
    for one in counts if ros1 else ():
        for _, kind, inner, element, _ in fields_in(types, one):
            if kind == Nodetype.SEQUENCE and inner == Nodetype.NAME and _is_nothing(types, element):
                raise TypesysError(f"a sequence of {element}, which has no fields")


def has_entries(types: Mapping[str, Any], name: str) -> bool:
    """Return whether a type accepted by `refuse_expansion` has sequences that are decoded entry by entry."""
    return any(
        (kind == Nodetype.SEQUENCE and (inner == Nodetype.NAME or element[0] == "string"))
        or (inner == Nodetype.NAME and has_entries(types, element))
        for _, kind, inner, element, _ in fields_in(types, name)
    )


def _is_nothing(types: Mapping[str, Any], name: str) -> bool:
    """Return whether messages of a type take no bytes in ROS 1."""
    return all(kind == Nodetype.NAME and _is_nothing(types, part) for _, kind, _, part, _ in fields_in(types, name))


def _bound_rosbags() -> None:
    for name in ("", "lz4", "zstd"):
        storage_mcap.DECOMPRESSORS[name] = lambda data, _, kind=name: inflated(data, kind)  # type: ignore[misc]
    for name, kind in (("none", ""), ("bz2", "bz2"), ("lz4", "lz4")):
        rosbag1_reader.decompressors[name] = partial(inflated, compression=kind)
    rosbag2_reader.zstd = SimpleNamespace(decompress=lambda data: inflated(data, "zstd"), open=_opened)  # type: ignore
    for plugins in (rosbag2_reader.Reader.STORAGE_PLUGINS, rosbag2_reader.DirectoryReader.STORAGE_PLUGINS):
        for name, plugin in ((".mcap", _Mcap), ("mcap", _Mcap), (".db3", _Sqlite), ("sqlite3", _Sqlite)):
            if name in plugins:
                plugins[name] = plugin  # type: ignore[index]
    rosbag2_reader.YAML = metadata.YAML = _PlainYaml  # type: ignore


_bound_rosbags()
