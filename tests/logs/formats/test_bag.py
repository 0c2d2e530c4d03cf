"""Recorded ROS 1 and ROS 2 bags, and small bags of every storage, encoding and field type."""

import copy
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType
from rosbags import rosbag1
from rosbags.rosbag2.enums import CompressionMode, StoragePlugin
from rosbags.typesys.store import Typestore

from bag_files import ROS2, SPEED, START, TWIST, custom, mcap_file, ros1_bag, ros2_folder, speeds, twist, twists
from offpiste.core.errors import LogError
from offpiste.logs.formats.bag import BagLog
from sensor_bags import joints, transforms
from sensor_drive import written

# Real bags


def test_ros2_mcap_of_a_turtlebot(data_folder: Path) -> None:
    log = BagLog(data_folder / "bags" / "evo_nav2_turtlebot.mcap")
    counts = {name: topic.count for name, topic in log.topics.items()}
    body = "/tf odom -> base_link"
    pairs = {body: 242, "/tf map -> odom": 87}
    pairs |= {f"/tf base_link -> {side}_wheel": 171 for side in ("left", "right")}
    assert counts == {"/amcl_pose": 135, "/odom": 2639, "/tf": 5422, "/tf_static": 1} | pairs
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
    as_transform = log.read(body, ["transform.translation.x"])
    np.testing.assert_array_equal(as_transform.values[:, 0], samples.values[:, 0])
    np.testing.assert_array_equal(as_transform.time, samples.time)


