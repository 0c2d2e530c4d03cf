"""Where the numbers of a message in CDR lie, so that many messages of one layout are read as columns of bytes."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import UInt8
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from offpiste.core.errors import LogError
from offpiste.logs.ros.bag_files import field_getter, reported

LONGEST: Final = 4096
"""Messages that are longer have no numbers that are kept: images, clouds, maps [bytes]."""
_ENTRIES: Final = 8
"""Arrays with more entries (covariances) are not kept; they are read again where they are asked for."""
_TYPES: Final = {
    "bool": "u1", "byte": "u1", "char": "u1", "uint8": "u1", "int8": "i1", "uint16": "u2", "int16": "i2",
    "uint32": "u4", "int32": "i4", "uint64": "u8", "int64": "i8", "float32": "f4", "float64": "f8",
}  # fmt: skip


@dataclass(frozen=True)
class Layout:
    """Where the numbers of a message are, as long as texts and sequences keep their lengths.

    Attributes:
        size: of the message [bytes].
        lengths: place and value of every length of a text or sequence, and of all words of a sequence of texts.
        fields: place and type of every number that is kept, by its path.
    """

    size: int
    lengths: tuple[tuple[int, int], ...]
    fields: dict[str, tuple[int, str]]


def layout(store: Typestore, msgtype: str, raw: bytes) -> Layout | None:
    """Layout of a topic by its first message in CDR; None where it is not what the plain decoder reads."""
    if len(raw) < 4 or raw[1] != 1:
        return None
    walk = _Walk(raw)
    try:
        with reported(Path(), "no layout"):
            _walk(store, msgtype, walk, "")
            message = store.deserialize_cdr(raw, msgtype)
        row = np.frombuffer(raw, np.uint8)[None]
        for path, (at, kind) in walk.fields.items():
            if not np.array_equal(numbers_at(row, at, kind)[0], field_getter(path)(message), equal_nan=True):
                return None
    except LogError:  # whatever is damaged or unusual is the plain decoder's
        return None
    return Layout(len(raw), tuple(walk.lengths), walk.fields)


def numbers_at(rows: UInt8[np.ndarray, "m k"], at: int, kind: str) -> np.ndarray:
    """The number of a type at a place of every row of bytes."""
    return np.ascontiguousarray(rows[:, at : at + int(kind[1])]).view(f"<{kind}")[:, 0]


@dataclass
class _Walk:
    raw: bytes
    at: int = 4
    lengths: list[tuple[int, int]] = field(default_factory=list)
    fields: dict[str, tuple[int, str]] = field(default_factory=dict)

    def align(self, width: int) -> None:
        self.at += -(self.at - 4) % width

    def length(self) -> int:
        self.align(4)
        (value,) = struct.unpack_from("<I", self.raw, self.at)
        self.lengths.append((self.at, value))
        self.at += 4
        return int(value)

    def number(self, kind: str, path: str) -> None:
        width = int(kind[1])
        self.align(width)
        if path:
            self.fields[path] = self.at, kind
        self.at += width


def _walk(store: Typestore, msgtype: str, walk: _Walk, prefix: str | None) -> None:
    """Move along a message; a `prefix` of None keeps no field."""
    entries: Sequence[tuple[str, Any]] = store.get_msgdef(msgtype).fields
    for name, (kind, detail) in entries:
        path = None if prefix is None else prefix + name
        if kind in (Nodetype.BASE, Nodetype.NAME):
            _one(store, kind, detail, walk, path)
            continue
        (inner, element), size = detail
        count, begin = size if kind == Nodetype.ARRAY else walk.length(), walk.at
        if count > LONGEST:
            raise ValueError("too long")
        for k in range(count):
            kept = inner == Nodetype.BASE and path is not None and count <= _ENTRIES
            _one(store, inner, element, walk, f"{path}[{k}]" if kept else None)
        if count and inner == Nodetype.BASE and element[0] == "string":  # names of entries have to stay the same
            places = (*range(begin, walk.at - 4, 4), walk.at - 4)
            walk.lengths += [(at, int.from_bytes(walk.raw[at : at + 4], "little")) for at in places]


def _one(store: Typestore, kind: Nodetype, detail: Any, walk: _Walk, path: str | None) -> None:
    if kind == Nodetype.NAME:
        header = detail == "std_msgs/msg/Header"
        _walk(store, detail, walk, None if path is None or header else f"{path}.")
    elif detail[0] == "string":
        length = walk.length()
        walk.at += length
    else:
        walk.number(_TYPES[detail[0]], path or "")
