"""Faults of whole drives: clocks, restarts during a stop, signals to all processes, dead servers, and the end."""

import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import closing, suppress
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from live.synthetic_robot import ACKERMANN, ENABLE, RUN, START, Robot, live_settings, write_course, write_rig
from live.test_supervisor import Drive, drove, first_stop, listening
from offpiste.core.signals import BACKGROUND, ENDING, GROUP_SIGNALS
from offpiste.live.part import AFTER
from offpiste.live.ring import unpacked
from offpiste.live.session import RecordSettings, new_session
from offpiste.live.supervisor import Supervisor, end_requested
from offpiste.logs import open_log
from offpiste.logs.ros.writer import make
from transport.routers import Network, free_port, until

GAP = 0.3
"""The watchdog's silence of 0.1 s, and the delay of a busy machine [s]."""


def runs(pid):
    """Whether a process runs; a zombie does not."""
    stat = Path(f"/proc/{pid}/stat")
    return stat.exists() and stat.read_text().rpartition(")")[2].split()[0] != "Z"


def parent_of(pid):
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


@pytest.fixture
def moving(tmp_path):
    with closing(Drive(tmp_path, clock="clock")) as drive:
        assert drive.drives(), drive.supervisor.look()
        yield drive


def last_command(drive):
    return unpacked(drive.rings["commands"].newest().data)


def stops_since(drive, moment):
    return [after for after, command in drive.since(moment) if command.acceleration < 0]


def test_a_clock_that_stands_still_stops_the_vehicle(moving):
    frozen, moment = time.time(), time.monotonic()
    moving.clock = lambda: frozen
    parts = moving.run(1.0)
    assert first_stop(moving, moment) < 0.1 + 0.2, "readings whose stamps repeat are as old as the first"
    assert "no state of the vehicle" in parts["control"][1]
    moving.clock = time.time
    assert moving.drives(20), "once it runs again"


def test_readings_without_their_clock_stop_it_too(moving):
    moment = time.monotonic()
    moving.rings["clock"] = type("Silent", (), {"write": staticmethod(lambda _: True)})
    parts = moving.run(1.6)
    assert first_stop(moving, moment) < 1.0 + 0.3
    assert "stands still" in parts["control"][1] or "no state" in parts["control"][1]


def test_a_clock_that_goes_back_stops_it_and_it_drives_again_by_the_new_time(moving):
    moving.at = 9.0
    moving.run(0.5)
    assert last_command(moving)["progress"] == pytest.approx(9.0, abs=0.3)
    moment = time.monotonic()
    moving.at, moving.clock = 2.0, lambda: time.time() - 1000.0  # like a simulator that begins again
    moving.run(0.3)
    assert stops_since(moving, moment), "though it soon drives on, since it is at a standstill"
    assert moving.drives(20)
    assert last_command(moving)["progress"] == pytest.approx(2.0, abs=0.3)


def test_a_control_that_comes_back_keeps_the_gear_until_the_standstill(moving):
    def gears():
        return {unpacked(one.data)["gear"] for one in moving.rings["commands"].since(begun)}

    begun, moving.gear = moving.rings["commands"].written, -1.0
    assert until(lambda: (moving.run(0.1), -1.0 in gears())[1], 20)
    os.kill(moving.pid("control"), signal.SIGKILL)
    moving.speed, moving.gear = -3.0, 1.0
    moving.run(0.3)
    begun = moving.rings["commands"].written
    assert until(lambda: "stopping" in moving.run(0.1)["control"][1], 30), moving.supervisor.look()
    moving.run(0.5)
    assert gears() == {-1.0}, "it still moves"
    moving.speed = 0.0
    assert until(lambda: (moving.run(0.1), 1.0 in gears())[1], 20)


@pytest.mark.parametrize("first", ["", "control", "watchdog", "server"])
def test_the_last_command_is_a_stop_whichever_process_ends_first(moving, first):
    assert until(lambda: moving.run(0.1)["watchdog"][1] == "ready", 30)
    if first == "server":  # it forks the processes
        os.kill(parent_of(moving.pid("control")), signal.SIGTERM)
    elif first:
        moving.supervisor._names.remove(first)
        os.kill(moving.pid(first), signal.SIGKILL)
    moment = time.monotonic()
    moving.supervisor.end()
    time.sleep(0.2)
    assert first_stop(moving, moment) < 0.3
    assert moving.heard[-1][1].acceleration < 0
    stops = stops_since(moving, moment)
    assert stops[-1] - stops[0] > 0.9
    assert max(np.diff(stops)) < 0.4, "until the end"


def test_the_watchdog_continues_the_stop_without_memory_and_control(moving):
    assert until(lambda: moving.run(0.1)["watchdog"][1] == "ready", 30)
    moving.supervisor._ring("end")
    shutil.rmtree(moving.session.folder)  # as the next session does, once the parent was killed
    os.kill(moving.pid("control"), signal.SIGKILL)
    moment = time.monotonic()
    time.sleep(1.0)
    stops = stops_since(moving, moment)
    assert len(stops) > 5
    assert stops[-1] > 0.8


