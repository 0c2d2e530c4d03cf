"""Several logs inspected at once: a row each, whatever fails in one of them, in this process or in others."""

import json
from pathlib import Path

import pytest
from test_draft_tables import POSE, written

from offpiste.cli import main
from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.survey import inspect_logs
from offpiste.logs import open_log
from offpiste.rig.rig import Rig, parse_rig

GOOD = {**POSE, "throttle": ("pedal", 1.0), "delta": ("angle", 1.0)}
FLIPPED = {**GOOD, "delta": ("angle", -1.0)}


@pytest.fixture
def logs(tmp_path: Path) -> list[str]:
    """A good log, one whose steering is positive to the right, and one that is no table."""
    paths = [written(tmp_path / "good.csv", GOOD), written(tmp_path / "flipped.csv", FLIPPED), tmp_path / "broken.csv"]
    paths[-1].write_bytes(b"\xff\xfe no table" * 50)
    return [str(path) for path in paths]


@pytest.fixture
def rig(logs: list[str]) -> Rig:
    """The rig of the good log."""
    return parse_rig(draft_rig(open_log(logs[0])), where="draft")


@pytest.mark.parametrize("processes", [1, 2])
def test_each_log_has_what_inspect_says_of_it_alone(logs: list[str], rig: Rig, processes: int) -> None:
    survey = inspect_logs(logs, rig, processes=processes)
    alone = [inspect_log(open_log(log), rig, sensors=True).as_dict() for log in logs[:2]]
    assert [one["log"] for one in survey.inspections] == logs[:2]
    assert list(survey.inspections) == alone
    assert [Path(error.where).name for error in survey.failed] == ["broken.csv"]
    assert not survey.usable


def run(*words: str) -> int:
    with pytest.raises(SystemExit) as exit_:
        main(list(words))
    return int(exit_.value.code or 0)


def test_the_table_has_a_row_a_log(logs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "my.toml").write_text(draft_rig(open_log(logs[0])), "utf-8")
    assert run("inspect", *logs, "--rig", str(tmp_path / "my.toml"), "--processes", "1") == 1
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith(("good", "flipped", "broken"))]
    assert [row.split()[0] for row in rows] == ["good", "flipped", "broken.csv"]
    assert "not usable" not in rows[0]
    assert "is positive to the right" in rows[1]
    assert "not readable" in rows[2]


def test_json_of_several_logs(logs: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run("inspect", *logs[:2], "--json", "--processes", "1") == 0
    said = json.loads(capsys.readouterr().out)
    assert [one["log"] for one in said["logs"]] == logs[:2]
    assert said["usable"]


@pytest.mark.parametrize("option", [["--write-rig", "x.toml"], ["--estimate-mountings"]])
def test_what_takes_one_log_says_so(logs: list[str], option: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run("inspect", *logs, *option) == 1
    assert f"{option[0]} takes one log, not 3" in capsys.readouterr().err
