"""sensor_msgs/PointCloud2 from and to NumPy records."""

from typing import Any

import numpy as np

from offpiste.errors import LogError
from offpiste.logs.ros.messages import header, make

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""PointField's datatypes (sensor_msgs/PointField.msg)."""
_CODES = {name: code for code, name in _TYPES.items()}


def points_from_message(message: Any) -> np.ndarray:
    """Points of a PointCloud2 as records [height * width], row by row, each field in its own type.

    Fields may come in any order, with gaps between them, and in either byte order; points that are not finite are
    kept. Fields without a name, and repeated ones, are padding and left out.

    Raises:
        LogError: the message's fields, steps and data do not fit together.
    """
    order = ">" if message.is_bigendian else "<"
    fields: dict[str, Any] = {}
    for field in message.fields:
        if field.name:
            fields.setdefault(field.name, field)
    for field in fields.values():
        if field.datatype not in _TYPES:
            raise LogError(f"field '{field.name}' of a point cloud has the unknown type {field.datatype}")
    kinds = [_kind(order, field) for field in fields.values()]
    try:
        point = np.dtype(
            {
                "names": list(fields),
                "formats": kinds,
                "offsets": [field.offset for field in fields.values()],
                "itemsize": message.point_step,
            }
        )
        data = np.frombuffer(message.data, dtype=np.uint8)
        shape, strides = (message.height, message.width), (message.row_step, message.point_step)
        if message.height == 1 or message.width == 0:
            strides = (message.width * message.point_step, message.point_step)
        points = np.ndarray(shape, point, data.data, strides=strides).reshape(-1)
    except (ValueError, TypeError) as error:
        raise LogError(f"a point cloud's fields do not fit its data: {error}") from error
    return points if point.isnative else points.astype(point.newbyteorder("="))


def message_from_points(points: np.ndarray, stamp_ns: int, frame: str) -> Any:
    """A PointCloud2 of records [n]; fields are numbers, packed or not.

    Args:
        frame: in which x, y, z stand.
    """
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


def _kind(order: str, field: Any) -> Any:
    # Old drivers leave the count at 0 and mean 1.
    kind = order + _TYPES[field.datatype]
    return (kind, (field.count,)) if field.count > 1 else kind
