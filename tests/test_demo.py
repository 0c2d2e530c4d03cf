import json
from pathlib import Path

import pytest

from log_messages import logged
from offpiste.conventions import FEATURE_SETS
from offpiste.demo import DemoSettings, run_demo
from offpiste.errors import RunError

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


def test_the_demo_walks_the_whole_path_and_can_be_repeated(tmp_path: Path) -> None:
    with logged() as said:
        run_demo(tmp_path, SMALL, processes=1)
    report = tmp_path / "report"
    rows = json.loads((report / "metrics.json").read_text())["results"]
    assert {row["model"] for row in rows} == {"b", "dc", "ctrv", "kinematic"}
    readings = {("recorded", name) for name in FEATURE_SETS} | {("map", None)}
    assert {(row["lookup"], row["feature_set"]) for row in rows if row["model"] == "dc"} == readings
    assert (report / "distance.png").read_bytes().startswith(b"\x89PNG")
    assert f"picture: {report / 'distance.png'}" in said
    assert any("no real vehicle" in str(line) for line in said)
    assert any("too little for an interval" in str(line) for line in said), "one drive of 8 s says nothing"

    assert json.loads((tmp_path / "course" / "result.json").read_text())["planner"] == "dc"
    assert said[-1] == f"picture: {tmp_path / 'course' / 'drive.png'}"

    kept = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.safetensors")}
    kept |= {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.mcap")}
    with logged() as again:
        run_demo(tmp_path, SMALL, processes=1)
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert again[-2:] == said[-2:]

    with pytest.raises(RunError, match=r"demo\.seconds"):
        run_demo(tmp_path, DemoSettings())
