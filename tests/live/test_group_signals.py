"""Signals to all processes of a drive at once: the real watchdog commands the stop."""

import os
import signal
import subprocess
import sys
import time
from contextlib import closing, suppress
from itertools import pairwise
from pathlib import Path

import pytest

from live.made_up_robot import ACKERMANN
from live.test_all_processes import runs
from offpiste.core.signals import BACKGROUND, ENDING
from offpiste.live.part import AFTER
from offpiste.live.supervisor import asked_to_end
from offpiste.transport.zenoh_transport import ZenohSettings, ZenohTransport
from transport.routers import Network, until

DRIVES = """
import sys
from pathlib import Path
from live.test_supervisor import Drive
from live.test_group_signals import Elsewhere
from offpiste.live.supervisor import asked_to_end

with asked_to_end():
    drive = Drive(Path(sys.argv[1]), network=Elsewhere(sys.argv[2]))
    assert drive.drives(), drive.supervisor.look()
    while True:
        watchdog = drive.run(0.1)["watchdog"][1]
        print(drive.pid("control"), drive.pid("watchdog"), drive.session.folder, watchdog, flush=True)
"""
GAP = 0.3
"""The watchdog's silence of 0.1 s, and what a busy machine adds [s]."""


class Elsewhere:
    """A network whose router is in another process."""

    def __init__(self, endpoint):
        self.endpoint = endpoint

    def session(self):
        return ZenohTransport(ZenohSettings(endpoint=self.endpoint))


class Group:
    """A drive in a process group of its own, and what the vehicle hears of it."""

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
        """Signal the whole group; when."""
        os.killpg(self.process.pid, number)
        return time.monotonic()

    def since(self, moment):
        """Times of commands, and whether each is a stop; the moment is the first time."""
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


@pytest.mark.parametrize("number", BACKGROUND)
def test_a_drive_in_the_background_is_not_stopped_by_its_terminal(group, number):
    moment = group.send(number)
    time.sleep(0.6)
    times, stops = group.since(moment)
    assert largest_gap(times) < GAP
    assert not any(stops)


def test_a_group_that_is_stopped_leaves_the_watchdog_to_command_the_stop(group):
    moment = group.send(signal.SIGSTOP)
    time.sleep(1.0)
    times, stops = group.since(moment + 0.05)  # what control sent before may arrive just after
    assert largest_gap(times) < GAP
    assert len(times) > 20
    assert all(stops)
    group.send(signal.SIGCONT)
    assert until(lambda: group.heard[-1][1] > 0, 20), "and it drives on"


def is_stopped_by_orphans(group, number):
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
    return True


def test_where_all_others_are_killed_the_watchdog_commands_the_stop(group):
    assert is_stopped_by_orphans(group, signal.SIGKILL)  # the last test that uses this group


def test_the_signal_of_systemds_watchdog_ends_the_command_and_its_processes_stop_the_vehicle(tmp_path):
    with closing(Group(tmp_path)) as group:
        assert is_stopped_by_orphans(group, signal.SIGABRT)


@pytest.mark.parametrize("number", ENDING)
def test_a_drive_ends_by_any_signal_of_a_terminal(number):
    before = signal.signal(number, signal.SIG_DFL)  # also where the tests run under nohup
    try:
        with asked_to_end() as asked:
            os.kill(os.getpid(), number)
            assert asked.wait(2.0)
    finally:
        signal.signal(number, before)
