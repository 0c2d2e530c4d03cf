"""Writes MCAP files of ROS 2 messages that any tool reads, and that survive an interruption."""

import functools
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, Final, NamedTuple

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from offpiste.core.errors import LogError

DEFINITIONS: Final = {
    "grid_map_msgs/msg/GridMapInfo": """
        float64 resolution
        float64 length_x
        float64 length_y
        geometry_msgs/Pose pose
    """,
    "grid_map_msgs/msg/GridMap": """
        std_msgs/Header header
        GridMapInfo info
        string[] layers
        string[] basic_layers
        std_msgs/Float32MultiArray[] data
        uint16 outer_start_index
        uint16 inner_start_index
    """,
    "ackermann_msgs/msg/AckermannDrive": """
        float32 steering_angle
        float32 steering_angle_velocity
        float32 speed
        float32 acceleration
        float32 jerk
    """,
    "ackermann_msgs/msg/AckermannDriveStamped": """
        std_msgs/Header header
        AckermannDrive drive
    """,
}
"""Fields of types that rosbags lacks: grid_map_msgs (ANYbotics/grid_map) and ackermann_msgs
(ros-drivers/ackermann_msgs), both of their branches ros2."""


def new_typestore() -> Typestore:
    """Message types of ROS 2 and of `DEFINITIONS`; classes are in `.types`, by names like `nav_msgs/msg/Odometry`."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


message_types = functools.cache(new_typestore)
"""The types that offpiste writes."""


def make(msgtype: str, **fields: Any) -> Any:
    """A message; `msgtype` without the middle part: `nav_msgs/Odometry`."""
    return _class(msgtype)(**fields)


@functools.cache
def _class(msgtype: str) -> Any:
    return message_types().types[msgtype.replace("/", "/msg/")]


def header(stamp_ns: int, frame: str) -> Any:
    """A std_msgs/Header."""
    seconds, rest = divmod(stamp_ns, 10**9)
    return make("std_msgs/Header", stamp=make("builtin_interfaces/Time", sec=seconds, nanosec=rest), frame_id=frame)


def vector(xyz: Any, kind: str = "geometry_msgs/Vector3") -> Any:
    """A geometry_msgs/Vector3 or Point."""
    x, y, z = np.asarray(xyz, dtype=np.float64).tolist()
    return make(kind, x=x, y=y, z=z)


def quaternion(xyzw: Any) -> Any:
    """A geometry_msgs/Quaternion."""
    x, y, z, w = np.asarray(xyzw, dtype=np.float64).tolist()
    return make("geometry_msgs/Quaternion", x=x, y=y, z=z, w=w)


def floats(values: Any) -> Any:
    """An array for a float64 sequence of a message."""
    return np.atleast_1d(np.asarray(values, dtype=np.float64))


_CHUNK_TIME = 10**9
"""Longest time that a chunk spans before it reaches the operating system [ns]: what a killed recorder loses."""
_CHUNK_SIZE = 4 << 20
"""Largest size of a chunk before that [bytes]; the writer keeps up to two in memory."""


class _Entry(NamedTuple):
    topic: str
    msgtype: str
    stamp: int
    data: bytes


class McapWriter:
    """Writes messages straight into a file of the final name; the same messages give the same bytes.

    When its `with` block ends, by an exception or Ctrl-C too, the file gets its index and end. A killed process leaves
    whole chunks without an index, which `offpiste.logs.open_log` reads as well. Chunks are put together in a thread of
    their own: Ctrl-C is raised in the main thread only, so that it never leaves half a record.

    Args:
        path: a new `.mcap` file.

    Raises:
        LogError: the file exists, has another ending, or cannot be written.
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
        self._batch: list[_Entry] = []
        self._size = 0
        self._worker = ThreadPoolExecutor(max_workers=1)
        self._at_work: Future[None] | None = None

    def __enter__(self) -> "McapWriter":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def write(self, topic: str, message: Any, stamp_ns: int) -> None:
        """Append a message (of `offpiste.logs.ros.writer`), stamped [ns since 1970]; it is serialised at once."""
        msgtype = message.__msgtype__
        data = bytes(message_types().serialize_cdr(message, msgtype, little_endian=True))
        self._append(_Entry(topic, msgtype, stamp_ns, data))

    def write_serialised(self, topic: str, msgtype: str, data: bytes, definition: str, stamp_ns: int) -> None:
        """Append a message that is CDR already, of any type.

        Args:
            definition: of the type, with those that it is made of.
        """
        if msgtype not in self._definitions:
            self._definitions[msgtype] = definition
        self._append(_Entry(topic, msgtype, stamp_ns, data))

    def _append(self, entry: _Entry) -> None:
        self._batch.append(entry)
        self._size += len(entry.data)
        stamp_ns = entry.stamp
        if self._size >= _CHUNK_SIZE or stamp_ns - self._batch[0].stamp >= _CHUNK_TIME:
            self._hand_over()

    def close(self) -> None:
        """Write the rest, the index and the end; called when the `with` block ends."""
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
        # The list is emptied by the worker: an interruption here hands it over twice, the second time empty.
        self._at_work = self._worker.submit(self._put, self._batch)
        self._batch, self._size = [], 0

    def _wait(self) -> None:
        """Let the worker finish its chunk: no more than one waits, so that memory is bounded.

        Raises:
            LogError: it could not be written.
        """
        try:
            if self._at_work is not None:
                self._at_work.result()
        except OSError as error:
            what = f"cannot be written: {error.strerror}"
            raise LogError(what, where=self.path, how="make room on the disk") from error

    def _put(self, batch: list[_Entry]) -> None:
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
