import sqlite3
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from offpiste.errors import LogError
from offpiste.logs.bags import BagLog

ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
TWIST = "geometry_msgs/msg/TwistStamped"
SPEED = "twist.linear.x"
START = 1_700_000_000
"""Bags made here: message i arrives at START + i seconds, is stamped 0.25 s earlier, and its speed is i m/s."""


def twist(store, i: int, *, speed: float | None = None, stamped: float | None = None):
    stamp = START + i - 0.25 if stamped is None else stamped
    vector, types = store.types["geometry_msgs/msg/Vector3"], store.types
    time = types["builtin_interfaces/msg/Time"](sec=int(stamp), nanosec=round((stamp % 1) * 1e9))
    sequence = {"seq": i} if store is ROS1 else {}
    header = types["std_msgs/msg/Header"](stamp=time, frame_id="base", **sequence)
    linear = vector(x=float(i) if speed is None else speed, y=0.5, z=0.0)
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
) -> Path:
    definition = store.generate_msgdef(msgtype, ros_version=2)[0] if schema else ""
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=400, compression=compression, use_chunking=chunking)
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


# Real bags


def test_ros2_mcap_of_a_turtlebot(data_folder: Path) -> None:
    log = BagLog(data_folder / "bags" / "evo_nav2_turtlebot.mcap")
    counts = {name: topic.count for name, topic in log.topics.items()}
    assert counts == {"/amcl_pose": 135, "/odom": 2639, "/tf": 5422, "/tf_static": 1}
    assert log.warnings == ()
    odom = log.topics["/odom"]
    assert odom.type == "nav_msgs/msg/Odometry"
    assert {"pose.pose.position.x", "twist.twist.linear.x", "pose.covariance[35]"} <= set(odom.fields)
    assert not [field for field in odom.fields if field.startswith("header")]
    assert log.topics["/tf"].fields == ()
    samples = log.read("/odom", ["pose.pose.position.x", "twist.twist.linear.x"])
    assert samples.values.shape == (2639, 2)
    np.testing.assert_allclose(samples.values[0, 0], -2.80191663, atol=1e-8)
    np.testing.assert_allclose(samples.time[:2], [928.8, 928.836], atol=1e-9)


def test_ros1_bag_with_its_own_message_types(data_folder: Path) -> None:
    log = BagLog(data_folder / "bags" / "PlotJuggler_tilt_laser.bag")
    assert {name: topic.count for name, topic in log.topics.items()} == {
        "/gravity_vector": 356, "/imu_data": 356, "/info_gps": 356, "/magnetic_vector": 356, "/position_gps": 356,
        "/scan": 178, "/temperature": 712, "/tf": 711, "/velocity": 712,
    }  # fmt: skip
    assert log.topics["/temperature"].fields == ("reading", "min_reading", "max_reading")
    assert log.read("/temperature", ["reading"]).values[0, 0] == 20.8125
    np.testing.assert_allclose(log.read("/position_gps", ["latitude"]).values[0, 0], 47.37632751, atol=1e-8)
    ranges = [field for field in log.topics["/scan"].fields if field.startswith("ranges")]
    assert ranges == [f"ranges[{i}]" for i in range(36)]
    header, receive = (log.read("/imu_data", [], stamps=stamps).time for stamps in ("header", "receive"))
    delay = receive - header
    assert 0 < np.median(delay) < 0.1


def test_nearly_empty_bag(data_folder: Path) -> None:
    log = BagLog(data_folder / "bags" / "rosbag2_only_topics.mcap")
    assert {name: topic.count for name, topic in log.topics.items()} == {
        "/events/write_split": 0, "/parameter_events": 7, "/rosout": 0,
    }  # fmt: skip
    with pytest.raises(LogError, match="topic '/rosout' is empty; declare its channels absent in the rig"):
        log.read("/rosout", ["level"])


# What is asked for and is not there


def test_missing_topic_and_field_name_what_there_is(tmp_path: Path) -> None:
    log = BagLog(mcap_file(tmp_path / "a.mcap", twists(2)))
    with pytest.raises(LogError, match=r"a\.mcap: no topic '/imu'; it has: /odom"):
        log.read("/imu", ["x"])
    message = r"topic '/odom' \(geometry_msgs/msg/TwistStamped\) has no field 'speed'; it has: twist\.linear\.x, "
    with pytest.raises(LogError, match=message):
        log.read("/odom", ["speed"])


