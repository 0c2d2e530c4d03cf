"""A log in steps of the clock: in the order in which its messages came, and none before it was measured."""

import numpy as np
import pytest

from live.made_up_robot import START, rig, write_log
from offpiste.core.errors import LogError
from offpiste.live.log_steps import RecordedDrive


def test_steps_are_even_and_hold_all_messages(tmp_path):
    drive = RecordedDrive(write_log(tmp_path / "a.mcap", seconds=1.0))
    steps = list(drive.steps())
    assert set(np.diff([step.time for step in steps])) == {20_000_000}
    assert steps[0].time == START + 20_000_000
    messages = [one for step in steps for one in step.messages]
    assert [sum(m.topic == topic for m in messages) for topic in ("/odom", "/points", "/tf_static")] == [50, 10, 1]
    for step in steps:
        assert all(step.time - 20_000_000 <= one.time <= step.time for one in step.messages)
    assert drive.seconds == pytest.approx(0.98)


def test_a_cloud_is_played_once_its_last_point_was_measured(tmp_path):
    path = write_log(tmp_path / "a.mcap", seconds=1.0)
    played = {
        one.time - START
        for step in RecordedDrive(path, rig()).steps()
        for one in step.messages
        if one.topic == "/points"
    }
    assert played == {k * 100_000_000 + 90_000_000 for k in range(10)}


def test_only_chosen_topics_are_played(tmp_path):
    drive = RecordedDrive(write_log(tmp_path / "a.mcap", seconds=0.5), topics=["/odom"])
    assert {one.topic for step in drive.steps() for one in step.messages} == {"/odom"}
    with pytest.raises(LogError, match="has none of the topics"):
        RecordedDrive(tmp_path / "a.mcap", topics=["/none"])


def test_other_logs_are_refused(tmp_path, data_folder):
    with pytest.raises(LogError, match="no such log"):
        RecordedDrive(tmp_path / "none.mcap")
    with pytest.raises(LogError, match="ROS 1"):
        RecordedDrive(data_folder / "bags" / "PlotJuggler_tilt_laser.bag")
