"""Playing a log in real time, and what is not played."""

import time

import pytest

from live.made_up_robot import START, odometry, write_log
from offpiste.core.errors import LiveError
from offpiste.live.commands import play_log
from offpiste.live.log_steps import RecordedDrive
from offpiste.live.play import LogPlayer, clock_message
from offpiste.logs.ros.writer import McapWriter, make
from offpiste.transport.zenoh_transport import ZenohSettings
from transport.routers import network, until

__all__ = ["network"]


def test_it_takes_as_long_as_the_log_and_publishes_all_of_it(tmp_path, network):
    listener, got, clocks = network.session(), [], []
    for topic in ("/odom", "/points"):
        listener.subscribe(topic, got.append)
    listener.subscribe("/clock", clocks.append)
    listener.subscribe("/tf_static", got.append, history=True)
    log = RecordedDrive(write_log(tmp_path / "a.mcap", seconds=1.0))
    player = LogPlayer(log, network.session(patient=True), ("/points",))  # a full link drops no message
    time.sleep(1.0)
    began = time.monotonic()
    played = player.play(2.0, 10.0)
    assert time.monotonic() - began > 0.45
    assert played.messages == 51
    assert until(lambda: len(got) == 51)
    assert until(lambda: len(clocks) == played.steps)
    assert player.left_out == ("/points",)


def test_a_recorded_clock_and_what_offpiste_published_are_not_played(tmp_path, network):
    path = tmp_path / "a.mcap"
    with McapWriter(path) as writer:
        writer.write("/odom", odometry(0.0), START)
        writer.write("/clock", clock_message(5), START)
        writer.write("/offpiste/mode", make("std_msgs/String", data="driving"), START)
    listener, clocks = network.session(), []
    listener.subscribe("/clock", clocks.append)
    player = LogPlayer(RecordedDrive(path), network.session(patient=True))
    assert player.left_out == ("/clock", "/offpiste/mode")
    time.sleep(1.0)
    played = player.play(1.0, 10.0)
    assert played.messages == 1
    assert until(lambda: len(clocks) == played.steps)


def test_a_rate_that_is_none_is_refused(tmp_path, network):
    player = LogPlayer(RecordedDrive(write_log(tmp_path / "a.mcap", seconds=0.1)), network.session())
    with pytest.raises(LiveError, match="--rate"):
        player.play(0.0, 1.0)


@pytest.mark.parametrize("seconds", [float("nan"), 0.0])
def test_a_length_that_is_none_is_refused(tmp_path, seconds):
    with pytest.raises(LiveError, match="--seconds"):
        play_log(tmp_path / "a.mcap", "", ZenohSettings(), 1.0, seconds, lockstep=False, without=())