def test_text_is_no_field(tmp_path: Path) -> None:
    store, name, messages = custom("string mode\nbool armed\nint8 gear\n", [{"mode": "x", "armed": True, "gear": -1}])
    log = BagLog(mcap_file(tmp_path / "a.mcap", messages, msgtype=name, store=store))
    assert log.topics["/odom"].fields == ("armed", "gear")
    assert log.read("/odom", ["gear", "armed"]).values.tolist() == [[-1.0, 1.0]]
    with pytest.raises(LogError, match="has no field 'mode'; it has: armed, gear"):
        log.read("/odom", ["mode"])


# Numbers and stamps pass through unchanged


def test_header_and_receive_stamps(tmp_path: Path) -> None:
    messages = [twist(ROS2, 0), twist(ROS2, 1, stamped=0.0), twist(ROS2, 2)]
    log = BagLog(mcap_file(tmp_path / "a.mcap", messages))
    assert log.read("/odom", [SPEED]).time.tolist() == [START - 0.25, START + 1, START + 1.75]
    assert log.read("/odom", [SPEED], stamps="receive").time.tolist() == [START, START + 1, START + 2]


def test_stamps_that_go_back_stay(tmp_path: Path) -> None:
    messages = [twist(ROS2, i, stamped=stamp) for i, stamp in enumerate([10.0, 12.0, 11.0, 11.0])]
    log = BagLog(mcap_file(tmp_path / "a.mcap", messages))
    samples = log.read("/odom", [SPEED])
    assert samples.time.tolist() == [10.0, 12.0, 11.0, 11.0]
    assert samples.values[:, 0].tolist() == [0.0, 1.0, 2.0, 3.0]


def test_nan_and_infinity_stay(tmp_path: Path) -> None:
    messages = [twist(ROS2, i, speed=speed) for i, speed in enumerate([np.nan, np.inf, -np.inf, 1e300])]
    log = BagLog(mcap_file(tmp_path / "a.mcap", messages))
    np.testing.assert_array_equal(log.read("/odom", [SPEED]).values[:, 0], [np.nan, np.inf, -np.inf, 1e300])


def test_arrays_and_sequences(tmp_path: Path) -> None:
    definition = "float64[3] fixed\nfloat32[37] bulk\nint16[] loose\nuint8[] raw\ngeometry_msgs/Point[] points\n"
    lengths = [3, 5, 1]
    rows = [
        {
            "fixed": np.arange(3.0) + i,
            "bulk": np.zeros(37, np.float32),
            "loose": np.arange(length, dtype=np.int16),
            "raw": np.zeros(4, np.uint8),
            "points": [],
        }
        for i, length in enumerate(lengths)
    ]
    store, name, messages = custom(definition, rows)
    log = BagLog(mcap_file(tmp_path / "a.mcap", messages, msgtype=name, store=store))
    assert log.topics["/odom"].fields == ("fixed[0]", "fixed[1]", "fixed[2]", "loose[0]", "loose[1]", "loose[2]")
    values = log.read("/odom", ["fixed[2]", "loose[2]"]).values
    np.testing.assert_array_equal(values, [[2.0, 2.0], [3.0, 2.0], [4.0, np.nan]])


# Containers


@pytest.mark.parametrize("compression", [None, *rosbag1.Writer.CompressionFormat])
def test_ros1_compression(tmp_path: Path, compression) -> None:
    log = BagLog(ros1_bag(tmp_path / "a.bag", 30, compression))
    assert speeds(log) == list(range(30))
    assert log.read("/odom", [SPEED]).time[3] == START + 2.75


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunking", [True, False])
def test_mcap_compression(tmp_path: Path, compression: CompressionType, chunking: bool) -> None:
    log = BagLog(mcap_file(tmp_path / "a.mcap", twists(30), compression=compression, chunking=chunking))
    assert (speeds(log), log.warnings) == (list(range(30)), ())


