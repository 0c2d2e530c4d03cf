"""Writes a case in the formats that logs come in: tables, MCAP, ROS 1 bags, TartanDrive folders."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq
from rosbags import rosbag1
from rosbags.typesys import Stores, get_typestore

from experiments.illnesses.recording import Case, Stream
from offpiste.logs import open_log
from offpiste.logs.log import Log
from offpiste.logs.ros.writer import McapWriter, message_types
from offpiste.rig.channels import ChannelSource

_TABLES: Final = ("CSV", "Parquet")
_ROS: Final = ("MCAP", "ROS 1 bag")
_ODOMETRY: Final = {
    **{axis: f"pose.pose.position.{axis}" for axis in "xyz"},
    **{f"q{axis}": f"pose.pose.orientation.{axis}" for axis in "xyzw"},
    **{f"v{axis}": f"twist.twist.linear.{axis}" for axis in "xyz"},
    **{f"w{axis}": f"twist.twist.angular.{axis}" for axis in "xyz"},
}
"""Columns of the odometry as fields of nav_msgs/Odometry."""
_LAST_STAMP: Final = 2.0**31
"""Seconds that a ROS header can hold."""


def formats_for(case: Case) -> tuple[str, ...]:
    """Formats that can hold a case: tables hold one topic, ROS headers finite stamps."""
    if "" in case.streams:
        return _TABLES
    fits = all(
        np.isfinite(s.time).all() and ((s.time > 0) & (s.time < _LAST_STAMP)).all() for s in case.streams.values()
    )
    return (*_ROS, "TartanDrive") if fits else ("TartanDrive",)


def stored(case: Case, storage: str, folder: Path) -> tuple[Case, Log]:
    """Write a case into a folder, and open it.

    Returns:
        The case with topics, fields and rig as this format names them, and the log.
    """
    if storage in _TABLES:
        path = folder / ("log.csv" if storage == "CSV" else "log.parquet")
        _write_table(case.streams[""], path)
        return case, open_log(path, clock=case.rig.clock)
    if storage == "TartanDrive":
        _write_tartandrive(case.streams, folder / "drive")
        streams = {topic: replace(stream, arrival=None) for topic, stream in case.streams.items()}
        numbers = {t: {f: str(i) for i, f in enumerate(s.columns)} for t, s in streams.items()}
        return renamed(replace(case, streams=streams), numbers), open_log(folder / "drive", clock=case.rig.clock)
    path = folder / ("log.mcap" if storage == "MCAP" else "log.bag")
    _write_ros(case.streams, path)
    return renamed(case, {topic: _ros_fields(stream) for topic, stream in case.streams.items()}), open_log(path)


def renamed(case: Case, fields: Mapping[str, Mapping[str, str]]) -> Case:
    """The case with other names of fields, by topic, in streams and rig."""

    def source(old: ChannelSource) -> ChannelSource:
        names = tuple(fields[old.topic].get(field, field) for field in old.fields)
        return msgspec.structs.replace(old, fields=names)

    streams = {
        topic: replace(s, columns={fields[topic][name]: column for name, column in s.columns.items()})
        for topic, s in case.streams.items()
    }
    channels = {name: source(old) for name, old in case.rig.channels.items()}
    return Case(streams, msgspec.structs.replace(case.rig, channels=channels))


def _write_table(stream: Stream, path: Path) -> None:
    table = pa.table({"time": stream.time, **stream.columns})
    if path.suffix == ".csv":
        pa_csv.write_csv(table, path)
    else:
        pq.write_table(table, path)


def _write_tartandrive(streams: Mapping[str, Stream], folder: Path) -> None:
    for topic, stream in streams.items():
        (folder / topic).mkdir(parents=True)
        np.save(folder / topic / "data.npy", np.column_stack(list(stream.columns.values())))
        np.savetxt(folder / topic / "timestamps.txt", stream.time, fmt="%.9f")


def _is_odometry(stream: Stream) -> bool:
    return {"x", "y", "qx"} <= set(stream.columns) <= set(_ODOMETRY)


def _ros_fields(stream: Stream) -> dict[str, str]:
    """Names of a stream's columns as fields of its messages."""
    if _is_odometry(stream):
        return {name: _ODOMETRY[name] for name in stream.columns}
    return {name: f"position[{i}]" for i, name in enumerate(stream.columns)}


def _write_ros(streams: Mapping[str, Stream], path: Path) -> None:
    """Messages arrive one after the other, in the order of the rows whatever their stamps."""
    first = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC) if first else message_types()
    messages = [
        (int(1e9 * at), topic, number)
        for topic, stream in streams.items()
        for number, at in enumerate(np.sort(stream.time if stream.arrival is None else stream.arrival))
    ]
    makers = {topic: _maker(store, stream, sequence=first) for topic, stream in streams.items()}
    if not first:
        with McapWriter(path) as mcap:
            for at, topic, number in sorted(messages):
                mcap.write(topic, makers[topic](number), at)
        return
    with rosbag1.Writer(path) as bag:
        connections = {t: bag.add_connection(t, _type_of(s), typestore=store) for t, s in streams.items()}
        for at, topic, number in sorted(messages):
            data = store.serialize_ros1(makers[topic](number), _type_of(streams[topic]))
            bag.write(connections[topic], at, data)


def _type_of(stream: Stream) -> str:
    return "nav_msgs/msg/Odometry" if _is_odometry(stream) else "sensor_msgs/msg/JointState"


def _maker(store: Any, stream: Stream, *, sequence: bool) -> Callable[[int], Any]:
    """Makes the message of a row; ROS 1 headers have a sequence number."""
    types = store.types

    def header(row: int) -> Any:
        nanoseconds = round(stream.time[row] * 1e9)
        stamp = types["builtin_interfaces/msg/Time"](sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id="", **({"seq": row} if sequence else {}))

    values = np.column_stack(list(stream.columns.values()))
    names = list(stream.columns)
    empty = np.zeros(0)

    def joints(row: int) -> Any:
        kind = types["sensor_msgs/msg/JointState"]
        return kind(header=header(row), name=names, position=values[row], velocity=empty, effort=empty)

    def odometry(row: int) -> Any:
        at = dict(zip(names, values[row].tolist(), strict=True))

        def part(kind: str, prefix: str, axes: str) -> Any:
            return types[f"geometry_msgs/msg/{kind}"](**{axis: at.get(prefix + axis, 0.0) for axis in axes})

        covariance = np.zeros(36)
        pose = types["geometry_msgs/msg/Pose"](
            position=part("Point", "", "xyz"), orientation=part("Quaternion", "q", "xyzw")
        )
        twist = types["geometry_msgs/msg/Twist"](
            linear=part("Vector3", "v", "xyz"), angular=part("Vector3", "w", "xyz")
        )
        return types["nav_msgs/msg/Odometry"](
            header=header(row),
            child_frame_id="base_link",
            pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=covariance),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=covariance),
        )

    return odometry if _is_odometry(stream) else joints
