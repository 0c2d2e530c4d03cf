"""Writer of MCAP files of ROS 2 messages that remain readable after an interruption."""

import functools
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from offpiste.core.errors import LogError
from offpiste.core.limits import packaged_table


def new_typestore() -> Typestore:
    """Return the message types of ROS 2 and of definitions.toml."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in packaged_table(__package__, "definitions.toml").items():
        store.register(get_types_from_msg(text, name))
    return store


message_types = functools.cache(new_typestore)
"""Shared store of the message types that offpiste writes."""


def make(msgtype: str, **fields: Any) -> Any:
    """Return a message of a type without `msg`, such as `nav_msgs/Odometry`."""
    return message_types().types[msgtype.replace("/", "/msg/")](**fields)


def header(stamp_ns: int, frame: str) -> Any:
    """Return a std_msgs/Header."""
    seconds, rest = divmod(stamp_ns, 10**9)
    return make("std_msgs/Header", stamp=make("builtin_interfaces/Time", sec=seconds, nanosec=rest), frame_id=frame)


def vector(values: Any, kind: str = "geometry_msgs/Vector3") -> Any:
    """Return a geometry_msgs/Vector3, Point or Quaternion."""
    return make(kind, **dict(zip("xyzw", np.asarray(values, dtype=np.float64).tolist(), strict=False)))


def quaternion(xyzw: Any) -> Any:
    """Return a geometry_msgs/Quaternion."""
    return vector(xyzw, "geometry_msgs/Quaternion")


def floats(values: Any) -> Any:
    """Return an array for a float64 sequence of a message."""
    return np.atleast_1d(np.asarray(values, dtype=np.float64))


_CHUNK_TIME = 10**9
"""Longest time span of a chunk [ns], which a killed recorder loses."""
_CHUNK_SIZE = 4 << 20
"""Largest size of a chunk [bytes]; the writer keeps up to two in memory."""


class McapWriter(AbstractContextManager["McapWriter"]):
    """Writer of messages to a new `.mcap` file; equal messages give equal bytes.

    The end of its `with` block, also by an exception or Ctrl-C, completes the file. A killed process leaves whole
    chunks without an index, which `offpiste.logs.open_log` reads as well. Chunks are written by a worker thread, since
    Ctrl-C, which is raised in the main thread, must not leave half a record.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        if self.path.suffix != ".mcap":
            raise LogError("a recording is an MCAP file", where=path, how="give it the ending .mcap")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("xb")
        except OSError as error:
            if self.path.exists():
                raise LogError("exists already", where=path, how="remove it, or give another name") from error
            raise LogError(f"cannot be written: {error.strerror}", where=path, how="give another name") from error
        self._mcap = Writer(self._file, chunk_size=1 << 62, compression=CompressionType.LZ4)
        self._mcap.start(profile="ros2", library="offpiste")
        self._channels: dict[tuple[str, str], int] = {}
        self._schemas: dict[str, int] = {}
        self._definitions: dict[str, str] = {}
        self._batch: list[tuple[str, str, int, bytes]] = []  # topic, type, stamp [ns] and data
        self._size = 0
        self._worker = ThreadPoolExecutor(max_workers=1)
        self._at_work: Future[None] | None = None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def write(self, topic: str, message: Any, stamp_ns: int) -> None:
        """Append a message of `make`, serialised at once, with its stamp [ns since 1970]."""
        msgtype = message.__msgtype__
        data = bytes(message_types().serialize_cdr(message, msgtype, little_endian=True))
        self._append(topic, msgtype, stamp_ns, data)

    def write_serialised(self, topic: str, msgtype: str, data: bytes, definition: str, stamp_ns: int) -> None:
        """Append a serialised message (CDR) of any type, given its full definition."""
        self._definitions.setdefault(msgtype, definition)
        self._append(topic, msgtype, stamp_ns, data)

    def _append(self, topic: str, msgtype: str, stamp_ns: int, data: bytes) -> None:
        self._batch.append((topic, msgtype, stamp_ns, data))
        self._size += len(data)
        if self._size >= _CHUNK_SIZE or stamp_ns - self._batch[0][2] >= _CHUNK_TIME:
            self._hand_over()

    def close(self) -> None:
        """Write the rest, the index and the end."""
        if self._file.closed:
            return
        try:
            self._hand_over()
            self._at_work = self._worker.submit(self._mcap.finish)
            self._wait()
        finally:
            self._worker.submit(self._file.close)
            self._worker.shutdown()

    def _hand_over(self) -> None:
        self._wait()
        # The worker empties the list: after an interruption here it is handed over twice, the second time empty.
        self._at_work = self._worker.submit(self._put, self._batch)
        self._batch, self._size = [], 0

    def _wait(self) -> None:
        """Wait for the worker to finish its chunk, so that memory is bounded."""
        try:
            if self._at_work is not None:
                self._at_work.result()
        except OSError as error:
            what = f"cannot be written: {error.strerror}"
            raise LogError(what, where=self.path, how="make room on the disk") from error

    def _put(self, batch: list[tuple[str, str, int, bytes]]) -> None:
        for topic, msgtype, stamp, data in batch:
            self._mcap.add_message(self._channel(topic, msgtype), stamp, data, stamp)
        batch.clear()
        self._mcap.flush()  # type: ignore[no-untyped-call]

    def _channel(self, topic: str, msgtype: str) -> int:
        if msgtype not in self._schemas:
            definition = self._definitions.get(msgtype) or message_types().generate_msgdef(msgtype, ros_version=2)[0]
            self._schemas[msgtype] = self._mcap.register_schema(msgtype, "ros2msg", definition.encode())
        if (topic, msgtype) not in self._channels:
            self._channels[topic, msgtype] = self._mcap.register_channel(topic, "cdr", self._schemas[msgtype])
        return self._channels[topic, msgtype]
