"""Files of a recording: their numbers, what each of them begins with, and the space that stays free."""

from contextlib import closing

import numpy as np
import pytest

from live.made_up_robot import START, odometry, tree
from offpiste.core.errors import LogError
from offpiste.live import recording
from offpiste.live.recording import Recording
from offpiste.live.session import RecordSettings
from offpiste.logs import open_log
from offpiste.logs.ros.writer import header, make
from offpiste.transport.interface import Received
from offpiste.transport.message_types import MessageTypes

TYPES = MessageTypes()


def received(topic, message, seconds):
    data = bytes(TYPES.store.serialize_cdr(message, message.__msgtype__))
    return Received(topic, message.__msgtype__, data, START / 1e9 + seconds)


def transforms(child):
    message = tree()
    message.transforms[0].child_frame_id = child
    return message


def recorded(path, rows=500, **settings):
    """Ten seconds of odometry, after two trees of frames and two courses that came before the clock was known."""
    with closing(Recording(RecordSettings(path, **settings), TYPES, ("/tf_static", "/course"))) as writer:
        for child in ("lidar", "camera", "lidar"):
            writer.add(received("/tf_static", transforms(child), -np.inf))
        for stamp in (1, 2):
            course = make("nav_msgs/Path", header=header(stamp, "map"), poses=[])
            writer.add(received("/course", course, -np.inf))
        for row in range(rows):
            writer.add(received("/odom", odometry(row / 50, row / 50), row / 50))
            writer.look()
    return open_log(path)


def test_files_of_a_length_are_whole_and_one_drive_together(tmp_path):
    recorded(tmp_path / "drive.mcap", seconds=4.0)
    for name, rows in {"drive": 201, "drive-2": 201, "drive-3": 98}.items():
        log = open_log(tmp_path / f"{name}.mcap")
        assert not log.warnings
        assert {topic: log.topics[topic].count for topic in ("/odom", "/tf_static", "/course")} == {
            "/odom": rows, "/tf_static": 2, "/course": 1,
        }  # fmt: skip
        assert [tf.child for tf in log.transforms(["/tf_static"])] == ["camera", "lidar"]
        assert next(log.messages("/course"))[0] == 2e-9, "the newest"
    stamps = open_log(tmp_path).stamps("/odom")
    np.testing.assert_allclose(stamps, START / 1e9 + np.arange(500) / 50, atol=1e-6)


def test_a_file_of_the_largest_size_is_followed_by_another(tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "_LOOKS", 0.0)
    recorded(tmp_path / "drive.mcap", size=1e-5)
    assert len(list(tmp_path.iterdir())) >= 2
    assert open_log(tmp_path).topics["/odom"].count == 500


def test_where_space_has_to_stay_free_it_ends_and_the_file_is_whole(tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "_LOOKS", 0.0)
    sizes = iter(range(300, 0, -1))
    monkeypatch.setattr(recording.shutil, "disk_usage", lambda _: type("Usage", (), {"free": next(sizes) * 1e9}))
    with pytest.raises(LogError, match="199 GB of the disk are free, and 200 GB have to stay free"):
        recorded(tmp_path / "drive.mcap", free=200.0)
    log = open_log(tmp_path / "drive.mcap")
    assert log.topics["/odom"].count == 102
    assert not log.warnings


def test_what_is_repeated_is_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "_MOST", 2)
    log = recorded(tmp_path / "drive.mcap")
    assert {topic: log.topics[topic].count for topic in ("/tf_static", "/course")} == {"/tf_static": 1, "/course": 1}
