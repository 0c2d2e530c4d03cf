"""What a service manager is told of a drive, on a socket of our own."""

import socket
import threading
import time
from contextlib import closing, contextmanager
from dataclasses import replace
from itertools import pairwise

import pytest

from live.made_up_robot import planner, small_settings, write_course, write_rig
from offpiste.live import supervisor
from offpiste.live.reception import CourseRequest
from offpiste.live.reports import OK, WARN
from offpiste.live.service_manager import ServiceManager
from offpiste.live.session import LiveSettings
from offpiste.transport.zenoh_transport import ZenohSettings
from transport.routers import network

__all__ = ["network"]


@contextmanager
def listening(address):
    """States that are sent to a socket, each with when it came, as they come."""
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
        ServiceManager().notify(READY=1, STATUS="two\nlines")
    assert [state for _, state in heard] == [{"READY": "1", "STATUS": "two lines"}]


def test_without_a_service_manager_nothing_is_sent(monkeypatch, caplog):
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    ServiceManager().notify(READY=1)
    assert not caplog.records


@pytest.mark.parametrize("bound", [True, False])
def test_a_socket_that_nobody_reads_does_not_hold_up_a_drive_and_is_said_once(tmp_path, monkeypatch, caplog, bound):
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    with closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as receiver:
        if bound:
            receiver.bind(str(tmp_path / "notify"))
        manager = ServiceManager()
        for _ in range(2000):
            manager.notify(WATCHDOG=1, STATUS="x" * 500)
    assert len(caplog.records) == 1
    assert "the service manager is not notified" in caplog.text


class Hangs:
    """A supervisor whose fifteenth look takes 2 s."""

    def __init__(self, *_, **__):
        self.looks = 0

    def start(self):
        pass

    def look(self):
        self.looks += 1
        time.sleep(2.0 if self.looks == 15 else 0.0)
        return {"control": (OK, "driving", {}), "plan": (OK, "ready", {}), "map": (WARN, "starts", {})}

    def say(self, parts):
        pass

    report = say

    def end(self):
        pass


def test_the_loop_that_looks_after_a_drive_keeps_systemds_watchdog_quiet_and_not_while_it_hangs(
    tmp_path, network, monkeypatch
):
    address = str(tmp_path / "notify")
    monkeypatch.setenv("NOTIFY_SOCKET", address)
    monkeypatch.setattr(supervisor, "Supervisor", Hangs)
    robot, course = ZenohSettings(endpoint=network.endpoint), CourseRequest(write_course(tmp_path))
    settings = LiveSettings(write_rig(tmp_path), "none", None, course, small_settings(), robot)
    with listening(address) as heard:
        supervisor.supervise(replace(settings, seconds=5.0), planner(), [])
    (_, first), *loop, (_, last) = heard
    assert first == {"READY": "1"}
    assert last["STOPPING"] == "1"
    assert all(state == {"WATCHDOG": "1", "STATUS": "control: driving; map: starts"} for _, state in loop)
    gaps = sorted(later - at for (at, _), (later, _) in pairwise(loop))
    assert gaps[-1] > 1.9
    assert gaps[-2] < 1.5
