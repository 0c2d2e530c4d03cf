import json
from pathlib import Path

from offpiste.experiments.demo import run_demo


def test_the_demo_walks_the_whole_path_and_can_be_repeated(tmp_path: Path) -> None:
    said: list[object] = []
    run_demo(tmp_path, seconds=120.0, epochs=1, seed=0, tell=said.append)
    report = tmp_path / "report" / "report.html"
    written = report.stat().st_mtime_ns
    models = {row["model"] for row in json.loads((tmp_path / "report" / "metrics.json").read_text())["results"]}
    assert models == {"b", "parametric", "ctrv", "kinematic"}
    assert any("generated from a bicycle with known constants" in str(line) for line in said)

    trained = (tmp_path / "b" / "model.safetensors").read_bytes()
    run_demo(tmp_path, seconds=120.0, epochs=1, seed=0, tell=said.append)
    assert report.stat().st_mtime_ns > written
    assert (tmp_path / "b" / "model.safetensors").read_bytes() == trained
