"""`python -m experiments.closed_loop_table` without anything to drive, with a wrong run, and interrupted."""

from pathlib import Path

import pytest

from experiments.closed_loop_table import __main__ as command
from offpiste.core.errors import OffpisteError
from offpiste.runtime.planner import Planner
from runtime.stream import parametric


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"runs": ()}, "--runs: no run is given"),
        ({"courses": 0}, "--courses: 0 courses"),
        ({"courses": -3, "faults": True}, "--courses: -3 courses"),
    ],
)
def test_nothing_to_drive_is_refused(given, message, tmp_path, monkeypatch):
    monkeypatch.setattr(command, "load_planner", lambda run, pca: Planner("b", run, parametric()))
    with pytest.raises(OffpisteError, match=message):
        command.ClosedLoop(**{"runs": (Path("b"),), "out": tmp_path / "out"} | given).run()
    assert not (tmp_path / "out").exists()


def test_a_wrong_run_ends_in_one_line(tmp_path):
    with pytest.raises(SystemExit) as ended:
        command.run(command.ClosedLoop, ["--runs", str(tmp_path / "none"), "--out", str(tmp_path / "out")])
    assert "none: no such folder" in ended.value.code
    assert "\n" not in ended.value.code