def test_processes_leave_ending_to_their_parent(moving):
    for number in GROUP_SIGNALS:
        for name in ("control", "watchdog"):
            os.kill(moving.pid(name), number)
    moment = time.monotonic()
    moving.run(0.6)
    assert drove(moving, moment)
    assert moving.supervisor.restarts == {"control": 0, "watchdog": 0}


def test_if_the_server_of_the_processes_dies_no_process_runs_twice(moving):
    before = [moving.pid("control"), moving.pid("watchdog")]
    os.kill(parent_of(before[0]), signal.SIGKILL)
    assert until(lambda: (moving.run(0.2), moving.supervisor.restarts)[1] == {"control": 1, "watchdog": 1}, 60)
    assert until(lambda: not any(runs(pid) for pid in before), 5)
    del moving.heard[:]
    assert moving.drives(60)


def test_over_the_bridge_the_rig_states_the_type_of_the_switch(tmp_path):
    types = '[live.types]\n"/enable" = "std_msgs/msg/Bool"\n'
    with closing(Drive(tmp_path, ENABLE + types, keys="bridge")) as drive:
        assert until(lambda: (drive.run(0.1), len(drive.heard) > 20)[1], 60)
        switch = drive.vehicle.publisher("/enable", "std_msgs/msg/Bool")
        for _ in range(60):
            switch(make("std_msgs/Bool", data=True))
            drive.run(0.05)
        assert drive.heard[-1][1].acceleration > 0
        moment = time.monotonic()
        drive.vehicle._session.put("drive", b"a command of another publisher, of any type")
        drive.run(0.3)
        assert first_stop(drive, moment) < 0.3


def test_the_memory_of_a_killed_session_is_removed_by_the_next_one(tmp_path):
    with new_session(live_settings(tmp_path)) as living:
        killed = living.folder.with_name(f"{living.folder.name}-killed")
        killed.mkdir()
        shutil.copy(living.folder / "lock", killed)  # which nobody holds any more
        with new_session(live_settings(tmp_path)) as session:
            assert not killed.exists()
            assert living.folder.is_dir()
        assert not session.folder.exists()
    assert not living.folder.exists()


@pytest.mark.parametrize("number", ENDING)
def test_a_drive_ends_by_any_signal_of_a_terminal(number):
    before = signal.signal(number, signal.SIG_DFL)  # nohup ignores some
    try:
        with end_requested() as asked:
            os.kill(os.getpid(), number)
            assert asked.wait(2.0)
    finally:
        signal.signal(number, before)


DRIVES = """
import sys
from pathlib import Path
from live.test_supervisor import Drive
from offpiste.live.supervisor import end_requested
from transport.routers import Network

with end_requested():
    drive = Drive(Path(sys.argv[1]), network=Network(sys.argv[2]))
    assert drive.drives(), drive.supervisor.look()
    while True:
        watchdog = drive.run(0.1)["watchdog"][1]
        print(drive.pid("control"), drive.pid("watchdog"), drive.session.folder, watchdog, flush=True)
"""


class Group:
    """A drive in a process group of its own, and the commands that the vehicle hears."""

    def __init__(self, folder):
        self.network, self.heard = Network(), []
        vehicle = self.network.session()
        vehicle.subscribe("/drive", lambda one: self._heard(vehicle.decode(one).drive.acceleration), msgtype=ACKERMANN)
        said, paths = folder / "said.txt", [folder.parent.parent, Path(__file__).parents[1], *sys.path]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, paths))}
        with said.open("w") as file:
            command = [sys.executable, "-c", DRIVES, str(folder), self.network.endpoint]
            self.process = subprocess.Popen(
                command, stdout=file, stderr=subprocess.STDOUT, start_new_session=True, env=environment
            )
        assert until(lambda: said.read_text().endswith(" ready\n"), 120), said.read_text()
        *_, control, watchdog, memory, _ = said.read_text().split()
        self.control, self.watchdog, self.memory = int(control), int(watchdog), Path(memory)

    def _heard(self, acceleration):
        self.heard.append((time.monotonic(), acceleration))

    def send(self, number):
        """Signal the whole group, and return the time."""
        os.killpg(self.process.pid, number)
        return time.monotonic()

    def since(self, moment):
        """Times of commands after a moment, which is the first of them, and whether each is a stop."""
        return [moment, *(at for at, _ in self.heard if at > moment)], [a < 0 for at, a in self.heard if at > moment]

    def close(self):
        with closing(self.network), suppress(ProcessLookupError):
            self.send(signal.SIGKILL)
        self.process.wait()


@pytest.fixture(scope="module")
def group(tmp_path_factory):
    with closing(Group(tmp_path_factory.mktemp("group"))) as group:
        yield group


def largest_gap(times):
    return max(later - at for at, later in pairwise(times))