@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_folder_and_its_file(tmp_path: Path, storage: StoragePlugin) -> None:
    folder = ros2_folder(tmp_path / "drive", storage, twists(5))
    (file,) = [file for file in folder.iterdir() if file.suffix != ".yaml"]
    for path in (folder, file):
        assert BagLog.recognises(path)
        assert speeds(BagLog(path)) == [0.0, 1.0, 2.0, 3.0, 4.0]


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_folder_with_compressed_files_or_messages(tmp_path: Path, mode: CompressionMode) -> None:
    folder = ros2_folder(tmp_path / "drive", StoragePlugin.SQLITE3, twists(5), compressed=mode)
    assert speeds(BagLog(folder)) == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_folder_without_metadata_is_read_file_by_file_in_order(tmp_path: Path) -> None:
    for i in (10, 2):
        mcap_file(tmp_path / f"drive_{i}.mcap", [twist(ROS2, i)])
    (tmp_path / "drive_11.mcap").write_bytes(b"")
    log = BagLog(tmp_path)
    assert speeds(log) == [2.0, 10.0]
    left_out, how = log.warnings
    assert left_out.endswith("drive_11.mcap: the file is empty; record or copy it again")
    assert "no metadata.yaml (was the recorder killed?); 2 files are read one by one" in how


def test_metadata_cannot_point_outside_its_folder(tmp_path: Path) -> None:
    folder = ros2_folder(tmp_path / "drive", StoragePlugin.SQLITE3, twists(3))
    metadata = folder / "metadata.yaml"
    mcap_file(tmp_path / "outside.db3", twists(9))
    metadata.write_text(metadata.read_text().replace("drive.db3", "../outside.db3"))
    assert speeds(BagLog(folder)) == [0.0, 1.0, 2.0]


def test_other_profiles_of_mcap(tmp_path: Path) -> None:
    log = BagLog(mcap_file(tmp_path / "a.mcap", twists(3), profile=""))
    assert (speeds(log), log.warnings) == ([0.0, 1.0, 2.0], ())
    log = BagLog(mcap_file(tmp_path / "b.mcap", twists(3), encoding="json", profile="", schema="jsonschema"))
    assert log.topics["/odom"].type == f"{TWIST} is encoded as json, which is not read"


# Definitions


def test_bag_without_definitions_of_standard_types(tmp_path: Path) -> None:
    log = BagLog(mcap_file(tmp_path / "a.mcap", twists(3), schema=""))
    assert speeds(log) == [0.0, 1.0, 2.0]


def test_bag_without_definition_of_a_custom_type(tmp_path: Path) -> None:
    store, name, messages = custom("float64 speed\n", [{"speed": 1.0}])
    log = BagLog(mcap_file(tmp_path / "a.mcap", messages, msgtype=name, store=store, schema=""))
    (warning,) = log.warnings
    assert "topic '/odom'" in warning
    assert "my_robot/msg/Status is not defined in the bag; record as .mcap, or run `ros2 bag convert`" in warning
    with pytest.raises(LogError, match=r"'/odom' \(my_robot/msg/Status is not defined in the bag\) has no field"):
        log.read("/odom", ["speed"])


