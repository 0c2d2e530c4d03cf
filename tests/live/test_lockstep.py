"""In lockstep over the transport the commands are those of a replay without it, to the bit."""

import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from live.made_up_robot import (
    ENABLE,
    START,
    cloud,
    odometry,
    planner,
    rig,
    small_settings,
    write_course,
    write_log,
    write_rig,
)
from live.test_reception import path
from offpiste.core.errors import LiveError
from offpiste.live.command_messages import Command, CommandMessages
from offpiste.live.driver import Heard, StepDriver
from offpiste.live.lockstep import READY, Lockstep
from offpiste.live.log_steps import RecordedDrive, decoded, replayed
from offpiste.live.play import LogPlayer, clock_message
from offpiste.live.reception import CourseRequest, Reception
from offpiste.logs.ros.bag_files import stamp_of
from offpiste.logs.ros.writer import make
from offpiste.transport.message_types import MessageTypes
from transport.routers import network, until

__all__ = ["network"]
RUN = "pretrained:proving-ground/parametric"
ODOM = "nav_msgs/msg/Odometry"


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
    assert until(lambda: len(heard) == len(expected) + 5), "each command is sent, and the stop at the end"
    sent = [spy.decode(message).drive for message in heard]
    assert sent[len(expected) - 1].acceleration > 0
    assert all(drive.acceleration < 0 and drive.speed == 0 for drive in sent[-5:])
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


def test_a_path_that_is_sent_again_is_not_begun_again(log):
    vehicle = rig()
    driver, _ = driver_of(vehicle, CourseRequest(topic="/plan"))
    drive, types, trackers = RecordedDrive(log, vehicle), MessageTypes(), []
    for step in drive.steps():
        now = step.time / 1e9
        heard = [Heard(one.topic, decoded(types, one.type, one.data), now) for one in step.messages]
        driver.step([*heard, Heard("/plan", path("map", step.time), now)], now)
        trackers += [] if driver.runtime is None else [driver.runtime.follower.tracker]
    assert len(trackers) > 50
    assert all(tracker is trackers[0] for tracker in trackers)


def test_without_the_switch_it_is_held_and_does_not_wind_up(log, tmp_path):
    held = offline(log, rig(ENABLE), CourseRequest(write_course(tmp_path)), shadow=False)
    steps = [step for _, step in held if step is not None]
    assert steps[-1].controls.why == "the enable topic is not heard"
    assert {step.controls.mode for step in steps} <= {"stopping", "stopped"}
    assert all(step.command.control[0] == 0 for step in steps)
    assert all(step.command.prediction is None for step in steps), "a speed of zero is sent"


def test_in_shadow_mode_no_switch_is_needed(log, tmp_path):
    steps = [step for _, step in offline(log, rig(ENABLE), CourseRequest(write_course(tmp_path))) if step is not None]
    assert steps[-1].controls.mode == "driving"
    assert steps[-1].why == ""
    assert any(step.command.control[0] > 0 for step in steps), "what would be commanded is shown"


def stepped(driver, log, vehicle, times):
    """Steps of a log whose clock is changed."""
    drive, types = RecordedDrive(log, vehicle), MessageTypes()
    for step, time in zip(drive.steps(), times, strict=False):
        heard = [Heard(one.topic, decoded(types, one.type, one.data), time) for one in step.messages]
        yield driver.step(heard, time)


def test_a_clock_that_goes_back_makes_it_stop_and_the_switch_be_heard_again(tmp_path):
    log = write_log(tmp_path / "stands.mcap", seconds=1.6, speed=0.0)
    vehicle = rig(ENABLE)
    driver, _ = driver_of(vehicle, CourseRequest(write_course(tmp_path)), shadow=False)
    first = next(iter(RecordedDrive(log, vehicle).steps())).time / 1e9
    times = [first + 0.02 * k for k in range(70)]
    pressed, found = make("std_msgs/Bool", data=True), []
    for time, _ in zip(times, stepped(driver, log, vehicle, times), strict=False):
        found.append(driver.step([Heard("/enable", pressed, time)], time))
    assert found[-1].controls.mode == "driving"
    back = driver.step([], first + 0.1)
    assert back.controls.mode == "stopping"
    assert back.why == "the enable topic is not heard", "that it was pressed later is of another time"
    assert back.command.control[0] == 0
    again = [Heard("/enable", pressed, first + 0.12, publisher) for publisher in (b"", b"another")]
    assert driver.step(again, first + 0.12).why == "more than one publisher of the enable topic"


def test_in_lockstep_another_publisher_makes_it_stop_and_a_frozen_clock_is_no_step(tmp_path, network, monkeypatch):
    monkeypatch.setattr("offpiste.live.lockstep._STILL", 0.3)
    log = write_log(tmp_path / "stands.mcap", seconds=1.6, speed=0.0)
    vehicle, request = rig(), CourseRequest(write_course(tmp_path))
    driver, reception = driver_of(vehicle, request, shadow=False)
    node, robot, got, heard = network.session(), network.session(patient=True), [], []
    network.session().subscribe("/drive", heard.append)
    lockstep, stop = Lockstep(node, driver, reception, CommandMessages(vehicle, node.types)), threading.Event()
    running = threading.Thread(target=lockstep.run, args=(lambda *step: got.append(step), stop))
    running.start()
    other = robot.publisher("/drive", "std_msgs/msg/String")
    clock = robot.publisher("/clock", "rosgraph_msgs/msg/Clock")
    drive = RecordedDrive(log, vehicle)
    send = {topic: robot.raw_publisher(topic, kind) for topic, kind in drive.types.items()}
    assert until(lambda: len(got) or clock(clock_message(next(iter(drive.steps())).time)), every=0.2)
    for step in drive.steps():
        count = len(got)
        for one in step.messages:
            send[one.topic](one.data)
        clock(clock_message(step.time))
        assert until(lambda: len(got) > count or step.time <= round(1e9 * got[0][0]), 20)  # noqa: B023
        last = step.time
    assert got[-1][1].controls.mode == "driving"
    other(make("std_msgs/String", data="mine"))
    times = iter(range(last + 20_000_000, 1 << 62, 20_000_000))
    assert until(lambda: clock(clock_message(next(times))) or "publisher" in got[-1][1].why, 5)
    last = next(times)
    count = len(got)
    del heard[:]
    assert until(lambda: clock(clock_message(last)) or len(heard) >= 2, 5), "the stop, though no step is made"
    assert len(got) <= count + 2
    stop.set()
    running.join(10)
    assert not running.is_alive()


