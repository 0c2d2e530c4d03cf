"""Processes of a drive under faults: the stop is commanded in time, and what died is started again.

Readings, course and plans are written by the test: receiving, mapping and planning have tests of their own, and their
kernels would have to be compiled first.
"""

import os
import signal
import time
from contextlib import closing
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from live.made_up_robot import ACKERMANN, ENABLE, write_course, write_rig
from offpiste.live.packing import pack_course, pack_measured, pack_plan, packed, unpacked
from offpiste.live.reception import CourseRequest
from offpiste.live.reports import DIAGNOSTICS, ERROR
from offpiste.live.session import LiveSettings, RecordSettings, new_session
from offpiste.live.supervisor import Supervisor
from offpiste.logs.ros.writer import header, make
from offpiste.planning.course import Course
from offpiste.runtime.estimator import VehicleReading
from offpiste.runtime.follower import TimedPlan
from offpiste.runtime.prediction import Prediction
from offpiste.transport.zenoh_transport import ZenohSettings
from transport.routers import Network, until

RUN = "pretrained:proving-ground/parametric"


class Drive:
    """Control and its watchdog, fed with what the other processes would hand over, and a vehicle that listens."""

    def __init__(self, folder, more="", *, keys="rmw_zenoh", clock="system", names=("control", "watchdog"),
                 network=None, record=None):  # fmt: skip
        self.network, self.heard = network or Network(keys=keys), []
        self.settings = LiveSettings(
            write_rig(folder, more), RUN, None, CourseRequest(write_course(folder)),
            robot=ZenohSettings(endpoint=self.network.endpoint, keys=keys), drive=True, clock=clock,
            record=record,
        )  # fmt: skip
        self.vehicle = self.network.session()
        self.vehicle.subscribe("/drive", self._commanded, msgtype=ACKERMANN)
        self._new = new_session(self.settings)
        self.session = self._new.__enter__()
        self.rings = {
            name: self.session.ring(name) for name in ("readings", "course", "plans", "map-state", "commands", "clock")
        }
        x = np.arange(0.0, 60.0)
        self.rings["course"].write(pack_course(Course(np.stack((x, 0 * x), axis=1), np.full(60, 4.0))))
        self.supervisor = Supervisor(self.session, self.network.session(), cameras=False, names=names)
        self.supervisor.start()

    def _commanded(self, received):
        message = self.vehicle.decode(received)
        if message is not None and received.publisher[:8] == self.settings.robot.identity:
            self.heard.append((time.monotonic(), message.drive))

    def feed(self, *, reads=True, plans=True):
        """What the other processes hand over now."""
        now = time.time()
        if reads:
            place, turn = np.array((1.0, 0, 0)), np.array((0, 0, 0, 1.0))
            reading = VehicleReading(now, place, turn, np.zeros(3), 0.0, np.zeros(4))
            self.rings["readings"].write(pack_measured(reading, control=None, came=time.monotonic()))
        self.rings["map-state"].write(packed({"scan_time": now, "image_time": np.inf}))
        if plans:
            controls = torch.tensor([[0.4, 0.0, 0.2]]).repeat(250, 1)
            plan = TimedPlan(now, now - 0.1, controls)
            states = np.tile((0.0, 0, 0, 2.0, 0, 0), (250, 1))
            self.rings["plans"].write(pack_plan(plan, Prediction(now, states), empty=False, stuck=False))

    def run(self, seconds, **options):
        """Feed and look after the processes for some time; their last states."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.feed(**options)
            parts = self.supervisor.look()
            time.sleep(0.02)
        return parts

    def drives(self, seconds=60.0):
        """Whether it comes to drive within some time."""
        return until(lambda: (self.run(0.1), bool(self.heard) and self.heard[-1][1].acceleration > 0)[1], seconds)

    def since(self, moment):
        """Commands after a moment, with the time since."""
        return [(at - moment, drive) for at, drive in self.heard if at >= moment]

    def pid(self, name):
        return self.supervisor._processes[name].pid

    def close(self):
        self.supervisor.end()
        self._new.__exit__(None, None, None)
        self.network.close()


@pytest.fixture
def drive(tmp_path):
    with closing(Drive(tmp_path)) as drive:
        yield drive


def first_stop(drive, moment):
    """Time from a moment until the first stop after which nothing else was heard; infinite where there is none."""
    heard = drive.since(moment)
    driven = max((after for after, command in heard if command.acceleration >= 0), default=-np.inf)
    return next((after for after, command in heard if after > driven and command.acceleration < 0), np.inf)


def drove(drive, moment):
    """Whether commands were heard since a moment, and no stop."""
    heard = drive.since(moment)
    return bool(heard) and all(command.acceleration >= 0 for _, command in heard)


def test_a_stop_that_driving_follows_is_not_the_first():
    def heard(*accelerations):
        commands = [(0.1 * k, SimpleNamespace(acceleration=one)) for k, one in enumerate(accelerations)]
        return SimpleNamespace(since=lambda _: commands)

    assert first_stop(heard(1.0, -1.0, -1.0), 0.0) == 0.1
    assert first_stop(heard(1.0, -1.0, 1.0, -1.0), 0.0) == pytest.approx(0.3)
    assert first_stop(heard(1.0, -1.0, 1.0), 0.0) == np.inf


@pytest.mark.parametrize("blow", [signal.SIGKILL, signal.SIGSTOP])
def test_the_stop_is_sent_when_control_is_killed_or_hangs_and_driving_resumes(drive, blow):
    assert drive.drives(), drive.supervisor.look()
    pid, moment = drive.pid("control"), time.monotonic()
    os.kill(pid, blow)
    if blow == signal.SIGKILL:
        drive.run(0.3)  # it is not back yet
        assert drive.supervisor.restarts["control"] == 1
    else:
        parts = drive.run(2.5)
        assert parts["control"][1] == "gives no sign of life"
    assert first_stop(drive, moment) < 0.2 + 0.1, "0.2 s, and what a busy machine adds"
    if blow == signal.SIGSTOP:
        os.kill(pid, signal.SIGCONT)
    del drive.heard[:]
    assert drive.drives(), "once it is back"


def test_the_vehicle_drives_on_when_recording_ends_for_want_of_space(tmp_path):
    with closing(Network()) as network:
        record, diagnostics, listener = RecordSettings(tmp_path / "a.mcap", free=1e6), [], network.session()
        listener.subscribe(DIAGNOSTICS, diagnostics.append)
        names = ("control", "watchdog", "record")
        with closing(Drive(tmp_path, network=network, names=names, record=record)) as drive:
            assert drive.drives(), drive.supervisor.look()
            assert until(lambda: drive.run(0.1)["record"][1].startswith("ended"), 60)
            moment = time.monotonic()
            level, state, _ = drive.run(1.0)["record"]
            assert drove(drive, moment)
            assert level == ERROR
            assert "and 1e+06 GB have to stay free" in state
            assert drive.supervisor.restarts == dict.fromkeys(names, 0)
            drive.supervisor.report(drive.supervisor.look())
            assert until(lambda: diagnostics)
            said = {status.name: status for status in listener.decode(diagnostics[-1]).status}["offpiste: record"]
            assert (said.level, said.message) == (level, state)


def test_the_vehicle_drives_on_when_the_watchdog_dies_and_it_is_started_again(drive):
    assert drive.drives()
    moment = time.monotonic()
    os.kill(drive.pid("watchdog"), signal.SIGKILL)
    assert until(lambda: drive.run(0.2)["watchdog"][1] == "ready" and drive.supervisor.restarts["watchdog"] == 1, 30)
    assert drove(drive, moment)
    assert drive.run(0.1)["watchdog"][0] == 0


def test_nothing_is_driven_before_the_watchdog_is_ready(tmp_path):
    with closing(Drive(tmp_path, names=("control",))) as drive:
        assert until(lambda: drive.run(0.1)["control"][1] == "stopped: the watchdog is not ready", 60)
        moment = time.monotonic()
        drive.run(0.5)
        assert drive.since(moment), "the stop is sent"
        assert all(command.acceleration < 0 for _, command in drive.heard)


def test_it_stops_when_readings_end_or_plans_end(drive):
    assert drive.drives()
    moment = time.monotonic()
    parts = drive.run(0.6, reads=False)
    assert first_stop(drive, moment) < 0.1 + 0.2
    assert parts["control"][1].endswith("no state of the vehicle")
    assert drive.drives(10)
    moment = time.monotonic()
    parts = drive.run(1.2, plans=False)
    assert 0.3 < first_stop(drive, moment) < 0.5 + 0.3
    assert parts["control"][1].endswith("no plan")


def test_a_second_publisher_of_commands_makes_it_stop(drive):
    assert drive.drives()
    other = drive.network.session().publisher("/drive", "ackermann_msgs/msg/AckermannDriveStamped")
    made = drive.vehicle.types.empty("ackermann_msgs/msg/AckermannDriveStamped")
    made.drive.acceleration = 5.0
    moment = time.monotonic()
    for _ in range(10):
        other(made)
        drive.run(0.05)
    assert first_stop(drive, moment) < 0.3
    parts = drive.run(0.3)
    assert parts["control"][1].endswith("another publisher commands the vehicle")
    assert parts["control"][2]["dropped"]["/drive: commands of another publisher"] > 0
    assert drive.drives(10), "a second after the last one"


def test_the_router_gone_and_back(drive):
    assert drive.drives()
    drive.network.router.close()
    drive.run(0.5)
    drive.network.router = drive.network.session(mode="router")
    del drive.heard[:]
    assert drive.drives(20), "sessions find the router again, and commands flow"


def test_a_dead_mans_switch_holds_it_until_it_is_pressed(tmp_path):
    with closing(Drive(tmp_path, ENABLE)) as drive:
        assert until(lambda: (drive.run(0.1), len(drive.heard) > 20)[1], 60)
        assert all(command.acceleration < 0 for _, command in drive.heard)
        switch = drive.vehicle.publisher("/enable", "std_msgs/msg/Bool")
        for _ in range(30):
            switch(make("std_msgs/Bool", data=True))
            drive.run(0.05)
        assert drive.heard[-1][1].acceleration > 0
        assert drive.heard[-1][1].speed == pytest.approx(2.0)
        drive.run(0.6)
        assert drive.heard[-1][1].acceleration < 0, "it is not heard any more"
        another = drive.network.session().publisher("/enable", "std_msgs/msg/Bool")
        for _ in range(20):
            switch(make("std_msgs/Bool", data=True))
            another(make("std_msgs/Bool", data=True))
            state = drive.run(0.05)["control"][1]
            assert drive.heard[-1][1].acceleration < 0
        assert state.endswith("more than one publisher of the enable topic")


@pytest.mark.parametrize(("age", "moves"), [(0.0, True), (5.0, False)])
def test_a_switch_with_an_old_stamp_does_not_enable(tmp_path, age, moves):
    with closing(Drive(tmp_path, ENABLE + 'field = "buttons[0]"\n')) as drive:
        assert until(lambda: (drive.run(0.1), len(drive.heard) > 20)[1], 60)
        switch = drive.vehicle.publisher("/enable", "sensor_msgs/msg/Joy")
        for _ in range(40):
            head, pressed = header(time.time_ns() - round(age * 1e9), ""), np.ones(1, np.int32)
            switch(make("sensor_msgs/Joy", header=head, axes=np.zeros(0, np.float32), buttons=pressed))
            state = drive.run(0.05)["control"][1]
        assert (drive.heard[-1][1].acceleration > 0) == moves
        assert ("stamped more than 0.3 s ago" in state) != moves


def test_the_vehicle_is_stopped_before_control_ends(drive):
    assert drive.drives()
    moment = time.monotonic()
    drive.supervisor.end()
    assert drive.heard[-1][1].acceleration < 0
    assert first_stop(drive, moment) < 0.3
    state = unpacked(drive.session.ring("status-control").newest().data)
    assert state["cpu_s"] > 0
