"""Jobs in several processes: all are done, whatever happens to some."""

import os
import pickle
import subprocess
import sys
import time
from pathlib import Path

import pytest

from log_messages import logged
from offpiste.errors import LogError, OffpisteError
from offpiste.parallel import run_all
from parallel_jobs import square, variable


@pytest.mark.parametrize("processes", [1, 2])
def test_all_jobs_are_done_even_if_one_fails(processes):
    with logged() as messages:
        failed = run_all(square, [3, -1, 4, 5], processes, "squares")
    assert sorted(messages) == ["16", "25", "9", "failed: here: -1 is negative; give another"]
    assert [(type(error), str(error)) for error in failed] == [(LogError, "here: -1 is negative; give another")]


def test_workers_have_the_environment_of_now_and_not_of_when_the_first_of_them_began(monkeypatch):
    run_all(square, [1, 2], 2, "the server starts")
    monkeypatch.setenv("OFFPISTE_TRIED", "here")
    with logged() as messages:
        run_all(variable, ["OFFPISTE_TRIED", "OFFPISTE_TRIED"], 2, "variables")
    assert messages == ["OFFPISTE_TRIED=here"] * 2


def test_a_single_job_leaves_its_failure_to_the_caller():
    with logged() as messages:
        assert len(run_all(square, [-1], 4, "squares")) == 1
    assert not messages


def test_a_process_that_is_killed_is_reported_and_does_not_hang():
    failed = run_all(square, [13, 13], 2, "squares")
    assert len(failed) == 2
    assert all("killed" in str(error) and "--processes" in str(error) for error in failed)


def test_errors_come_back_from_other_processes_as_they_were():
    error = pickle.loads(pickle.dumps(LogError("broken", where="a.mcap", how="fix it")))  # noqa: S301
    assert type(error) is LogError
    assert str(error) == "a.mcap: broken; fix it"
    assert str(pickle.loads(pickle.dumps(OffpisteError("x")))) == "x"  # noqa: S301


def test_work_that_processes_could_not_import_is_refused_before_any_starts(tmp_path: Path) -> None:
    package = tmp_path / "study"
    package.mkdir()
    (package / "__init__.py").touch()
    code = "from offpiste.parallel import run_all\ndef work(job, report): return ''\nrun_all(work, [1, 2], 2, '')"
    (package / "__main__.py").write_text(code)
    ran = subprocess.run([sys.executable, "-m", "study"], cwd=tmp_path, capture_output=True, text=True)
    assert "ValueError: put work in a module of its own" in ran.stderr


def test_processes_end_when_their_parent_is_killed():
    imports = "from parallel_jobs import wait; from offpiste.parallel import run_all"
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
