"""Reports of one log and of several, for people and machines."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated import drive_log, rig
from test_draft_tables import POSE, written

from offpiste.cli import main
from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.render import render_text
from offpiste.inspection.survey import inspect_logs
from offpiste.logs import open_log
from offpiste.rig.rig import parse_rig


def test_people_read_the_worst_first_with_evidence_and_remedy() -> None:
    log = drive_log(seconds=60).change("steering", "command", np.negative)
    text = render_text(inspect_log(log, rig()))
    assert "1. warning  steer: is positive to the right" in text
    assert "fix: channels.steer.sign = -1" in text
    assert text.rstrip().endswith("usable for training (1 warning)")
    assert "50.0" in text  # a topic's rate


def test_a_log_that_a_cure_makes_usable_is_not_given_up() -> None:
    log = drive_log(seconds=60).change("odom", "x", lambda x: 100 * x).change("odom", "y", lambda y: 100 * y)
    inspection = inspect_log(log, rig())
    fatal = [finding for finding in inspection.findings if finding.severity == "fatal"]
    assert fatal
    assert all(finding.cures for finding in fatal)
    assert "NOT usable for training until cured as said above (" in render_text(inspection)
    uncured = replace(inspection, findings=(replace(fatal[0], cures=()),))
    assert "NOT usable for training (1 fatal)" in render_text(uncured)


def test_machines_get_plain_json() -> None:
    log = drive_log(seconds=60).change("steering", "command", np.negative)
    found = json.loads(json.dumps(inspect_log(log, rig()).as_dict(), allow_nan=False))
    assert found["usable"] is True
    assert found["findings"][0]["remedy"] == "channels.steer.sign = -1"
    assert found["summary"]["distance"] > 100
    assert {row["name"] for row in found["topics"]} == {"odom", "pedals", "steering", "wheels"}


GOOD = {**POSE, "throttle": ("pedal", 1.0), "delta": ("angle", 1.0)}
FLIPPED = {**GOOD, "delta": ("angle", -1.0)}


@pytest.fixture
def logs(tmp_path: Path) -> list[str]:
    """A good log, one whose steering is positive to the right, and one that is no table."""
    paths = [written(tmp_path / "good.csv", GOOD), written(tmp_path / "flipped.csv", FLIPPED), tmp_path / "broken.csv"]
    paths[-1].write_bytes(b"\xff\xfe no table" * 50)
    return [str(path) for path in paths]


@pytest.mark.parametrize("processes", [1, 2])
def test_each_log_has_what_inspect_says_of_it_alone(logs: list[str], processes: int) -> None:
    good = parse_rig(draft_rig(open_log(logs[0])), where="draft")
    survey = inspect_logs(logs, good, processes=processes)
    alone = [inspect_log(open_log(log), good, sensors=True).as_dict() for log in logs[:2]]
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


@pytest.mark.parametrize(
    "option", [["--write-rig", "x.toml"], ["--estimate-mountings"], ["--time", "t"], ["--namespace", "/a"]]
)
def test_what_takes_one_log_says_so(logs: list[str], option: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run("inspect", *logs, *option) == 1
    assert f"{option[0]} takes one log, not 3" in capsys.readouterr().err
