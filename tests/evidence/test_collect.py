"""Evidence from made-up drives: the report, what is used again, and bad input in one line."""

import json
import re
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from feature_datasets import PARTS, dataset_with_features
from offpiste.cli import main
from offpiste.core.errors import OffpisteError, RunError
from offpiste.evidence.collect import EvidenceSettings, collect
from offpiste.reproduction.settings import Size
from offpiste.training.config import TrainConfig

TINY = Size("tiny", (30.0, 15.0, 15.0), stride=80, train=TrainConfig(epochs=1, bicycle_epochs=1, batch=64, stride=80))


def settings_in(folder: Path) -> EvidenceSettings:
    """Evidence whose features are there already."""
    (folder / "filterbank").mkdir()
    split = dataset_with_features(folder / "filterbank" / "dataset.zarr", rows=1800, yaw_rate=0.05).split
    (folder / "filterbank" / "pca.safetensors").write_bytes(b"")
    logs = tuple(str(folder / f"circle-{k}.mcap") for k in range(len(PARTS)))
    for log in logs:
        Path(log).touch()
    return EvidenceSettings(folder, TINY, logs=logs, rig="proving_ground", split=split.text, processes=1)


def test_one_report_holds_comparisons_rates_and_controls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = settings_in(tmp_path)
    inspected = []
    monkeypatch.setattr("offpiste.evidence.collect.inspect_drives", lambda drives, rig: inspected.append(rig))
    monkeypatch.setattr("offpiste.evidence.collect.rig_text", lambda rig: "mass = 900.0  # GUESSED")
    page = collect(settings)
    text = page.read_text("utf-8")
    headings = re.findall(r"<h2[^>]*>(.*?)</h2>", text)
    for wanted in (
        "Against b",
        "What has to hold",
        "Trainings",
        "Models without networks",
        "What to doubt",
        "Valid rates",
        "Features of other ground",
        "recorded places give away",
    ):
        assert any(wanted in heading for heading in headings), (wanted, headings)
    assert str(tmp_path) not in text, "no path of the user's machine"
    found = json.loads((tmp_path / "evidence.json").read_text("utf-8"))
    numbers = found["backbones"]["filterbank"]
    assert {gain["model"] for gain in numbers["shift"]} <= {"cf", "dc", "df"}
    assert [(gain["model"], gain["baseline"]) for gain in numbers["baselines"]] == [
        ("b", "parametric"),
        ("parametric", "kinematic"),
    ]
    assert {line[0] for line in numbers["kept_epochs"]} == {"b", "b-hindsight", "cf", "dc", "df"}
    assert found["doubts"][0] == "the rig has guesses that nobody has confirmed: mass"
    assert {"vehicle", "sensors", "driving", "command"} <= set(found["facts"])
    assert {gain["model"] for gain in numbers["leak"]} == {"b", "cf", "dc", "df"}
    assert numbers["coverage"]["valid"]
    assert str(tmp_path) not in json.dumps(found)
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.safetensors")}
    collect(settings)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.safetensors")} == kept
    assert inspected == ["proving_ground"], "once, before the folder is begun"
    with pytest.raises(RunError, match=r"other settings \(split\)"):
        collect(replace(settings, split="blocks:0.6,0.2,0.2"))


def test_a_terminated_run_ends_as_an_interrupted_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr("offpiste.evidence.collect.collect", lambda settings: signal.raise_signal(signal.SIGTERM))
    with pytest.raises(SystemExit) as ended:
        main(["evidence"])
    assert ended.value.code == 1
    assert capsys.readouterr().err == "offpiste: interrupted; what was finished is kept; resume: offpiste evidence\n"
    assert signal.getsignal(signal.SIGTERM) == before


def test_bad_input_ends_in_a_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(OffpisteError, match="without their rig"):
        collect(EvidenceSettings(tmp_path / "out", TINY, logs=("drive.mcap",)))
    with pytest.raises(OffpisteError, match="without logs"):
        collect(EvidenceSettings(tmp_path / "out", TINY, rig="proving_ground"))
    log = str(tmp_path / "drive.mcap")
    Path(log).touch()
    cases = {
        (log, "--rig", "proving_ground", "--weights", "no-such"): "no backbone 'no-such'",
        (log, "--rig", "proving_ground", "--split", "some"): "not a split",
        (log, "--rig", "nowhere"): "nowhere",
    }
    for words, why in cases.items():
        with pytest.raises(SystemExit):
            main(["evidence", *words, "--out", str(tmp_path / "out")])
        assert why in capsys.readouterr().err
    assert not (tmp_path / "out").exists(), "a folder that cannot be filled is not begun"
