"""Decoding of ROS 1 and ROS 2 messages by the definitions that the bag carries, and their numeric fields."""

import functools
import math
import struct
from collections.abc import Callable, Iterator, Sequence
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from rosbags.interfaces import Connection, ConnectionExtRosbag1, MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from offpiste.errors import LogError

_OCTETS = {"byte", "char", "uint8"}
_NUMBERS = _OCTETS | {"bool", "int8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"}
MakeDecoder = Callable[[Connection, Path], Callable[[bytes], object]]
"""Makes the decoder of a connection's messages, given the path of its bag for errors."""

_MAX_ENTRIES = 36
"""Longest array that is listed entry by entry: a 6 x 6 covariance; longer ones are bulk data."""


def stamp_of(received: int, message: object, stamps: str) -> float:
    """Time of a message [s] by its header or by its arrival."""
    return ((stamps == "header" and _header_stamp(message)) or received) / 10**9  # exact, unlike 1e9


def _header_stamp(message: Any) -> int:
    """Stamp in a message's header [ns]; 0 where it has none."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return 0 if stamp is None else stamp.sec * 10**9 + stamp.nanosec


def field_getter(field: str) -> Callable[[object], float]:
    """Function that reads a field of `fields_of` from a decoded message; NaN where a sequence has fewer entries."""
    path, _, index = field.removesuffix("]").partition("[")
    get = attrgetter(path)
    if not index:
        return get
    entry = int(index)
    return lambda message: values[entry] if entry < len(values := get(message)) else math.nan


def fields_of(store: Typestore, msgtype: str, first: Callable[[], object], prefix: str = "") -> Iterator[str]:
    """Paths of the numbers in a message type; `first` gives the topic's first message, if any."""
    entries: Sequence[tuple[str, Any]] = store.get_msgdef(msgtype).fields
    for name, (kind, detail) in entries:
        path = prefix + name
        if kind == Nodetype.NAME:
            if detail != "std_msgs/msg/Header":
                yield from fields_of(store, detail, first, f"{path}.")
        elif kind == Nodetype.BASE:
            if detail[0] in _NUMBERS and name != "structure_needs_at_least_one_member":
                yield path
        else:
            (inner, element), size = detail
            if inner != Nodetype.BASE or element[0] not in _NUMBERS:
                continue
            if kind == Nodetype.ARRAY:
                size = size if size <= _MAX_ENTRIES else 0
            elif element[0] in _OCTETS or (message := first()) is None:
                size = 0
            else:
                size = min(len(attrgetter(path)(message)), _MAX_ENTRIES)
            yield from (f"{path}[{i}]" for i in range(size))


def _encoding(connection: Connection) -> str:
    ext = connection.ext
    return "ros1" if isinstance(ext, ConnectionExtRosbag1) else ext.serialization_format


def whole_messages(connection: Connection, path: Path) -> Callable[[bytes], object]:
    """Decoder of whole messages.

    Raises:
        LogError: as `typestore_of`.
    """
    store, msgtype = typestore_of(connection, path), connection.msgtype
    deserialize = store.deserialize_ros1 if _encoding(connection) == "ros1" else store.deserialize_cdr
    return lambda raw: deserialize(raw, msgtype)


def headers_only(connection: Connection, path: Path) -> Callable[[bytes], object]:
    """Decoder of no more than the header, where messages begin with one."""
    store = typestore_of(connection, path)
    fields = store.get_msgdef(connection.msgtype).fields
    if not fields or fields[0][1] != (Nodetype.NAME, "std_msgs/msg/Header"):
        return whole_messages(connection, path)
    # ROS 1: a count, then seconds and nanoseconds; ROS 2: four bytes that say the byte order, then the same two.
    is_ros1 = _encoding(connection) == "ros1"

    def decode(raw: bytes) -> object:
        order = "<" if is_ros1 or raw[1] & 1 else ">"
        seconds, nanoseconds = struct.unpack_from(f"{order}iI", raw, 4)
        return SimpleNamespace(header=SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds)))

    return decode


def typestore_of(connection: Connection, path: Path) -> Typestore:
    """Definitions that decode a connection's messages.

    Raises:
        LogError: no definition, one that cannot be parsed, or an encoding other than ROS.
    """
    encoding = _encoding(connection)
    if encoding not in ("ros1", "cdr"):
        what = f"{connection.msgtype} is encoded as {encoding}, which is not supported"
        raise LogError(what, where=path, how="record it with `ros2 bag record`")
    try:
        return _typestore(connection.msgtype, connection.msgdef, encoding == "ros1")
    except KeyError as error:
        part = "" if error.args == (connection.msgtype,) else f" (its part {error.args[0]})"
        raise LogError(
            f"{connection.msgtype} is not defined in the bag{part}",
            where=path,
            how="record as .mcap, or run `ros2 bag convert` to .mcap, where its message package is installed",
        ) from error
    except (TypesysError, SyntaxError, RecursionError) as error:
        reason = " ".join(str(error).split())[:100]
        what = f"{connection.msgtype} has a damaged definition: {reason}"
        raise LogError(what, where=path, how="record or copy the bag again") from error


@functools.lru_cache(maxsize=1024)
def _typestore(msgtype: str, definition: MessageDefinition, ros1: bool) -> Typestore:
    if definition.format == MessageDefinitionFormat.NONE or not definition.data.strip():
        # ROS 2 bags carry definitions since Iron, so those without come from Humble or before.
        store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    else:
        store = get_typestore(Stores.EMPTY)
        store.register(_parsed(msgtype, definition))
    store.get_msgdef(msgtype)  # a KeyError names the type that is missing
    return store


def _parsed(msgtype: str, definition: MessageDefinition) -> dict[str, Any]:
    text = definition.data
    if definition.format == MessageDefinitionFormat.MSG:
        return dict(get_types_from_msg(text, msgtype))
    rule = "=" * 80 + "\n"
    parts = [part.partition("\n")[2] for part in text.split(rule)[1:]] if text.startswith(rule) else [text]
    return {name: fields for part in parts for name, fields in get_types_from_idl(part).items()}
