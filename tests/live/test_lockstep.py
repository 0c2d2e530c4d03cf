"""Driving in one process: over a transport as in a replay, to the bit; clocks, switches and other publishers."""

import signal
import subprocess
import sys
import threading

import numpy as np
import pytest

from live.synthetic_robot import (
    ENABLE,
    RUN,
    START,
    cloud,
    odometry,
    path,
    planner,
    rig,
    small_settings,
    write_course,
    write_log,
    write_rig,
)
from offpiste.core.errors import LiveError
from offpiste.live.command_messages import Command, CommandMessages
from offpiste.live.lockstep import Batch, Heard, Lockstep, StepDriver
from offpiste.live.play import LogPlayer, RecordedDrive, clock_message, replayed
from offpiste.live.reception import CourseRequest, Reception
from offpiste.live.session import READY
from offpiste.logs.ros.bag_files import stamp_of
from offpiste.logs.ros.writer import make
from offpiste.transport.interface import Received
from offpiste.transport.message_types import MessageTypes
from transport.routers import network, until

__all__ = ["network"]
TYPES = MessageTypes()
PRESSED = make("std_msgs/Bool", data=True)


def driver_of(vehicle, request, **options):
    reception = Reception(vehicle, request, cameras=False)
    return StepDriver(vehicle, planner(), reception, small_settings(), **options), reception


def commands(steps):
    return np.array([(now, *step.command.control) for now, step in steps if step is not None])


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write_log(tmp_path_factory.mktemp("log") / "a.mcap", seconds=1.2)


@pytest.fixture(scope="module")
def standing(tmp_path_factory):
    return write_log(tmp_path_factory.mktemp("log") / "stands.mcap", seconds=1.6, speed=0.0)


def offline(log, vehicle, request, **options):
    driver, _ = driver_of(vehicle, request, **options)
    return list(replayed(RecordedDrive(log, vehicle), driver, TYPES))


def messages(step, now):
    return [Heard(one.topic, TYPES.decoded(one.type, one.data), now) for one in step.messages]


class Running:
    """A lockstep in a thread of its own."""

    def __init__(self, *arguments):
        self.lockstep, self.stop, self.steps, self.error = Lockstep(*arguments), threading.Event(), [], None
        self._thread = threading.Thread(target=self._run)

    def _run(self):
        try:
            self.lockstep.run(lambda *step: self.steps.append(step), self.stop)
        except LiveError as error:
            self.error = str(error)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self.stop.set()
        self._thread.join(10)
        assert not self._thread.is_alive()

    def ends(self, seconds=10):
        self._thread.join(seconds)
        return not self._thread.is_alive()


def test_lockstep_over_the_transport_is_the_replay_to_the_bit(standing, tmp_path, network):
    vehicle, request = rig(), CourseRequest(write_course(tmp_path))
    expected = commands(offline(standing, vehicle, request, shadow=False))
    driver, reception = driver_of(vehicle, request, shadow=False)
    node, heard, spy = network.session(), [], network.session()
    spy.subscribe("/drive", heard.append)
    with Running(node, driver, reception, CommandMessages(vehicle, node.types)) as running:
        player = LogPlayer(RecordedDrive(standing, vehicle), network.session(patient=True))
        played = player.play_in_lockstep(np.inf)
        assert running.ends(), "with the log"
    assert played.steps == len(running.steps)
    np.testing.assert_array_equal(commands(running.steps), expected)
    assert len(expected) > 50
    assert (expected[:, 1] > 0).any(), "it drives"
    assert until(lambda: len(heard) == len(expected) + 5), "each command is sent, and the stop at the end"
    sent = [spy.decode(message).drive for message in heard]
    assert sent[len(expected) - 1].acceleration > 0
    assert all(drive.acceleration < 0 and drive.speed == 0 for drive in sent[-5:])
    assert not node.refused