def test_a_drive_in_the_background_is_not_stopped_by_its_terminal(group):
    for number in BACKGROUND:
        moment = group.send(number)
        time.sleep(0.6)
        times, stops = group.since(moment)
        assert largest_gap(times) < GAP
        assert not any(stops)


def test_the_watchdog_commands_the_stop_of_a_stopped_group(group):
    moment = group.send(signal.SIGSTOP)
    time.sleep(1.0)
    times, stops = group.since(moment + 0.05)  # earlier commands of control may arrive just after
    assert largest_gap(times) < GAP
    assert len(times) > 20
    assert all(stops)
    group.send(signal.SIGCONT)
    assert until(lambda: group.heard[-1][1] > 0, 20), "and it drives on"


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGABRT])  # the latter by systemd's watchdog
def test_the_watchdog_commands_the_stop_after_all_others_end(tmp_path, number):
    with closing(Group(tmp_path)) as group:
        moment = group.send(number)
        group.process.wait(5)
        assert until(lambda: not runs(group.watchdog), AFTER + 5)
        times, stops = group.since(moment)
        assert largest_gap(times) < GAP
        assert all(stops[stops.index(True) :])
        assert times[1 + stops.index(True)] - moment < GAP
        assert times[-1] - moment > 0.9, "the stop is sent for some time"
        assert not runs(group.control)
        assert not group.memory.exists()


def test_a_drive_with_every_process_killed_once(tmp_path, network):
    listener, log, parts, heard = network.session(), tmp_path / "drive.mcap", {}, []
    listener.subscribe("/drive", lambda one: heard.append((time.monotonic(), listener.decode(one).drive.acceleration)))
    robot = Robot(listener)
    settings = live_settings(tmp_path, network=network, actuators=True, drive=True, record=RecordSettings(log))

    def run(seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            robot.publish(time.time() - START / 1e9, 1.0)
            parts.update(live.look())
            time.sleep(0.02)

    def drives(seconds):
        seen = len(heard)
        return until(lambda: run(0.1) or any(acceleration > 0 for _, acceleration in heard[seen:]), seconds)

    with new_session(settings) as session:
        live = Supervisor(session, network.session())
        live.start()
        try:
            assert drives(120), parts
            run(0.5)
            live.report(parts)
            for name in ("receive", "map", "plan"):
                moment = time.monotonic()
                os.kill(live._processes[name].pid, signal.SIGKILL)
                run(0.3)
                times = [moment, *(at for at, _ in heard if at > moment)]
                assert largest_gap(times) < 0.2, f"commands flow without {name}"
                assert until(lambda: run(0.1) or (parts[name][1], live.restarts[name]) == ("ready", 1), 60), parts  # noqa: B023
                assert drives(20), (name, parts)
            assert parts["record"][1].startswith("records")
        finally:
            live.end()
    recorded = open_log(log)
    assert {"/odom", "/points", "/tf_static", "/drive", "/offpiste/mode"} <= set(recorded.topics)
    assert not recorded.warnings


def descendants(pid):
    found, border = [], [pid]
    while border:
        parent = border.pop()
        new = [int(child) for child in Path(f"/proc/{parent}/task/{parent}/children").read_text().split()]
        border += new
        found += new
    return found


@pytest.mark.parametrize(
    ("number", "router"),
    [(signal.SIGKILL, False), (signal.SIGKILL, True)]
    + [(number, False) for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT, signal.SIGTSTP)],
)
def test_all_processes_end_with_their_command(tmp_path, network, number, router):
    said, notified = tmp_path / "said.txt", str(tmp_path / "notify")
    endpoint = f"tcp/127.0.0.1:{free_port()}" if router else network.endpoint
    command = ["env", "--default-signal=HUP,INT", sys.executable, "-m", "offpiste", "live"]  # nohup ignores some
    command += [write_rig(tmp_path, actuators=True), "--run", RUN, "--endpoint", endpoint, *["--router"] * router]
    command += ["--course", str(write_course(tmp_path)), "--drive"]
    environment = os.environ | {"NOTIFY_SOCKET": notified}
    with said.open("w") as file, listening(notified) as heard:
        live = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, start_new_session=True, env=environment)
        assert until(lambda: "watchdog: ready" in said.read_text(), 60), said.read_text()
        children = descendants(live.pid)
        assert len(children) >= 5
        if number == signal.SIGKILL:
            live.kill()
            live.wait()
        else:
            os.killpg(live.pid, number)
            assert live.wait(30) == 0, said.read_text()
            assert "Traceback" not in said.read_text()
        assert until(lambda: not any(runs(pid) for pid in children), 30)
        assert not list(Path("/dev/shm").glob(f"offpiste-live-{live.pid}-*"))
    notices = [next(iter(state)) for _, state in heard]
    assert (notices[:2], notices[-1]) == (["READY", "WATCHDOG"], "WATCHDOG" if number == signal.SIGKILL else "STOPPING")
