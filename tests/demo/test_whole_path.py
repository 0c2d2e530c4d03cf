"""The demo of all stages runs and resumes."""

import json
from pathlib import Path

import pytest

from log_messages import logged
from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.errors import RunError
from offpiste.demo.whole_path import DemoSettings, run_demo

SMALL = DemoSettings(
    seconds=8.0,
    epochs=1,
    size=80.0,
    resolution=0.5,
    images=4,
    snapshot_seconds=1.0,
    parts=("train", "validation", "test"),
    course_seconds=1.0,
)


def test_the_demo_runs_the_whole_path_and_can_be_repeated(tmp_path: Path) -> None:
    with logged() as messages:
        run_demo(tmp_path, SMALL, processes=1)
    report = tmp_path / "report"
    rows = json.loads((report / "metrics.json").read_text())["results"]
    assert {row["model"] for row in rows} == {"b", "dc", "ctrv", "kinematic"}
    readings = {("recorded", name) for name in FEATURE_SETS} | {("map", None)}
    assert {(row["lookup"], row["feature_set"]) for row in rows if row["model"] == "dc"} == readings
    assert any("visual minus blind" in str(line) and "no interval" in str(line) for line in messages), "8 s are too few"

    assert json.loads((tmp_path / "course" / "result.json").read_text())["planner"] == "dc"
    assert messages[-1] == f"picture: {tmp_path / 'course' / 'drive.png'}"

    kept = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.safetensors")}
    kept |= {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.mcap")}
    with logged() as again:
        run_demo(tmp_path, SMALL, processes=1)
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert again[-2:] == messages[-2:]

    with pytest.raises(RunError, match=r"demo\.seconds"):
        run_demo(tmp_path, DemoSettings())