def test_shadow_mode_plans_without_the_switch_and_though_its_stops_are_not_obeyed(log, tmp_path):
    steps = [step for _, step in offline(log, rig(ENABLE), CourseRequest(write_course(tmp_path))) if step is not None]
    assert "stopping" in [step.controls.mode for step in steps[:5]], "before the first plan"
    assert steps[-1].controls.mode == "driving", "though the vehicle never stood"
    assert steps[-1].why == ""
    assert any(step.command.control[0] > 0 for step in steps)


def test_it_waits_for_a_course_drives_to_a_goal_and_continues_a_repeated_path(log):
    vehicle = rig()
    driver, reception = driver_of(vehicle, CourseRequest(topic="/plan"))
    trackers = []
    for k, step in enumerate(RecordedDrive(log, vehicle).steps()):
        now = step.time / 1e9
        if k == 5:
            assert driver.step([], now) is None
            assert reception.waiting_for == "a course on /plan"
        driver.step([*messages(step, now), *[Heard("/plan", path("map", step.time), now)] * (k > 5)], now)
        trackers += [] if driver.runtime is None else [driver.runtime.follower.tracker]
    assert len(trackers) > 50
    assert all(tracker is trackers[0] for tracker in trackers)
    steps = [step for _, step in offline(log, vehicle, CourseRequest(goal=(40.0, 0.0), speed=4.0)) if step is not None]
    assert steps[-1].controls.mode == "driving"


def test_without_the_switch_it_is_held_and_does_not_wind_up(log, tmp_path):
    held = offline(log, rig(ENABLE), CourseRequest(write_course(tmp_path)), shadow=False)
    steps = [step for _, step in held if step is not None]
    assert steps[-1].controls.why == "the enable topic is not heard"
    assert {step.controls.mode for step in steps} <= {"stopping", "stopped"}
    assert all(step.command.control[0] == 0 and step.command.prediction is None for step in steps)


def test_a_clock_that_goes_back_makes_it_stop_and_requires_the_switch_again(standing, tmp_path):
    vehicle = rig(ENABLE)
    driver, _ = driver_of(vehicle, CourseRequest(write_course(tmp_path)), shadow=False)
    first = next(iter(RecordedDrive(standing, vehicle).steps())).time / 1e9
    for k, step in zip(range(70), RecordedDrive(standing, vehicle).steps(), strict=False):
        now = first + 0.02 * k
        last = driver.step([*messages(step, now), Heard("/enable", PRESSED, now)], now)
    assert last.controls.mode == "driving"
    back = driver.step([], first + 0.1)
    assert back.controls.mode == "stopping"
    assert back.why == "the enable topic is not heard", "the earlier message has a later time"
    assert back.command.control[0] == 0
    again = [Heard("/enable", PRESSED, first + 0.12, publisher) for publisher in (b"", b"another")]
    assert driver.step(again, first + 0.12).why == "more than one publisher of the enable topic"


def test_another_publisher_makes_it_stop_and_a_frozen_clock_is_no_step(standing, tmp_path, network, monkeypatch):
    monkeypatch.setattr("offpiste.live.lockstep._STILL", 0.3)
    vehicle, request = rig(), CourseRequest(write_course(tmp_path))
    driver, reception = driver_of(vehicle, request, shadow=False)
    node, robot, heard = network.session(), network.session(patient=True), []
    network.session().subscribe("/drive", heard.append)
    other = robot.publisher("/drive", "std_msgs/msg/String")
    clock = robot.publisher("/clock", "rosgraph_msgs/msg/Clock")
    drive = RecordedDrive(standing, vehicle)
    send = {topic: robot.raw_publisher(topic, kind) for topic, kind in drive.types.items()}
    with Running(node, driver, reception, CommandMessages(vehicle, node.types)) as running:
        got = running.steps
        assert until(lambda: len(got) or clock(clock_message(next(iter(drive.steps())).time)), every=0.2)
        for step in drive.steps():
            count = len(got)
            for one in step.messages:
                send[one.topic](one.data)
            clock(clock_message(step.time))
            assert until(lambda: len(got) > count or step.time <= round(1e9 * got[0][0]), 20)  # noqa: B023
        assert got[-1][1].controls.mode == "driving"
        other(make("std_msgs/String", data="mine"))
        times = iter(range(step.time + 20_000_000, 1 << 62, 20_000_000))
        assert until(lambda: clock(clock_message(next(times))) or "publisher" in got[-1][1].why, 5)
        last, count = next(times), len(got)
        del heard[:]
        assert until(lambda: clock(clock_message(last)) or len(heard) >= 2, 5), "the stop, though no step is made"
        assert len(got) <= count + 2


