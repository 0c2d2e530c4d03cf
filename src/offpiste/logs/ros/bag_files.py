"""Opening and checking of the files of ROS bags, and decoders of their messages."""

import functools
import math
import struct
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection, ConnectionExtRosbag1, MessageDefinition, MessageDefinitionFormat, Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from offpiste.core.errors import LogError
from offpiste.core.limits import LARGEST, refuse_larger
from offpiste.logs.log import as_log_error
from offpiste.logs.ros.bounds import MOST_OBJECTS, Rosbag1, fields_in, has_entries, refuse_expansion, refuse_text
from offpiste.logs.ros.mcap_recovery import StreamedMcap

NUMBERS: Final = {
    "bool": "u1", "byte": "u1", "char": "u1", "uint8": "u1", "int8": "i1", "uint16": "u2", "int16": "i2",
    "uint32": "u4", "int32": "i4", "uint64": "u8", "int64": "i8", "float32": "f4", "float64": "f8",
}  # fmt: skip
"""Types of numbers in messages, and NumPy's names for them."""
_OCTETS: Final = ("byte", "char", "uint8")
MakeDecoder = Callable[[Connection, Path], Callable[[bytes], object]]
"""Function that makes the decoder of a connection's messages, given the path of its bag for errors."""

_NO_NUMBERS = {"std_msgs/msg/Header", "std_msgs/msg/MultiArrayLayout"}
"""Parts of messages without measurements."""
MAX_ENTRIES = 36
"""Longest array whose entries are fields: a 6 x 6 covariance; longer arrays are bulk data."""


def stamp_of(received: int, message: object, stamps: str) -> float:
    """Return the time of a message or of a stamp [ns], by its header (or a stamp in its place) or its arrival [s]."""
    return ((stamps == "header" and _own_stamp(message)) or received) / 10**9  # exact, unlike 1e9


def heard_at(received: float, message: object, stamps: str) -> float:
    """Return the time of a received message [s], as `stamp_of`.

    -inf if it has no stamp and its arrival is not known yet (`received` is infinite); NaN if its stamp is not a time.
    """
    known = math.isfinite(received)
    try:
        stamp = stamp_of(round(received * 1e9) if known else 0, message, stamps)
    except (AttributeError, TypeError, ValueError):
        return math.nan
    return stamp if known else stamp or -math.inf


def _own_stamp(message: Any) -> int:
    """Return the stamp in a message's header, or in the message itself (Autoware's) [ns]; 0 without a stamp."""
    if isinstance(message, int):
        return message
    header = getattr(message, "header", None)
    stamp = getattr(message if header is None else header, "stamp", None)
    if header is None and not (hasattr(stamp, "sec") and hasattr(stamp, "nanosec")):
        return 0  # a number called `stamp`
    return 0 if stamp is None else stamp.sec * 10**9 + stamp.nanosec


def field_getter(field: str) -> Callable[[object], float]:
    """Return a function that reads a field of `fields_of` from a message; NaN if a sequence has fewer entries."""
    path, _, index = field.removesuffix("]").partition("[")
    get = attrgetter(path)
    if not index:
        return get
    entry = int(index)
    return lambda message: values[entry] if entry < len(values := get(message)) else math.nan


def fields_of(store: Typestore, msgtype: str, first: Callable[[], Iterable[object]], prefix: str = "") -> Iterator[str]:
    """Yield the paths of the numbers in a message type; `first` returns the topic's first messages, if any."""
    for name, kind, inner, element, size in fields_in(store.fielddefs, msgtype):
        path = prefix + name
        if kind == Nodetype.NAME and element not in _NO_NUMBERS:
            yield from fields_of(store, element, first, f"{path}.")
        if inner == Nodetype.NAME or element[0] not in NUMBERS or name == "structure_needs_at_least_one_member":
            continue
        if kind == Nodetype.BASE:
            yield path
            continue
        if kind == Nodetype.SEQUENCE and element[0] not in _OCTETS:  # the length of the first one that is not empty
            size = next((min(n, MAX_ENTRIES) for one in first() if (n := len(attrgetter(path)(one)))), 0)
        yield from (f"{path}[{i}]" for i in range(size if size <= MAX_ENTRIES else 0))


