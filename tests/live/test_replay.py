"""Replay of a recorded drive in one process: courses, shadow mode, and the switch."""

import numpy as np
import pytest

from live.synthetic_robot import ENABLE, path, planner, rig, small_settings, write_course, write_log
from offpiste.live.play import RecordedDrive
from offpiste.live.reception import CourseRequest, Reception
from offpiste.live.replay import StepDriver, replayed
from offpiste.logs.ros.writer import make
from offpiste.transport.message_types import MessageTypes

TYPES = MessageTypes()


def driver_of(vehicle, request, **options):
    reception = Reception(vehicle, request, cameras=False)
    return StepDriver(vehicle, planner(), reception, small_settings(), **options), reception


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write_log(tmp_path_factory.mktemp("log") / "a.mcap", seconds=1.2)


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
    assert len(trackers) > 50
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