class Counting(StepDriver):
    """Driver that records its steps."""

    stop = Command(0.0, np.array((0.0, 1.0, 0.0)), 1.0)

    def __init__(self):
        self.times, self.heard = [], []

    def step(self, heard, now):
        self.times.append(now)
        self.heard.append(list(heard))
        return None


def counted(node):
    driver = Counting()
    return Running(node, driver, Reception(rig(), CourseRequest(topic="/plan"), cameras=False), None), driver


@pytest.mark.parametrize(("period", "expected"), [(1, 10), (20, 20), (25, 20)])
def test_a_step_is_made_once_every_dt_of_a_clock_whatever_its_period(network, period, expected):
    robot, (running, driver) = network.session(patient=True), counted(network.session())
    clock = robot.publisher("/clock", "rosgraph_msgs/msg/Clock")
    with running:
        assert until(lambda: driver.times or clock(clock_message(10**9)), every=0.2)
        for k in range(1, round(expected * 20 / min(period, 20)) + 1):
            stamp = 10**9 + k * period * 10**6
            clock(clock_message(stamp))
            assert until(lambda stamp=stamp: running.lockstep._last == stamp), "the player waits, too"
        assert until(lambda: len(driver.times) >= expected)
    assert len(driver.times) == pytest.approx(expected + 1, abs=1)


def test_before_the_first_clock_only_old_scans_are_dropped(network, monkeypatch):
    monkeypatch.setattr("offpiste.live.lockstep._HELD", 1)
    robot, (running, driver) = network.session(patient=True), counted(network.session())
    odom = robot.publisher("/odom", "nav_msgs/msg/Odometry")
    points = robot.publisher("/points", "sensor_msgs/msg/PointCloud2")
    clock, received = robot.publisher("/clock", "rosgraph_msgs/msg/Clock"), running.lockstep._received
    for send in (lambda: odom(odometry(0.0)), lambda: points(cloud(0.0))):
        waiting = received.qsize()
        assert until(lambda send=send, waiting=waiting: send() or received.qsize() > waiting, every=0.2)
    for row in range(1, 9):
        points(cloud(row / 50))
        odom(odometry(row / 50))
    with running:
        assert until(lambda: driver.times or clock(clock_message(10**9)), every=0.2)
    rows = [(one.topic, round((stamp_of(0, one.message, "header") * 1e9 - START) / 2e7)) for one in driver.heard[0]]
    assert [row for topic, row in rows if topic == "/odom"][-9:] == list(range(9))
    assert [row for topic, row in rows if topic == "/points"] == [8]


def test_of_large_topics_the_newest_messages_are_kept_in_order():
    batch = Batch({"/image", "/points"}, size=100)
    for topic, size in (("/image", 60), ("/tf", 500), ("/points", 90), ("/image", 50), ("/odom", 1), ("/points", 900)):
        batch.add(Received(topic, "", bytes(size), 0.0))
    taken = [(one.topic, len(one.data)) for one in batch.taken()]
    assert taken == [("/tf", 500), ("/image", 50), ("/odom", 1), ("/points", 900)]
    assert not batch


def test_a_robot_without_a_clock_is_not_waited_for_forever(network, monkeypatch):
    monkeypatch.setattr("offpiste.live.lockstep._WAIT", 0.3)
    running, _ = counted(network.session())
    odom = network.session().publisher("/odom", "nav_msgs/msg/Odometry")
    with running:
        assert until(lambda: odom(odometry(0.0)) or running.error), "though messages keep coming"
    assert "/clock was not heard" in running.error


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
        assert live.wait(60) == 0, said.read_text()
    finally:
        live.kill()
