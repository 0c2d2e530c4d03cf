"""Small bags of every kind, written with rosbags and mcap."""

from collections.abc import Sequence
from pathlib import Path

from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags import rosbag1, rosbag2
from rosbags.convert.converter import convert
from rosbags.rosbag2.enums import CompressionFormat, StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from offpiste.logs.formats.bag import BagLog

ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
TWIST = "geometry_msgs/msg/TwistStamped"
SPEED = "twist.linear.x"
START = 1_700_000_000
"""Bags made here: message i arrives at START + i seconds, is stamped 0.25 s earlier, and its speed is i m/s."""


def twist(store, i: int, *, stamped: float | None = None):
    stamp = START + i - 0.25 if stamped is None else stamped
    vector, types = store.types["geometry_msgs/msg/Vector3"], store.types
    time = types["builtin_interfaces/msg/Time"](sec=int(stamp), nanosec=round((stamp % 1) * 1e9))
    sequence = {"seq": i} if store is ROS1 else {}
    header = types["std_msgs/msg/Header"](stamp=time, frame_id="base", **sequence)
    linear = vector(x=float(i), y=0.5, z=0.0)
    return types[TWIST](header=header, twist=types["geometry_msgs/msg/Twist"](linear=linear, angular=vector(0, 0, 1.0)))


def ros1_bag(path: Path, count: int, compression=None) -> Path:
    writer = rosbag1.Writer(path)
    if compression is not None:
        writer.set_compression(compression)
    writer.chunk_threshold = 1000
    with writer:
        connection = writer.add_connection("/odom", TWIST, typestore=ROS1)
        for i in range(count):
            writer.write(connection, (START + i) * 10**9, ROS1.serialize_ros1(twist(ROS1, i), TWIST))
    return path


def ros2_folder(path: Path, storage: StoragePlugin, messages: Sequence[object], *, compressed=None) -> Path:
    writer = rosbag2.Writer(path, version=9, storage_plugin=storage)
    if compressed is not None:
        writer.set_compression(compressed, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/odom", TWIST, typestore=ROS2)
        for i, message in enumerate(messages):
            writer.write(connection, (START + i) * 10**9, ROS2.serialize_cdr(message, TWIST))
    return path


def converted(log: Path, target: Path, storage: str = "") -> Path:
    """Convert a bag to a ROS 1 bag, or to the folder of a ROS 2 bag with this storage."""
    store = get_typestore(Stores.ROS2_HUMBLE if storage else Stores.ROS1_NOETIC)
    if not storage:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    convert([log], target, storage, 9, None, "", None, store, [], [], [], [])
    return target


def twists(count: int) -> list[object]:
    return [twist(ROS2, i) for i in range(count)]


def mcap_file(
    path: Path,
    messages: Sequence[object],
    *,
    msgtype: str = TWIST,
    store=ROS2,
    schema: str = "ros2msg",
    encoding: str = "cdr",
    profile: str = "ros2",
    compression: CompressionType = CompressionType.NONE,
    chunking: bool = True,
    finish: bool = True,
    index: IndexType = IndexType.ALL,
) -> Path:
    definition = store.generate_msgdef(msgtype, ros_version=2)[0] if schema else ""
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=400, compression=compression, use_chunking=chunking, index_types=index)
        writer.start(profile=profile)
        schema_id = writer.register_schema(msgtype, schema, definition.encode())
        channel = writer.register_channel("/odom", encoding, schema_id)
        for i, message in enumerate(messages):
            at = (START + i) * 10**9
            writer.add_message(channel, at, bytes(store.serialize_cdr(message, msgtype)), at)
        if finish:
            writer.finish()
        else:
            writer.flush()
    return path


def custom(definition: str, rows: Sequence[dict]) -> tuple[object, str, list[object]]:
    store = get_typestore(Stores.ROS2_HUMBLE)
    name = "my_robot/msg/Status"
    store.register(get_types_from_msg(definition, name))
    return store, name, [store.types[name](**row) for row in rows]


def speeds(log: BagLog, **options) -> list[float]:
    return log.read("/odom", [SPEED], **options).values[:, 0].tolist()