def test_ros1_bag_with_its_own_message_types(data_folder: Path) -> None:
    log = BagLog(data_folder / "bags" / "PlotJuggler_tilt_laser.bag")
    assert {name: topic.count for name, topic in log.topics.items()} == {
        "/gravity_vector": 356, "/imu_data": 356, "/info_gps": 356, "/magnetic_vector": 356, "/position_gps": 356,
        "/scan": 178, "/temperature": 712, "/tf": 711, "/velocity": 712,
        "/tf tilt_axis -> camera": 178, "/tf tilt_axis -> laser": 178, "/tf tilt_base -> tilt_axis": 355,
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
    with pytest.raises(LogError, match=r"a\.mcap: no topic '/imu'; available: /odom"):
        log.read("/imu", ["x"])
    message = r"topic '/odom' \(geometry_msgs/msg/TwistStamped\) has no field 'speed'; available: twist\.linear\.x, "
    with pytest.raises(LogError, match=message):
        log.read("/odom", ["speed"])


# Numbers and stamps pass through unchanged


def test_header_and_receive_stamps(tmp_path: Path) -> None:
    messages = [twist(ROS2, 0), twist(ROS2, 1, stamped=0.0), twist(ROS2, 2)]
    log = BagLog(mcap_file(tmp_path / "a.mcap", messages))
    assert log.read("/odom", [SPEED]).time.tolist() == [START - 0.25, START + 1, START + 1.75]
    assert log.read("/odom", [SPEED], stamps="receive").time.tolist() == [START, START + 1, START + 2]


def test_arrays_and_sequences(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    definition = "float64[3] fixed\nfloat32[37] bulk\nint16[] loose\nuint8[] raw\nuint8[<=4] few\n"
    definition += "geometry_msgs/Point[] points\nstring mode\nbool armed\n"
    lengths = [3, 5, 1]
    rows = [
        {
            "fixed": np.arange(3.0) + i,
            "bulk": np.zeros(37, np.float32),
            "loose": np.arange(length, dtype=np.int16),
            "raw": np.zeros(4, np.uint8),
            "few": np.zeros(4, np.uint8),
            "points": [],
            "mode": "x",
            "armed": True,
        }
        for i, length in enumerate(lengths)
    ]
    store, name, messages = custom(definition, rows)
    decoded, decode = [], Typestore.deserialize_cdr
    monkeypatch.setattr(Typestore, "deserialize_cdr", lambda *given: decoded.append(1) or decode(*given))
    log = BagLog(mcap_file(tmp_path / "a.mcap", messages, msgtype=name, store=store))
    assert decoded == [1], "no more messages than needed"
    assert log.topics["/odom"].fields == (*(f"{a}[{i}]" for a in ("fixed", "loose") for i in range(3)), "armed")
    values = log.read("/odom", ["fixed[2]", "loose[2]"]).values
    np.testing.assert_array_equal(values, [[2.0, 2.0], [3.0, 2.0], [4.0, np.nan]])


# Containers


def test_every_container_and_compression_holds_the_same(tmp_path: Path) -> None:
    paths = [ros1_bag(tmp_path / f"{kind}.bag", 30, kind) for kind in (None, *rosbag1.Writer.CompressionFormat)]
    paths += [
        mcap_file(tmp_path / f"{kind.name}_{chunking}.mcap", twists(30), compression=kind, chunking=chunking)
        for kind in CompressionType
        for chunking in (True, False)
    ]
    compressed = [(StoragePlugin.SQLITE3, mode) for mode in (CompressionMode.FILE, CompressionMode.MESSAGE)]
    for storage, mode in [*((storage, None) for storage in StoragePlugin), *compressed]:
        folder = ros2_folder(tmp_path / f"{storage.name}_{mode}", storage, twists(30), compressed=mode)
        paths += [folder, *(file for file in folder.iterdir() if file.suffix in (".mcap", ".db3") and mode is None)]
    for path in paths:
        assert BagLog.recognises(path)
        log = BagLog(path)
        assert (speeds(log), log.warnings) == (list(range(30)), ()), path.name
        assert log.read("/odom", [SPEED]).time[3] == START + 2.75


def test_folder_without_metadata_is_read_file_by_file_in_order(tmp_path: Path) -> None:
    for i in (10, 2):
        mcap_file(tmp_path / f"drive_{i}.mcap", [twist(ROS2, i)])
    (tmp_path / "drive_11.mcap").write_bytes(b"")
    log = BagLog(tmp_path)
    assert speeds(log) == [2.0, 10.0]
    left_out, how = log.warnings
    assert left_out.endswith("drive_11.mcap: the file is empty; record or copy it again")
    assert "no metadata.yaml (was the recorder killed?); 2 files are read as one drive" in how


def test_a_folder_of_several_drives_is_none(tmp_path: Path) -> None:
    for name, count in (("monday", 5), ("tuesday", 9)):
        mcap_file(tmp_path / f"{name}.mcap", twists(count))
    with pytest.raises(
        LogError, match=r"holds several recordings: tuesday.mcap begins before monday.mcap ends"
    ) as caught:
        BagLog(tmp_path)
    assert caught.value.how == "give each file by itself"
    assert copy.copy(caught.value).logs == ["monday.mcap", "tuesday.mcap"]


def test_logs_beside_the_files_of_a_bag_are_named(tmp_path: Path) -> None:
    folder = ros2_folder(tmp_path / "drive", StoragePlugin.MCAP, twists(3))
    mcap_file(folder / "other.mcap", twists(9))
    (folder / "params.csv").write_text("t,x\n0,1\n1,2\n")
    (folder / "notes.pdf").touch()
    for name in ("other.mcap", "params.csv"):
        assert f"not read: {name}, which is not part of this bag" in BagLog(folder).warnings
    assert len(BagLog(folder).warnings) == 2
    (folder / "metadata.yaml").unlink()
    (folder / "other.mcap").unlink()
    assert [name for name in BagLog(folder).warnings if "not read" in name] == [
        "not read: params.csv, which is not part of this bag"
    ]


def test_metadata_cannot_point_outside_its_folder(tmp_path: Path) -> None:
    folder = ros2_folder(tmp_path / "drive", StoragePlugin.SQLITE3, twists(3))
    metadata = folder / "metadata.yaml"
    mcap_file(tmp_path / "outside.db3", twists(9))
    metadata.write_text(metadata.read_text().replace("drive.db3", "../outside.db3"))
    assert speeds(BagLog(folder)) == [0.0, 1.0, 2.0]


def test_other_profiles_of_mcap(tmp_path: Path) -> None:
    for name, other in (("a", {"profile": ""}), ("c", {"schema": ""})):  # standard types need no definitions
        log = BagLog(mcap_file(tmp_path / f"{name}.mcap", twists(3), **other))
        assert (speeds(log), log.warnings) == ([0.0, 1.0, 2.0], ())
    log = BagLog(mcap_file(tmp_path / "b.mcap", twists(3), encoding="json", profile="", schema="jsonschema"))
    assert log.topics["/odom"].type == f"{TWIST} is encoded as json, which is not supported"


# Definitions


def test_bag_without_definition_of_a_custom_type(tmp_path: Path) -> None:
    store, name, messages = custom("float64 speed\n", [{"speed": 1.0}])
    log = BagLog(mcap_file(tmp_path / "a.mcap", messages, msgtype=name, store=store, schema=""))
    (warning,) = log.warnings
    assert "topic '/odom'" in warning
    assert "my_robot/msg/Status is not defined in the bag; record as .mcap, or run `ros2 bag convert`" in warning
    with pytest.raises(LogError, match=r"'/odom' \(my_robot/msg/Status is not defined in the bag\) has no field"):
        log.read("/odom", ["speed"])


def test_database_of_something_else(tmp_path: Path) -> None:
    database = sqlite3.connect(tmp_path / "a.db3")
    database.execute("CREATE TABLE songs(name TEXT)")
    database.close()
    with pytest.raises(LogError, match=r"cannot be read: .*missing tables"):
        BagLog(tmp_path / "a.db3")


def test_a_recorded_topic_may_be_named_like_a_pair_of_frames(tmp_path: Path) -> None:
    topic = "/map odom -> base"
    pair = transforms(("odom", "base", (0, 0, 0), (0, 0, 0, 1)))
    messages = [(k, topic, joints(k, [0.1 * k], ["wheel"])) for k in range(5)]
    log = BagLog(written(tmp_path / "drive.mcap", messages, [(0.5, "/map", pair)]))
    np.testing.assert_allclose(log.read(topic, ("position[0]",)).values[:, 0], [0.0, 0.1, 0.2, 0.3, 0.4])
