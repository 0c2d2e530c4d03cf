"""Recorded drives in steps of the clock: played in real time, and replayed in one process."""

import time

import numpy as np
import pytest

from live.synthetic_robot import ENABLE, START, odometry, path, planner, rig, small_settings, write_course, write_log
from offpiste.core.errors import LiveError, LogError
from offpiste.live.play import LogPlayer, RecordedDrive, clock_message, play_log
from offpiste.live.reception import CourseRequest, Reception
from offpiste.live.replay import StepDriver, replayed
from offpiste.logs.ros.writer import McapWriter, make
from offpiste.transport.message_types import MessageTypes
from offpiste.transport.zenoh_transport import ZenohSettings
from transport.routers import until

TYPES = MessageTypes()


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
    steps, messages, _ = player.play(2.0, 10.0)
    assert time.monotonic() - began > 0.45
    assert messages == 51
    assert until(lambda: len(got) == 51)
    assert until(lambda: len(clocks) == steps)
    assert player.left_out == ("/points",)


def test_a_recorded_clock_and_topics_of_offpiste_are_not_played(tmp_path, network):
    path = tmp_path / "a.mcap"
    with McapWriter(path) as writer:
        writer.write("/odom", odometry(0.0), START)
        writer.write("/clock", clock_message(5), START)
        writer.write("/offpiste/mode", make("std_msgs/String", data="driving"), START)
    player = LogPlayer(RecordedDrive(path), network.session())
    assert player.left_out == ("/clock", "/offpiste/mode")
    assert player.play(1.0, 10.0)[1] == 1


@pytest.mark.parametrize("seconds", [float("nan"), 0.0])
def test_an_invalid_length_is_refused(log, seconds):
    with pytest.raises(LiveError, match="--seconds"):
        play_log(log, "", ZenohSettings(), 1.0, seconds)


def driver_of(vehicle, request, **options):
    reception = Reception(vehicle, request, cameras=False)
    return StepDriver(vehicle, planner(), reception, small_settings(), **options), reception


def steps_of(log, vehicle, request, **options):
    driver, _ = driver_of(vehicle, request, **options)
    return [step for _, step in replayed(RecordedDrive(log, vehicle), driver, TYPES) if step is not None]


def messages(step):
    return [(one.topic, TYPES.decoded(one.type, one.data)) for one in step.messages]


def test_equal_messages_give_equal_commands_from_the_standstill(tmp_path):
    log, request = write_log(tmp_path / "stands.mcap", seconds=1.6, speed=0.0), CourseRequest(write_course(tmp_path))
    first, again = (
        np.array([step.command.control for step in steps_of(log, rig(), request, shadow=False)]) for _ in range(2)
    )
    np.testing.assert_array_equal(first, again)
    assert len(first) > 50
    assert (first[:, 0] > 0).any(), "it drives"


def test_shadow_mode_plans_without_the_switch_and_though_its_stops_are_not_obeyed(log, tmp_path):
    steps = steps_of(log, rig(ENABLE), CourseRequest(write_course(tmp_path)))
    assert "stopping" in [step.controls.mode for step in steps[:5]], "before the first plan"
    assert steps[-1].controls.mode == "driving", "though the vehicle never stood"
    assert steps[-1].why == ""
    assert any(step.command.control[0] > 0 for step in steps)


def test_it_waits_for_a_course_drives_to_a_goal_and_continues_a_repeated_path(log):
    driver, reception = driver_of(rig(), CourseRequest(topic="/plan"))
    trackers = []
    for k, step in enumerate(RecordedDrive(log, rig()).steps()):
        if k == 5:
            assert driver.step([], step.time / 1e9) is None
            assert reception.waiting_for == "a course on /plan"
        driver.step([*messages(step), *[("/plan", path("map", step.time))] * (k > 5)], step.time / 1e9)
        trackers += [] if driver.runtime is None else [driver.runtime.follower.tracker]
    assert len(trackers) > 40
    assert all(tracker is trackers[0] for tracker in trackers)
    assert steps_of(log, rig(), CourseRequest(goal=(40.0, 0.0), speed=4.0))[-1].controls.mode == "driving"


@pytest.mark.parametrize("pressed", [False, True])
def test_it_is_held_until_the_switch_is_pressed_and_does_not_wind_up(tmp_path, pressed):
    log = write_log(tmp_path / "stands.mcap", seconds=1.6, speed=0.0)
    driver, _ = driver_of(rig(ENABLE), CourseRequest(write_course(tmp_path)), shadow=False)
    switch, steps = [("/enable", make("std_msgs/Bool", data=True))] * pressed, []
    for step in RecordedDrive(log, rig()).steps():
        steps.append(driver.step([*messages(step), *switch], step.time / 1e9))
    steps = [step for step in steps if step is not None]
    if pressed:
        assert steps[-1].controls.mode == "driving"
        return
    assert steps[-1].controls.why == "the enable topic is not heard"
    assert {step.controls.mode for step in steps} <= {"stopping", "stopped"}
    assert all(step.command.control[0] == 0 and step.command.prediction is None for step in steps)
