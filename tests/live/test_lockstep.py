"""In lockstep over the transport the commands are those of a replay without it, to the bit."""

import threading
from pathlib import Path

import numpy as np
import pytest

from live.made_up_robot import ENABLE, planner, rig, small_settings, write_course, write_log
from offpiste.errors import LiveError
from offpiste.live.command_messages import CommandMessages
from offpiste.live.driver import StepDriver
from offpiste.live.lockstep import Lockstep
from offpiste.live.log_steps import RecordedDrive
from offpiste.live.play import LogPlayer
from offpiste.live.reception import CourseRequest, Reception
from offpiste.live.replay import replayed
from offpiste.transport.message_types import MessageTypes
from transport.routers import network, until

__all__ = ["network"]


def driver_of(vehicle, request, **options):
    reception = Reception(vehicle, request, cameras=False)
    return StepDriver(vehicle, planner(), reception, small_settings(), **options), reception


def commands(steps):
    return np.array([(now, *step.command.control) for now, step in steps if step is not None])


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write_log(tmp_path_factory.mktemp("log") / "a.mcap", seconds=1.2)


def offline(log, vehicle, request, **options):
    driver, _ = driver_of(vehicle, request, **options)
    return list(replayed(RecordedDrive(log, vehicle), driver, MessageTypes()))


def test_lockstep_over_the_transport_is_the_replay_to_the_bit(tmp_path, network):
    log = write_log(tmp_path / "stands.mcap", seconds=1.6, speed=0.0)
    vehicle, request = rig(), CourseRequest(write_course(tmp_path))
    expected = commands(offline(log, vehicle, request, shadow=False))
    driver, reception = driver_of(vehicle, request, shadow=False)
    node, player_side, got, heard = network.session(), network.session(patient=True), [], []
    spy = network.session()
    spy.subscribe("/drive", heard.append)
    lockstep = Lockstep(node, driver, reception, CommandMessages(vehicle, node.types))
    running = threading.Thread(target=lockstep.run, args=(lambda now, step: got.append((now, step)), threading.Event()))
    running.start()
    player = LogPlayer(RecordedDrive(log, vehicle), player_side)
    played = player.play_in_lockstep(np.inf)
    running.join(10)
    assert not running.is_alive(), "the end of the log ends it"
    assert played.steps == len(got)
    np.testing.assert_array_equal(commands(got), expected)
    assert len(expected) > 50
    assert (expected[:, 1] > 0).any(), "it drives"
    assert until(lambda: len(heard) == len(expected)), "each command is sent"
    assert not node.refused


def test_in_shadow_mode_it_plans_on_though_its_stops_are_not_obeyed(log, tmp_path):
    steps = offline(log, rig(), CourseRequest(write_course(tmp_path)))
    modes = [step.controls.mode for _, step in steps if step is not None]
    assert "stopping" in modes[:5], "before the first plan"
    assert modes[-1] == "driving", "though the vehicle never stood"


def test_it_waits_for_what_it_needs(log, tmp_path):
    vehicle = rig()
    driver, reception = driver_of(vehicle, CourseRequest(topic="/plan"))
    steps = list(replayed(RecordedDrive(log, vehicle), driver, MessageTypes()))
    assert all(step is None for _, step in steps)
    assert reception.waiting_for == "a course on /plan"


def test_a_goal_is_a_straight_course_from_where_the_vehicle_is(log):
    steps = [step for _, step in offline(log, rig(), CourseRequest(goal=(40.0, 0.0), speed=4.0)) if step is not None]
    assert steps[-1].controls.mode == "driving"


def test_without_the_switch_it_is_held_and_does_not_wind_up(log, tmp_path):
    held = offline(log, rig(ENABLE), CourseRequest(write_course(tmp_path)), shadow=False)
    steps = [step for _, step in held if step is not None]
    assert steps[-1].controls.why == "the enable topic is not heard"
    assert {step.controls.mode for step in steps} <= {"stopping", "stopped"}
    assert all(step.command.control[0] == 0 for step in steps)
    assert all(step.command.prediction is None for step in steps), "a speed of zero is sent"


@pytest.mark.parametrize(
    "request_", [CourseRequest(), CourseRequest(Path("a"), "/b"), CourseRequest(topic="/b", speed=0.0)]
)
def test_a_course_comes_from_one_place(request_):
    with pytest.raises(LiveError):
        request_.check()
    with pytest.raises(LiveError, match="no place"):
        CourseRequest(goal=(np.inf, 0.0)).check()