def _encoding(connection: Connection) -> str:
    ext = connection.ext
    return "ros1" if isinstance(ext, ConnectionExtRosbag1) else ext.serialization_format


def whole_messages(connection: Connection, path: Path) -> Callable[[bytes], object]:
    """Return a decoder of whole messages that refuses those that would take too much memory."""
    store, msgtype = typestore_of(connection, path), connection.msgtype
    deserialize = store.deserialize_ros1 if _encoding(connection) == "ros1" else store.deserialize_cdr
    most = MOST_OBJECTS if has_entries(store.fielddefs, msgtype) else LARGEST

    def decode(raw: bytes) -> object:
        refuse_larger(len(raw), f"a message of {msgtype}", most, where=path)
        return deserialize(raw, msgtype)

    return decode


def stamp_reader(connection: Connection, path: Path) -> Callable[[bytes], object]:
    """Return a function that reads only the stamp of a message's header [ns], or messages without header as a whole."""
    fields = typestore_of(connection, path).get_msgdef(connection.msgtype).fields
    if not fields or fields[0][1] != (Nodetype.NAME, "std_msgs/msg/Header"):
        return whole_messages(connection, path)
    is_ros1 = _encoding(connection) == "ros1"

    def read(raw: bytes) -> int:
        # ROS 1: a count, then seconds and nanoseconds; ROS 2: four bytes with the byte order, then the same two.
        seconds, nanoseconds = struct.unpack_from("<iI" if is_ros1 or raw[1] & 1 else ">iI", raw, 4)
        return int(seconds * 10**9 + nanoseconds)

    return read


def typestore_of(connection: Connection, path: Path) -> Typestore:
    """Return the definitions that decode a connection's messages."""
    encoding = _encoding(connection)
    if encoding not in ("ros1", "cdr"):
        what = f"{connection.msgtype} is encoded as {encoding}, which is not supported"
        raise LogError(what, where=path, how="record it with `ros2 bag record`, or write its numbers to a .csv")
    try:
        return _typestore(connection.msgtype, connection.msgdef, encoding == "ros1")
    except KeyError as error:
        part = "" if error.args == (connection.msgtype,) else f" (its part {error.args[0]})"
        how = "record as .mcap, or run `ros2 bag convert` to .mcap, where its message package is installed"
        raise LogError(f"{connection.msgtype} is not defined in the bag{part}", where=path, how=how) from error
    except Exception as error:  # rosbags parses and compiles what the file holds
        reason = (" ".join(str(error).split()) or type(error).__name__)[:100]
        what = f"{connection.msgtype} has a damaged definition: {reason}"
        raise LogError(what, where=path, how="record or copy the bag again") from error


@functools.lru_cache(maxsize=1024)
def _typestore(msgtype: str, definition: MessageDefinition, ros1: bool) -> Typestore:
    if definition.format == MessageDefinitionFormat.NONE or not definition.data.strip():
        # ROS 2 bags have definitions since Iron: those without come from Humble or before.
        store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    else:
        store = get_typestore(Stores.EMPTY)
        refuse_text(definition.data, idl=definition.format == MessageDefinitionFormat.IDL)
        store.register(_parsed(msgtype, definition))
        refuse_expansion(store.fielddefs, msgtype, ros1=ros1)
    store.get_msgdef(msgtype)  # a KeyError names a missing type
    return store


def _parsed(msgtype: str, definition: MessageDefinition) -> dict[str, Any]:
    text = definition.data
    if definition.format == MessageDefinitionFormat.MSG:
        return dict(get_types_from_msg(text, msgtype))
    rule = "=" * 80 + "\n"
    parts = [part.partition("\n")[2] for part in text.split(rule)[1:]] if text.startswith(rule) else [text]
    return {name: fields for part in parts for name, fields in get_types_from_idl(part).items()}


