"""Signals to all processes of a drive at once."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from offpiste.live.parts import entry
from offpiste.live.supervisor import asked_to_end

BEATS = """
import multiprocessing, sys, time
from pathlib import Path
from offpiste.live.parts import entry

def beat(name, session, cameras):
    while True:
        with Path(sys.argv[1], name).open("a") as file:
            file.write("x")
        time.sleep(0.02)

entry._run = beat
context = multiprocessing.get_context("fork")
for name in ("watchdog", "control"):
    context.Process(target=entry.run_part, args=(name, None, False)).start()
time.sleep(60)
"""


def beats(folder: Path, name: str) -> int:
    path = folder / name
    return path.stat().st_size if path.exists() else 0


def wait_for(what, seconds: float = 30.0) -> None:
    until = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < until
        time.sleep(0.02)


def test_a_group_that_is_stopped_leaves_the_watchdog_running_and_no_orphan(tmp_path):
    drive = subprocess.Popen([sys.executable, "-c", BEATS, str(tmp_path)], start_new_session=True)
    try:
        wait_for(lambda: beats(tmp_path, "watchdog") and beats(tmp_path, "control"))
        os.killpg(drive.pid, signal.SIGSTOP)
        time.sleep(0.2)
        stopped, before = beats(tmp_path, "control"), beats(tmp_path, "watchdog")
        time.sleep(0.5)
        assert beats(tmp_path, "control") == stopped
        assert beats(tmp_path, "watchdog") > before
    finally:
        os.killpg(drive.pid, signal.SIGKILL)
        drive.wait()

    def ended() -> bool:
        count = beats(tmp_path, "watchdog")
        time.sleep(0.3)
        return beats(tmp_path, "watchdog") == count

    wait_for(ended, entry.AFTER + 20.0)


@pytest.mark.parametrize("number", [signal.SIGQUIT, signal.SIGTSTP, signal.SIGTERM])
def test_a_drive_ends_by_any_signal_of_a_terminal(number):
    with asked_to_end() as asked:
        os.kill(os.getpid(), number)
        assert asked.wait(2.0)
