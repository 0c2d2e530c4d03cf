"""Parallel jobs, and the memory for them."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from log_messages import logged
from offpiste.core.errors import LogError
from offpiste.core.machine import free_memory, within_memory
from offpiste.core.parallel import run_all
from parallel_jobs import square, variable


@pytest.mark.parametrize("processes", [1, 2])
def test_all_jobs_are_done_even_if_one_fails(processes):
    with logged() as messages:
        results, failed = run_all(square, [3, -1, 4, 5], processes, "squares")
    assert results == ["9", "16", "25"]
    assert sorted(messages) == ["16", "25", "9", "failed: here: -1 is negative; give another"]
    assert [(type(error), str(error)) for error in failed] == [(LogError, "here: -1 is negative; give another")]


def test_workers_have_the_environment_of_now_and_not_of_when_the_first_of_them_began(monkeypatch):
    run_all(square, [1, 2], 2, "the server starts")
    monkeypatch.setenv("OFFPISTE_TRIED", "here")
    with logged() as messages:
        run_all(variable, ["OFFPISTE_TRIED", "OFFPISTE_TRIED"], 2, "variables")
    assert messages == ["OFFPISTE_TRIED=here"] * 2


def test_a_process_that_is_killed_is_reported_and_does_not_hang():
    failed = run_all(square, [13, 13], 2, "squares").failed
    assert len(failed) == 2
    assert all("killed" in str(error) and "--processes" in str(error) for error in failed)


def test_processes_end_when_their_parent_is_killed():
    imports = "from parallel_jobs import wait; from offpiste.core.parallel import run_all"
    code = f"{imports}; run_all(wait, [1, 2], 2, 'waiting', finished=print)"
    script = f"if __name__ == '__main__':\n    {code}"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(["tests", *sys.path])}
    parent = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True, env=environment)
    workers = [int(parent.stdout.readline()) for _ in range(2)]
    parent.kill()
    parent.wait()
    deadline = time.monotonic() + 20
    while any(_runs(pid) for pid in workers) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not any(_runs(pid) for pid in workers)


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    # A process that has ended stays as a zombie until its new parent reaps it.
    status = Path(f"/proc/{pid}/stat")
    return not status.exists() or status.read_text().split()[2] != "Z"


def machine(root: Path, **files: str) -> Path:
    """Files of /proc and /sys of a machine with 8 GiB available."""
    files = {"proc/meminfo": "MemTotal: 9999999 kB\nMemAvailable: 8388608 kB\n"} | files
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    return root


@pytest.mark.parametrize(
    ("group", "place", "names"),
    [("0::/jobs/one", "jobs", "max current inactive_file"), ("0::/", "", "max current inactive_file"),
     ("4:memory:/jobs/one", "memory/jobs", "limit_in_bytes usage_in_bytes total_inactive_file")],
)  # fmt: skip
def test_free_memory_is_no_more_than_the_container_has_left(tmp_path, group, place, names):
    limit, used, cached = names.split()
    files = {limit: f"{4 << 30}\n", used: f"{3 << 30}\n", "stat": f"anon 5\n{cached} {1 << 30}\n"}
    inside = {f"sys/fs/cgroup/{place}/memory.{name}": text for name, text in files.items()}
    assert free_memory(machine(tmp_path, **{"proc/self/cgroup": f"1:name=systemd:/\n{group}\n"} | inside)) == 2 << 30
    (tmp_path / "sys/fs/cgroup" / place / f"memory.{limit}").write_text("max\n")
    assert free_memory(tmp_path) == 8 << 30


def test_fewer_processes_are_started_where_memory_is_short(monkeypatch):
    monkeypatch.setattr("offpiste.core.machine.free_memory", lambda: int(4.5e9))
    with logged() as messages:
        assert [within_memory(wanted, 1.3e9) for wanted in (1, 3, 16)] == [1, 3, 3]
    assert messages == ["3 of 16 processes at a time: 4.5 GB of memory are free, and each takes 1.3 GB"]
    monkeypatch.setattr("offpiste.core.machine.free_memory", lambda: 0)
    assert within_memory(4, 1.3e9) == 1
