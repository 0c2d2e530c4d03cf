"""The fault experiment: its link holds up what it forwards, and its table counts what came of each fault."""

import socket
import threading
import time
from types import SimpleNamespace

import numpy as np

from experiments.live_faults.__main__ import Outcome, tabulate
from experiments.live_faults.faults import faults
from experiments.live_faults.network import Link


def test_a_link_delivers_late_what_came_while_it_was_stalled():
    with socket.create_server(("127.0.0.1", 0)) as server:
        link = Link(SimpleNamespace(port=server.getsockname()[1]))
        with socket.create_connection(("127.0.0.1", link.port)) as here:
            there, _ = server.accept()
            here.sendall(b"now")
            assert there.recv(10) == b"now"
            stalled = threading.Thread(target=link.stall, args=(0.4,))
            began = time.monotonic()
            stalled.start()
            time.sleep(0.05)
            here.sendall(b"late")
            assert there.recv(10) == b"late"
            assert time.monotonic() - began > 0.39
            stalled.join()
            there.close()
        link.close()


def test_every_fault_of_a_process_is_there_and_names_are_its_own():
    names = [fault.name for fault in faults()]
    assert len(set(names)) == len(names) >= 20
    for part in ("control", "receive", "map", "plan", "watchdog", "record"):
        assert f"SIGKILL of {part}" in names


def test_the_table_counts_stops_names_and_logs(tmp_path):
    log = tmp_path / "drive.mcap"
    log.write_bytes(b"none")
    outcomes = [
        Outcome("a", 0, 0.1, "control: restarts = 1", True, "driving", str(log)),
        Outcome("a", 1, 0.3, "", False, "stopping", str(log)),
        Outcome("b", 0, np.nan, "x", True, "driving", str(log)),
    ]
    tabulate(outcomes, tmp_path)
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]] for line in (tmp_path / "table.md").read_text().splitlines()
    ]
    assert rows[2] == ["a", "2", "", "0.20 / 0.30", "0/2", "1/2", "1/2", "0/2"]
    assert rows[3] == ["b", "1", "", "", "1/1", "1/1", "1/1", "0/1"]
