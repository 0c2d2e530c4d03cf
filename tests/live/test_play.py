"""Recorded drives in steps of the clock, and played in real time."""

import time

import numpy as np
import pytest

from live.synthetic_robot import START, odometry, rig, write_log
from offpiste.core.errors import LiveError, LogError
from offpiste.live.play import LogPlayer, RecordedDrive, clock_message, play_log
from offpiste.logs.ros.writer import McapWriter, make
from offpiste.transport.zenoh_transport import ZenohSettings
from transport.routers import until


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write_log(tmp_path_factory.mktemp("log") / "a.mcap", seconds=1.0)


def test_steps_are_even_and_contain_all_messages(log):
    drive = RecordedDrive(log)
    steps = list(drive.steps())
    assert set(np.diff([step.time for step in steps])) == {20_000_000}
    assert steps[0].time == START + 20_000_000
    messages = [one for step in steps for one in step.messages]
    assert [sum(m.topic == topic for m in messages) for topic in ("/odom", "/points", "/tf_static")] == [50, 10, 1]
    assert all(step.time - 20_000_000 <= one.time <= step.time for step in steps for one in step.messages)
    assert drive.seconds == pytest.approx(0.98)


def test_a_cloud_is_played_at_the_time_of_its_last_point(log):
    steps = RecordedDrive(log, rig()).steps()
    played = {one.time - START for step in steps for one in step.messages if one.topic == "/points"}
    assert played == {k * 100_000_000 + 90_000_000 for k in range(10)}


def test_topics_can_be_chosen_and_other_logs_are_refused(log, data_folder):
    steps = RecordedDrive(log, topics=["/odom"]).steps()
    assert {one.topic for step in steps for one in step.messages} == {"/odom"}
    with pytest.raises(LogError, match="has none of the topics"):
        RecordedDrive(log, topics=["/none"])
    with pytest.raises(LogError, match="no such log"):
        RecordedDrive(log.with_name("none.mcap"))
    with pytest.raises(LogError, match="ROS 1"):
        RecordedDrive(data_folder / "bags" / "PlotJuggler_tilt_laser.bag")


def test_playing_takes_the_time_of_the_log_and_publishes_all_messages(log, network):
    listener, got, clocks = network.session(), [], []
    for topic in ("/odom", "/points"):
        listener.subscribe(topic, got.append)
    listener.subscribe("/clock", clocks.append)
    listener.subscribe("/tf_static", got.append, history=True)
    player = LogPlayer(RecordedDrive(log), network.session(patient=True), ("/points",))
    with pytest.raises(LiveError, match="--rate"):
        player.play(0.0, 1.0)
    time.sleep(1.0)
    began = time.monotonic()
    played = player.play(2.0, 10.0)
    assert time.monotonic() - began > 0.45
    assert played.messages == 51
    assert until(lambda: len(got) == 51)
    assert until(lambda: len(clocks) == played.steps)
    assert player.left_out == ("/points",)


def test_a_recorded_clock_and_topics_of_offpiste_are_not_played(tmp_path, network):
    path = tmp_path / "a.mcap"
    with McapWriter(path) as writer:
        writer.write("/odom", odometry(0.0), START)
        writer.write("/clock", clock_message(5), START)
        writer.write("/offpiste/mode", make("std_msgs/String", data="driving"), START)
    player = LogPlayer(RecordedDrive(path), network.session())
    assert player.left_out == ("/clock", "/offpiste/mode")
    assert player.play(1.0, 10.0).messages == 1


@pytest.mark.parametrize("seconds", [float("nan"), 0.0])
def test_an_invalid_length_is_refused(log, seconds):
    with pytest.raises(LiveError, match="--seconds"):
        play_log(log, "", ZenohSettings(), 1.0, seconds)
