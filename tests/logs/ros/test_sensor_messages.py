"""Round trips of points through PointCloud2 messages, and inconsistent messages."""

import numpy as np
import pytest

from offpiste.core.errors import LogError
from offpiste.logs.ros.sensor_messages import message_from_points, points_from_message
from offpiste.logs.ros.writer import header, make, message_types

PACKED = np.dtype([("x", "<f4"), ("ring", "<u2"), ("y", "<f8"), ("flag", "i1")])


def cloud(data: bytes, fields: list[tuple[str, int, int, int]], **changes: object) -> object:
    """Return a message from the name, offset, datatype and count of its fields."""
    made = [make("sensor_msgs/PointField", name=n, offset=o, datatype=d, count=c) for n, o, d, c in fields]
    parts = {
        "header": header(0, ""), "height": 1, "width": 2, "fields": made, "is_bigendian": False,
        "point_step": 12, "row_step": 24, "data": np.frombuffer(data, np.uint8), "is_dense": True,
    }  # fmt: skip
    return make("sensor_msgs/PointCloud2", **parts | changes)


def points(count: int, dtype: np.dtype = PACKED) -> np.ndarray:
    made = np.zeros(count, dtype)
    for k, name in enumerate(dtype.names):
        made[name] = 10 * k + np.arange(count)
    return made


@pytest.mark.parametrize("dtype", [PACKED, np.dtype(PACKED.descr, align=True)], ids=["packed", "aligned"])
def test_there_and_back_through_bytes(dtype: np.dtype) -> None:
    store, name = message_types(), "sensor_msgs/msg/PointCloud2"
    message = message_from_points(points(5, dtype), 7, "lidar")
    read = points_from_message(store.deserialize_cdr(bytes(store.serialize_cdr(message, name)), name))
    assert read.dtype.names == dtype.names
    for field in dtype.names:
        np.testing.assert_array_equal(read[field], points(5, dtype)[field])
        assert read[field].dtype == dtype[field]


def test_by_hand_with_padding_and_fields_out_of_order() -> None:
    # Two points of 12 bytes: y (int16) at 6, x (float32) at 0; bytes 4, 5 and 8 to 11 are padding.
    data = b"".join(
        np.float32(x).tobytes() + b"\xff\xff" + np.int16(y).tobytes() + 4 * b"\xff" for x, y in [(1.5, -2), (2.5, -3)]
    )
    read = points_from_message(cloud(data, [("y", 6, 3, 1), ("x", 0, 7, 1)]))
    assert read.dtype.names == ("y", "x")
    assert read["x"].tolist() == [1.5, 2.5]
    assert read["y"].tolist() == [-2, -3]


@pytest.mark.parametrize(
    ("datatype", "kind"), [(1, "i1"), (2, "u1"), (3, "i2"), (4, "u2"), (5, "i4"), (6, "u4"), (7, "f4"), (8, "f8")]
)
@pytest.mark.parametrize("order", ["<", ">"])
def test_every_type_in_both_byte_orders(datatype: int, kind: str, order: str) -> None:
    values = np.array([3, 100], order + kind)
    data = b"".join(values[i : i + 1].tobytes().ljust(12, b"\0") for i in range(2))
    read = points_from_message(cloud(data, [("v", 0, datatype, 1)], is_bigendian=order == ">"))
    assert read["v"].tolist() == [3, 100]
    assert read.dtype["v"] == np.dtype(kind)  # native


def test_rows_with_padding_between_them() -> None:
    rows = [np.array([1, 2], "<f4").tobytes() + b"\xff\xff", np.array([3, 4], "<f4").tobytes() + b"\xff\xff"]
    read = points_from_message(cloud(b"".join(rows), [("x", 0, 7, 1)], height=2, point_step=4, row_step=10))
    assert read["x"].tolist() == [1, 2, 3, 4]


def test_padding_fields_counts_and_nothing() -> None:
    data = np.arange(6, dtype="<f4").tobytes()
    read = points_from_message(cloud(data, [("", 0, 7, 1), ("_", 4, 7, 0), ("_", 8, 7, 1), ("normal", 4, 7, 2)]))
    assert read.dtype.names == ("_", "normal")
    assert read["_"].tolist() == [1, 4]
    assert read["normal"].tolist() == [[1, 2], [4, 5]]
    assert len(points_from_message(cloud(b"", [("x", 0, 7, 1)], width=0, row_step=0))) == 0


@pytest.mark.parametrize(
    ("fields", "changes", "what"),
    [
        ([("x", 0, 9, 1)], {}, "unknown type 9"),
        ([("x", 10, 7, 1)], {}, "do not fit"),
        ([("x", 0, 7, 1)], {"width": 3}, "do not fit"),
        ([("x", 0, 7, 1)], {"height": 2}, "do not fit"),
    ],
)
def test_what_does_not_fit_is_one_line(fields: list, changes: dict, what: str) -> None:
    with pytest.raises(LogError, match=what):
        points_from_message(cloud(24 * b"\0", fields, **changes))
