"""Processes of a drive under faults: the stop is commanded in time, and dead processes are restarted. Reports.

Readings, course and plans are written by the test: receiving, mapping and planning have tests of their own.
"""

import os
import signal
import socket
import threading
import time
from contextlib import closing, contextmanager
from dataclasses import replace

import numpy as np
import pytest

from live.synthetic_robot import ACKERMANN, ENABLE, joy, live_settings, plan, reading
from offpiste.live import supervisor
from offpiste.live.part import STAMP
from offpiste.live.ring import pack_fields, pack_layers, pack_plan, packed
from offpiste.live.session import DIAGNOSTICS, MAP, PLAN, RecordSettings, new_session
from offpiste.live.supervisor import ERROR, OK, Supervisor, notify, plan_message
from offpiste.runtime.prediction import Prediction
from offpiste.runtime.settings import RuntimeSettings
from offpiste.transport.zenoh_transport import ZenohSettings
from planning_maps import layers
from runtime.stream import course
from transport.routers import Network, until


class Drive:
    """Control and its watchdog, fed with the values of the other processes, and a vehicle that listens."""

    at, speed, gear, clock = 1.0, 0.0, 1.0, staticmethod(time.time)

    def __init__(self, folder, more="", *, keys="rmw_zenoh", names=("control", "watchdog"), network=None, **changed):
        self.network, self.heard = network or Network(keys=keys), []
        robot = ZenohSettings(endpoint=self.network.endpoint, keys=keys)
        self.settings = live_settings(folder, more, robot=robot, runtime=RuntimeSettings(), drive=True, **changed)
        self.vehicle = self.network.session()
        self.vehicle.subscribe("/drive", self._commanded, msgtype=ACKERMANN)
        self._new = new_session(self.settings)
        self.session = self._new.__enter__()
        self.rings = {
            name: self.session.ring(name) for name in ("readings", "course", "plans", "map-state", "commands", "clock")
        }
        self.rings["course"].write(pack_fields(course(speed=4.0)))
        self.supervisor = Supervisor(self.session, self.network.session(), names)
        self.supervisor.start()

    def _commanded(self, received):
        message = self.vehicle.decode(received)
        if message is not None and received.publisher[:8] == self.settings.robot.identity:
            self.heard.append((time.monotonic(), message.drive))

    def feed(self, *, reads=True, plans=True):
        """Write the values of the other processes."""
        now = self.clock()
        self.rings["clock"].write(STAMP.pack(now, time.monotonic()))
        if reads:
            read = reading(now, self.at + self.speed * (now % 10), self.speed)
            self.rings["readings"].write(pack_fields(read, control=None, came=time.monotonic()))
        self.rings["map-state"].write(packed({"scan_time": now, "image_time": np.inf}))
        if plans:
            self.rings["plans"].write(pack_plan(plan(now, gear=self.gear), empty=False, stuck=False))

    def run(self, seconds, **options):
        """Feed and supervise the processes for some time; return their last states."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.feed(**options)
            parts = self.supervisor.look()
            time.sleep(0.02)
        return parts

    def drives(self, seconds=60.0):
        """Whether throttle is commanded within some time."""
        return until(lambda: (self.run(0.1), bool(self.heard) and self.heard[-1][1].acceleration > 0)[1], seconds)

    def since(self, moment):
        """Commands since a moment, with the time since."""
        return [(at - moment, drive) for at, drive in self.heard if at >= moment]

    def pid(self, name):
        return self.supervisor._processes[name].pid

    def close(self):
        self.supervisor.end()
        self._new.__exit__(None, None, None)
        self.network.close()


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    with closing(Drive(tmp_path_factory.mktemp("drive"))) as drive:
        yield drive


def first_stop(drive, moment):
    """Time from a moment to the first of the last uninterrupted stops; infinite without any."""
    heard = drive.since(moment)
    driven = max((after for after, command in heard if command.acceleration >= 0), default=-np.inf)
    return next((after for after, command in heard if after > driven and command.acceleration < 0), np.inf)


def drove(drive, moment):
    """Whether the vehicle drove on since a moment.

    On a busy machine the feeding test may itself be late by 0.2 s, which rightly stops the vehicle for a moment.
    """
    drives = [command.acceleration >= 0 for _, command in drive.since(moment)]
    return bool(drives) and 2 * sum(drives) > len(drives)


@pytest.mark.parametrize("blow", [signal.SIGKILL, signal.SIGSTOP])
def test_the_stop_is_sent_when_control_is_killed_or_hangs_and_is_completed_when_it_comes_back(drive, blow):
    assert drive.drives(), drive.supervisor.look()
    pid, moment, restarts = drive.pid("control"), time.monotonic(), drive.supervisor.restarts["control"]
    steer = drive.heard[-1][1].steering_angle
    os.kill(pid, blow)
    if blow == signal.SIGKILL:
        drive.run(0.3)  # its successor is not ready yet
        assert drive.supervisor.restarts["control"] == restarts + 1
    else:
        assert drive.run(2.0)["control"][1] == "gives no sign of life"
    assert first_stop(drive, moment) < 0.2 + 0.1, "0.2 s, and the delay of a busy machine"
    drive.speed = 3.0
    if blow == signal.SIGSTOP:
        os.kill(pid, signal.SIGCONT)
    assert until(lambda: "stopping" in drive.run(0.1)["control"][1], 30), drive.supervisor.look()
    moment = time.monotonic()
    assert "stopping" in drive.run(1.0)["control"][1], "it has readings and plans, and still moves"
    heard = [command for _, command in drive.since(moment)]
    assert all(command.acceleration < 0 for command in heard)
    assert heard[0].steering_angle == pytest.approx(steer, abs=0.06), "no jump of the steering"
    drive.speed = 0.0
    assert drive.drives(20), "from the standstill"


def test_the_vehicle_drives_on_when_the_watchdog_dies_and_it_is_restarted(drive):
    assert drive.drives()
    moment = time.monotonic()
    os.kill(drive.pid("watchdog"), signal.SIGKILL)
    assert until(lambda: drive.run(0.2)["watchdog"][1] == "ready" and drive.supervisor.restarts["watchdog"] == 1, 30)
    assert drove(drive, moment)
    assert drive.run(0.1)["watchdog"][0] == OK


def test_it_stops_when_readings_or_plans_end(drive):
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
    other, made = drive.network.session().publisher("/drive", ACKERMANN), drive.vehicle.types.empty(ACKERMANN)
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


def test_nothing_is_driven_before_the_watchdog_is_ready(tmp_path):
    with closing(Drive(tmp_path, names=("control",))) as drive:
        assert until(lambda: drive.run(0.1)["control"][1] == "stopped: the watchdog is not ready", 60)
        moment = time.monotonic()
        drive.run(0.5)
        assert drive.since(moment), "the stop is sent"
        assert all(command.acceleration < 0 for _, command in drive.heard)


def test_the_vehicle_drives_on_when_recording_ends_for_lack_of_space(tmp_path, network):
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


def test_the_switch_must_be_pressed_with_a_recent_stamp_by_one_publisher(tmp_path):
    with closing(Drive(tmp_path, ENABLE + 'field = "buttons[0]"\n')) as drive:
        assert until(lambda: (drive.run(0.1), len(drive.heard) > 20)[1], 60)
        assert all(command.acceleration < 0 for _, command in drive.heard)
        switch, another = (drive.network.session().publisher("/enable", "sensor_msgs/msg/Joy") for _ in range(2))

        def press(seconds, *publishers, age=0.0):
            for _ in range(round(seconds / 0.05)):
                for publish in publishers:
                    publish(joy(time.time_ns() - round(age * 1e9), 1))
                state = drive.run(0.05)["control"][1]
            return state, drive.heard[-1][1]

        state, command = press(1.0, switch, age=5.0)
        assert "stamped more than 0.3 s ago" in state
        assert command.acceleration < 0
        _, command = press(1.5, switch)
        assert command.acceleration > 0
        assert command.speed == pytest.approx(2.0)
        _, command = press(0.6)
        assert command.acceleration < 0, "it is no longer heard"
        state, command = press(1.0, switch, another)
        assert command.acceleration < 0
        assert state.endswith("more than one publisher of the enable topic")


def test_a_plan_lies_on_the_ground_in_the_frame_of_the_poses(tmp_path, network):
    ahead = Prediction(1.0, np.linspace((0.0,) * 6, (3.8, 0, 0, 0, 0, 0), 20))
    ground = replace(layers(4), origin=np.zeros(2), elevation=np.tile((0.0, 1.0, 3.0, np.nan), (4, 1)))
    poses = plan_message(ahead, 0, "odom", ground).poses
    places = [(round(pose.pose.position.x, 6), pose.pose.position.z) for pose in poses]
    assert places == [(0.0, 0.0), (1.0, 3.0), (2.0, 3.0), (3.0, 3.0)], "off the map, as at its edge"
    assert plan_message(ahead, 0, "odom", None).poses[-1].pose.position.z == 0.0
    heard, transport = [], network.session()
    transport.publisher = lambda topic, *_, **__: lambda message: heard.append((topic, message))
    with new_session(live_settings(tmp_path)) as session:
        reports = Supervisor(session, transport, ())
        for numbers in ({"frame": "odom"}, {"frame": ""}):
            session.ring("map").write(pack_layers(ground, scan_time=1.0))
            session.ring("plans").write(pack_plan(plan(1.0), empty=False, stuck=False))
            reports.report({"receive": (OK, "ready", numbers)})
    frames = [message.header.frame_id for topic, message in heard if topic in (PLAN, MAP)]
    assert frames == ["odom", "odom", "map", "map"]


@contextmanager
def listening(address):
    """States sent to a socket, each with its arrival."""
    heard = []

    def listen():
        while state := receiver.recv(4096).decode():
            heard.append((time.monotonic(), dict(line.split("=", 1) for line in state.split("\n"))))

    with closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as receiver:
        receiver.bind(address)
        thread = threading.Thread(target=listen)
        thread.start()
        try:
            yield heard
        finally:
            with closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as ends:
                ends.sendto(b"", address)
            thread.join()


@pytest.mark.parametrize("abstract", [True, False])
def test_states_are_sent_to_a_path_and_to_an_abstract_name(tmp_path, monkeypatch, abstract):
    path = str(tmp_path / "notify")
    monkeypatch.setenv("NOTIFY_SOCKET", f"@{path}" if abstract else path)
    with listening(f"\0{path}" if abstract else path) as heard:
        notify(READY=1, STATUS="two\nlines")
    assert [state for _, state in heard] == [{"READY": "1", "STATUS": "two lines"}]


def test_an_unreachable_service_manager_is_one_warning(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "nothing"))
    supervisor._warn_once.cache_clear()
    notify(READY=1)
    notify(WATCHDOG=1)
    assert caplog.messages == ["the service manager is not notified: No such file or directory ($NOTIFY_SOCKET)"]
