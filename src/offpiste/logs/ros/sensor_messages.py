"""Conversion of ROS image, point cloud and joint messages to and from NumPy arrays."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from offpiste.core.errors import LogError
from offpiste.logs.log import JOINT_ARRAYS
from offpiste.logs.ros.bag_files import MAX_ENTRIES
from offpiste.logs.ros.writer import header, make, message_types

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""PointField's datatypes (sensor_msgs/PointField.msg)."""
_CODES = {name: code for code, name in _TYPES.items()}


def points_from_message(message: Any) -> np.ndarray:
    """Return the points of a PointCloud2 as records [height * width], row by row, each field in its own type.

    Fields may be in any order and byte order, with gaps between them. Unnamed and repeated fields are padding and are
    left out; points that are not finite are kept.
    """
    order = ">" if message.is_bigendian else "<"
    fields: dict[str, Any] = {}
    for field in message.fields:
        if field.name:
            fields.setdefault(field.name, field)
    kinds: list[Any] = []
    for field in fields.values():
        if field.datatype not in _TYPES:
            raise LogError(f"field '{field.name}' of a point cloud has the unknown type {field.datatype}")
        kind = order + _TYPES[field.datatype]
        kinds.append((kind, (field.count,)) if field.count > 1 else kind)  # old drivers write a count of 0 for 1
    try:
        offsets = [field.offset for field in fields.values()]
        layout: Any = {"names": list(fields), "formats": kinds, "offsets": offsets, "itemsize": message.point_step}
        point = np.dtype(layout)
        data = np.frombuffer(message.data, dtype=np.uint8)
        shape, strides = (message.height, message.width), (message.row_step, message.point_step)
        if message.height == 1 or message.width == 0:
            strides = (message.width * message.point_step, message.point_step)
        if math.prod(shape) * message.point_step > data.size:  # rows may overlap, or be missing
            raise ValueError(
                f"{math.prod(shape)} points of {message.point_step} bytes do not fit into {data.size} bytes"
            )
        points = np.ndarray(shape, point, data.data, strides=strides).reshape(-1)
    except (ValueError, TypeError) as error:
        raise LogError(f"a point cloud's fields do not fit its data: {error}") from error
    return points if point.isnative else points.astype(point.newbyteorder("="))


def message_from_points(points: np.ndarray, stamp_ns: int, frame: str) -> Any:
    """Return a PointCloud2 of records [n] of numbers, packed or not."""
    fields = points.dtype.fields
    assert fields is not None, "points are records"
    return make(
        "sensor_msgs/PointCloud2",
        header=header(stamp_ns, frame),
        height=1,
        width=len(points),
        fields=[
            make("sensor_msgs/PointField", name=name, offset=offset, datatype=_CODES[kind.str[1:]], count=1)
            for name, (kind, offset, *_) in fields.items()
        ],
        is_bigendian=False,
        point_step=points.dtype.itemsize,
        row_step=points.dtype.itemsize * len(points),
        data=np.frombuffer(points.tobytes(), dtype=np.uint8),
        is_dense=True,
    )


def frame_of(message: Any) -> str:
    """Return the frame in a message's header."""
    return str(message.header.frame_id).lstrip("/")


class Joints:
    """Entries of sensor_msgs/JointState by their names, in any order and selection in each message.

    Entry `position[i]` is the joint with the i-th new name, also if several publishers share a topic; unnamed entries
    are identified by their order.

    Attributes:
        fields: paths of the existing entries.
        names: names of the joints by field, with the suffixes of `JOINT_ARRAYS`.
    """

    def __init__(self, messages: Iterable[Any]) -> None:
        places: dict[tuple[str, int], int] = {}
        found: set[tuple[str, int]] = set()
        for message in messages:
            for entry, at in _places(message).items():
                place = places.setdefault(entry, len(places))
                found |= {(array, place) for array in JOINT_ARRAYS if at < len(getattr(message, array))}
        entries = list(enumerate(list(places)[:MAX_ENTRIES]))
        self._wanted = {f"{a}[{i}]": (a, entry) for a in JOINT_ARRAYS for i, entry in entries if (a, i) in found}
        self.fields = tuple(self._wanted)
        self.names = {field: name + JOINT_ARRAYS[a] for field, (a, (name, _)) in self._wanted.items() if name}

    def reader(self, fields: Sequence[str]) -> Callable[[Any], list[float]]:
        """Return a function that reads entries of a message; NaN for missing joints."""
        return _entries_reader([self._wanted[field] for field in fields])


def joint_getter(field: str, joint: str) -> Callable[[Any], float]:
    """Return a function that reads a joint's entry of a message by its name; NaN for a missing joint."""
    read = _entries_reader([(field.partition("[")[0], (joint, 0))])
    return lambda message: read(message)[0]


def _entries_reader(wanted: Sequence[tuple[str, tuple[str, int]]]) -> Callable[[Any], list[float]]:
    """Return a function that reads entries of arrays, each by its name and the number of equal names before it."""

    def read(message: Any) -> list[float]:
        places = _places(message)
        at = [(getattr(message, array), places.get(entry, math.inf)) for array, entry in wanted]
        return [float(values[int(place)]) if place < len(values) else math.nan for values, place in at]

    return read


def has_joints(fields: Sequence[Any]) -> bool:
    """Return whether a definition is that of sensor_msgs/JointState, apart from its header."""
    known = message_types().get_msgdef("sensor_msgs/msg/JointState").fields
    return list(fields[1:]) == list(known[1:])


def _places(message: Any) -> dict[tuple[str, int], int]:
    """Return the index of each entry in a message, by its name and the number of equal names before it."""
    size = max(len(getattr(message, array)) for array in JOINT_ARRAYS)
    result: dict[tuple[str, int], int] = {}
    counts: dict[str, int] = {}
    for place, name in enumerate([*message.name, *[""] * (size - len(message.name))]):
        counts[name] = counts.get(name, -1) + 1
        result[name, counts[name]] = place
    return result