_Indexed = rosbag1.Reader | rosbag2.Reader
Reader = _Indexed | StreamedMcap
MAGIC = {".bag": b"#ROSBAG V", ".mcap": b"\x89MCAP0\r\n", ".db3": b"SQLite format 3\0"}
"""First bytes of files, by file extension."""
_REPAIRS = {
    ".bag": "repair it with `rosbag reindex FILE`, or record or copy it again",
    ".mcap": "repair it with `mcap recover FILE -o REPAIRED.mcap`, or record or copy it again",
    ".db3": "repair it with `sqlite3 FILE .recover | sqlite3 REPAIRED.db3`, or record or copy it again",
}


def storage_files(folder: Path) -> list[Path]:
    """Return a ROS 2 bag's files in order: drive_2.mcap before drive_10.mcap."""
    files = [file for file in folder.iterdir() if file.suffix in (".mcap", ".db3") and file.is_file()]
    return sorted(files, key=lambda file: (len(file.name), file.name))


def open_readers(path: Path, notes: list[str]) -> list[Reader]:
    """Return open readers of a bag's files in order; warnings are added to `notes`."""
    if not path.is_dir():
        return [_open_file(path, notes)]
    failed = LogError("no metadata.yaml", where=path, how=_repair(path))
    if (path / "metadata.yaml").is_file():
        try:
            return [_opened(rosbag2.Reader, path)]
        except LogError as error:
            failed = error
    readers: list[Reader] = []
    for file in storage_files(path):
        try:
            readers.append(_open_file(file, notes))
        except LogError as error:
            notes.append(f"left out: {error}")
    if not readers:
        raise failed
    notes.append(f"{path}: {failed.what} (was the recorder killed?); {len(readers)} files are read as one drive")
    return readers


def _open_file(path: Path, notes: list[str]) -> Reader:
    _check_beginning(path)
    wal = path.with_name(f"{path.name}-wal")
    if path.suffix == ".db3" and wal.is_file() and wal.stat().st_size > 0:
        notes.append(f"{wal}: messages not yet moved into the .db3 are not read; `sqlite3 FILE .schema` moves them")
    try:
        return _opened(Rosbag1 if path.suffix == ".bag" else rosbag2.Reader, path)
    except LogError:
        if path.suffix != ".mcap":
            raise
    with reported(path, "cannot be read"):
        reader = StreamedMcap(path)
    notes.extend(reader.warnings)
    return reader


def _opened(kind: Callable[[Path], _Indexed], path: Path) -> _Indexed:
    with reported(path, "cannot be read"):
        reader = kind(path)
        reader.open()
        if not all(type(connection.msgcount) is int for connection in reader.connections):
            reader.close()
            raise LogError("its message counts are not numbers", where=path, how=_repair(path))
        if isinstance(reader, rosbag2.Reader) and not _is_indexed(reader):
            reader.close()
            raise LogError("its chunks have no message index", where=path, how=_repair(path))
        return reader


def _is_indexed(reader: rosbag2.Reader) -> bool:
    """Return whether rosbags finds the messages of an MCAP's chunks: it skips chunks without a message index."""
    files = getattr(reader.storage, "storages", (reader.storage,))  # of a folder
    chunks = [chunk for file in files for chunk in getattr(file, "chunks", ())]
    return all(chunk.message_index_length or not chunk.message_end_time for chunk in chunks)


def _check_beginning(path: Path) -> None:
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError as error:
        raise LogError(f"cannot be opened: {error.strerror}", where=path) from error
    if not head:
        raise LogError("the file is empty", where=path, how="record or copy it again")
    if not head.startswith(MAGIC[path.suffix]):
        true = next((suffix for suffix, magic in MAGIC.items() if head.startswith(magic)), "")
        how = "it is damaged, or of another format: copy it again, or give it the extension of its format"
        raise LogError(f"not a {path.suffix} file", where=path, how=f"it is a {true} file: rename it" if true else how)


def _repair(path: Path) -> str:
    default = "repair it with `ros2 bag reindex FOLDER`, or record or copy it again"
    return default if path.is_dir() else _REPAIRS.get(path.suffix, default)


def reported(path: Path, what: str) -> AbstractContextManager[None]:
    """Return the context that turns errors of rosbags on a damaged bag into one line (`as_log_error`)."""
    return as_log_error(path, what, _repair(path))