class Counting(StepDriver):
    """A driver that counts its steps and keeps what it was given."""

    stop = Command(0.0, np.array((0.0, 1.0, 0.0)), 1.0)

    def __init__(self):
        self.times, self.heard = [], []

    def step(self, heard, now):
        self.times.append(now)
        self.heard.append(list(heard))
        return None


@pytest.mark.parametrize(("period", "expected"), [(1, 20), (5, 20), (20, 100), (25, 100), (100, 100)])
def test_a_step_is_made_once_every_dt_of_a_clock_whatever_its_period(network, period, expected, tmp_path):
    node, robot, driver, stop = network.session(), network.session(patient=True), Counting(), threading.Event()
    lockstep = Lockstep(node, driver, Reception(rig(), CourseRequest(topic="/plan"), cameras=False), None)
    clock = robot.publisher("/clock", "rosgraph_msgs/msg/Clock")
    running = threading.Thread(target=lockstep.run, args=(lambda *_: None, stop))
    running.start()
    assert until(lambda: driver.times or clock(clock_message(10**9)), every=0.2), "few enough to be worked off"
    count = round(expected * 20 / min(period, 20))
    for k in range(1, count + 1):
        stamp = 10**9 + k * period * 10**6
        clock(clock_message(stamp))
        assert until(lambda stamp=stamp: lockstep._last == stamp), (
            "it waits for the one before, as a log that is played"
        )
    assert until(lambda: len(driver.times) >= expected)
    stop.set()
    running.join(10)
    assert len(driver.times) == pytest.approx(expected + 1, abs=1)


def counted(node):
    driver = Counting()
    return Lockstep(node, driver, Reception(rig(), CourseRequest(topic="/plan"), cameras=False), None), driver


def test_before_the_first_clock_all_is_kept_but_old_scans(network, monkeypatch):
    monkeypatch.setattr("offpiste.live.lockstep._HELD", 1)
    robot, (lockstep, driver), stop = network.session(patient=True), counted(network.session()), threading.Event()
    odom, points = robot.publisher("/odom", ODOM), robot.publisher("/points", "sensor_msgs/msg/PointCloud2")
    clock = robot.publisher("/clock", "rosgraph_msgs/msg/Clock")
    for send in (lambda: odom(odometry(0.0)), lambda: points(cloud(0.0))):
        waiting = lockstep._received.qsize()
        assert until(lambda send=send, waiting=waiting: send() or lockstep._received.qsize() > waiting, every=0.2)
    for row in range(1, 9):
        points(cloud(row / 50))
        odom(odometry(row / 50))
    running = threading.Thread(target=lockstep.run, args=(lambda *_: None, stop))
    running.start()
    assert until(lambda: driver.times or clock(clock_message(10**9)), every=0.2)
    stop.set()
    running.join(10)
    rows = [(one.topic, round((stamp_of(0, one.message, "header") * 1e9 - START) / 2e7)) for one in driver.heard[0]]
    assert [row for topic, row in rows if topic == "/odom"][-9:] == list(range(9))
    assert [row for topic, row in rows if topic == "/points"] == [8]


def test_a_robot_without_a_clock_is_not_waited_for_for_ever(network, monkeypatch):
    monkeypatch.setattr("offpiste.live.lockstep._WAIT", 0.3)
    robot, (lockstep, _), stop, ended = network.session(), counted(network.session()), threading.Event(), []

    def run():
        try:
            lockstep.run(lambda *_: None, stop)
        except LiveError as error:
            ended.append(str(error))

    running, odom = threading.Thread(target=run), robot.publisher("/odom", ODOM)
    running.start()
    ends = until(lambda: odom(odometry(0.0)) or ended)
    stop.set()
    running.join(10)
    assert ends, "though messages keep coming"
    assert "/clock was not heard" in ended[0]


def test_a_signal_ends_a_lockstep_in_order(tmp_path, network):
    said, ready, session = tmp_path / "said.txt", [], network.session()
    session.subscribe(READY, ready.append, history=True)
    command = [sys.executable, "-m", "offpiste", "live", write_rig(tmp_path, actuators=True), "--run", RUN,
               "--endpoint", network.endpoint, "--course", str(write_course(tmp_path)),
               "--drive", "--lockstep"]  # fmt: skip
    with said.open("w") as file:
        live = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT)
    try:
        assert until(lambda: ready, 120), said.read_text()
        live.send_signal(signal.SIGTERM)
        assert live.wait(60) == 0, "the stop is sent where anything was commanded"
    finally:
        live.kill()


@pytest.mark.parametrize(
    "request_", [CourseRequest(), CourseRequest(Path("a"), "/b"), CourseRequest(topic="/b", speed=0.0)]
)
def test_a_course_comes_from_one_place(request_):
    with pytest.raises(LiveError):
        request_.check()
    with pytest.raises(LiveError, match="no place"):
        CourseRequest(goal=(np.inf, 0.0)).check()