# Damage: a part with a warning, or one line


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunking", [True, False])
def test_mcap_whose_recorder_was_killed(tmp_path: Path, compression: CompressionType, chunking: bool) -> None:
    path = mcap_file(tmp_path / "a.mcap", twists(30), compression=compression, chunking=chunking, finish=False)
    log = BagLog(path)
    count = log.topics["/odom"].count
    assert speeds(log) == list(range(count))
    assert 25 <= count <= 30
    (warning,) = log.warnings
    assert "the MCAP file has no end" in warning
    assert f"its {count} whole messages are read; `mcap recover a.mcap -o MENDED.mcap` mends it" in warning


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.LZ4])
def test_mcap_cut_in_a_chunk_keeps_its_whole_messages(tmp_path: Path, compression: CompressionType) -> None:
    path = mcap_file(tmp_path / "a.mcap", twists(30), compression=compression)
    whole = path.read_bytes()
    counts = []
    for cut in range(len(whole) // 3, len(whole) // 2, 7):
        path.write_bytes(whole[:cut])
        log = BagLog(path)
        assert speeds(log) == list(range(log.topics["/odom"].count))
        counts.append(log.topics["/odom"].count)
    assert counts == sorted(counts)
    assert counts[0] < counts[-1] < 30


def test_mcap_that_ends_in_zeros(tmp_path: Path) -> None:
    path = mcap_file(tmp_path / "a.mcap", twists(30), finish=False)
    path.write_bytes(path.read_bytes() + bytes(100_000_000))
    assert "has no end" in BagLog(path).warnings[0]


def test_damaged_chunk_is_an_error_or_skipped(tmp_path: Path) -> None:
    path = mcap_file(tmp_path / "a.mcap", twists(30))
    data = bytearray(path.read_bytes())
    data[data.index(struct.pack("<d", 7.0))] ^= 1  # in the message with speed 7
    path.write_bytes(data)
    with pytest.raises(LogError, match=r"topic '/odom' is damaged: .*checksum.*; mend it with `mcap recover FILE"):
        speeds(BagLog(path))
    path.write_bytes(data[:-30])
    log = BagLog(path)
    assert 7.0 not in speeds(log)
    assert speeds(log)[-1] == 29.0
    assert log.warnings == (f"{path}: damaged records that are skipped: 1",)


def test_truncated_ros1_bag(tmp_path: Path) -> None:
    path = ros1_bag(tmp_path / "a.bag", 30)
    path.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(LogError, match=r"a\.bag: cannot be read: .*; mend it with `rosbag reindex FILE`, or record"):
        BagLog(path)


def test_truncated_db3(tmp_path: Path) -> None:
    folder = ros2_folder(tmp_path / "drive", StoragePlugin.SQLITE3, twists(300))
    path = folder / "drive.db3"
    path.write_bytes(path.read_bytes()[:20_000])
    with pytest.raises(LogError, match=r"drive\.db3: cannot be read: .*malformed; mend it with `sqlite3 FILE \.recov"):
        BagLog(path)
    with pytest.raises(LogError, match=r"drive: cannot be read: .*malformed; mend it with `ros2 bag reindex FOLDER`"):
        BagLog(folder)


def test_messages_left_in_the_write_ahead_file_are_told(tmp_path: Path) -> None:
    path = ros2_folder(tmp_path / "drive", StoragePlugin.SQLITE3, twists(3)) / "drive.db3"
    path.with_name("drive.db3-wal").write_bytes(b"x")
    (warning,) = BagLog(path).warnings
    assert "drive.db3-wal: messages not yet moved into the .db3 are not read" in warning


def test_database_of_something_else(tmp_path: Path) -> None:
    database = sqlite3.connect(tmp_path / "a.db3")
    database.execute("CREATE TABLE songs(name TEXT)")
    database.close()
    with pytest.raises(LogError, match=r"cannot be read: .*missing tables"):
        BagLog(tmp_path / "a.db3")


@pytest.mark.parametrize("ending", [".bag", ".mcap", ".db3"])
def test_empty_and_wrong_files(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"a{ending}"
    path.write_bytes(b"")
    with pytest.raises(LogError, match=rf"a\{ending}: the file is empty; record or copy it again"):
        BagLog(path)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    with pytest.raises(LogError, match=rf"a\{ending}: not a {ending} file; give it the ending of its format"):
        BagLog(path)


def test_mcap_renamed_to_bag(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"not a \.bag file; it is a \.mcap file: rename it"):
        BagLog(mcap_file(tmp_path / "a.bag", twists(1)))


def write_bag(path: Path) -> None:
    ros1_bag(path, 20)


def write_mcap(path: Path) -> None:
    mcap_file(path, twists(20), compression=CompressionType.ZSTD)


def write_db3(path: Path) -> None:
    folder = ros2_folder(path.with_suffix(""), StoragePlugin.SQLITE3, twists(20))
    (folder / f"{folder.name}.db3").rename(path)


def trouble(path: Path) -> str:
    """The error of reading all of a bag, or nothing; any other exception fails the test."""
    try:
        log = BagLog(path)
        for name, topic in log.topics.items():
            if topic.count and topic.fields:
                log.read(name, topic.fields)
    except LogError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(("ending", "write"), [(".bag", write_bag), (".mcap", write_mcap), (".db3", write_db3)])
@pytest.mark.parametrize("damage", ["cut", "flip"])
def test_damage_anywhere_ends_in_samples_or_one_line(
    tmp_path: Path, ending: str, write: Callable[[Path], None], damage: str
) -> None:
    path = tmp_path / f"a{ending}"
    write(path)
    whole = path.read_bytes()
    random = np.random.default_rng(0)
    for place in random.integers(0, len(whole), 60):
        data = bytearray(whole[:place] if damage == "cut" else whole)
        if damage == "flip":
            data[place] ^= 1 << random.integers(8)
        path.write_bytes(data)
        message = trouble(path)
        assert message == "" or str(path) in message
        assert "\n" not in message
        assert len(message) < 600 + 2 * len(str(path))
