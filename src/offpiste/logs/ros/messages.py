"""ROS 2 messages to write: the types of Jazzy and grid_map's, and short ways to make them."""

import functools
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

_GRID_MAP_INFO = """
float64 resolution
float64 length_x
float64 length_y
geometry_msgs/Pose pose
"""
_GRID_MAP = """
std_msgs/Header header
GridMapInfo info
string[] layers
string[] basic_layers
std_msgs/Float32MultiArray[] data
uint16 outer_start_index
uint16 inner_start_index
"""
"""Fields of grid_map_msgs for ROS 2 (ANYbotics/grid_map, branch ros2)."""


@functools.cache
def message_types() -> Typestore:
    """All message types that offpiste writes; classes are in `.types`, by names like `nav_msgs/msg/Odometry`."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(_GRID_MAP_INFO, "grid_map_msgs/msg/GridMapInfo"))
    store.register(get_types_from_msg(_GRID_MAP, "grid_map_msgs/msg/GridMap"))
    return store


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
