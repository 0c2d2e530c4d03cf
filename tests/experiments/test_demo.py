import json
from pathlib import Path

from offpiste.experiments.demo import DemoSettings, run_demo

SMALL = DemoSettings(seconds=30.0, epochs=1, size=120.0, resolution=0.5)


def test_the_demo_walks_the_whole_path_and_can_be_repeated(tmp_path: Path) -> None:
    said: list[object] = []
    run_demo(tmp_path, SMALL, tell=said.append)
    report = tmp_path / "report" / "report.html"
    written = report.stat().st_mtime_ns
    rows = json.loads((tmp_path / "report" / "metrics.json").read_text())["results"]
    assert {row["model"] for row in rows} == {"df", "b", "parametric", "ctrv", "kinematic"}
    assert {row["lookup"] for row in rows if row["model"] == "df"} == {"recorded", "map"}
    assert any("no real vehicle" in str(line) for line in said)
    assert any("oracle" in str(line) for line in said)

    trained = (tmp_path / "b" / "model.safetensors").read_bytes()
    logs = {log: log.stat().st_mtime_ns for log in (tmp_path / "logs").iterdir()}
    run_demo(tmp_path, SMALL, tell=said.append)
    assert report.stat().st_mtime_ns > written
    assert (tmp_path / "b" / "model.safetensors").read_bytes() == trained
    assert {log: log.stat().st_mtime_ns for log in (tmp_path / "logs").iterdir()} == logs
