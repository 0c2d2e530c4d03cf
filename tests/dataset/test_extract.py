"""Extraction of drives: warnings, refusal of unusable logs, findings kept with a drive, and snapshots of the map."""

import logging
from copy import copy
from pathlib import Path

import numpy as np
import pytest
import simulated
import zarr

from cluster import content
from factories import circle_rows, small_rig, stored_dataset
from feature_datasets import random_pca
from object_stores import s3_server
from offpiste.core.checksums import write_checksums
from offpiste.core.errors import DatasetError
from offpiste.core.object_store import opened
from offpiste.core.parallel import Outcome
from offpiste.dataset import extract as extraction
from offpiste.dataset import store
from offpiste.dataset.extract import ExtractSettings, Job, pca_overlap
from offpiste.dataset.log_findings import LogFinding, UnusableLog, warning_line
from offpiste.dataset.splits import parse_split, write_drives
from offpiste.inspection.extract import extract, findings_on
from offpiste.logs.log import Log
from offpiste.perception.backbones import open_backbone
from offpiste.perception.feature_extractor import FeatureExtractor
from offpiste.rig.rig import load_rig
from shared_drives import blind_drives

SPLIT = parse_split("blocks:0.5,0.25,0.25")
STEER = LogFinding("warning", "steer", "is positive to the right", "r = -0.9", "channels.steer.sign = -1")
YAW = LogFinding("fatal", "yaw", "does not follow the course", "agrees to 0.1", 'channels.yaw.unit = "deg"')


@pytest.mark.parametrize(
    ("split", "logs", "warning"),
    [
        ("blocks:0.7,0.1,0.2", ["one"], None),
        ("blocks:1,0,0", ["one"], "leaves nothing for validation and test"),
        ("drives:split.txt", ["one", "two", "three"], "split.txt names 'tow', but"),
        ("drives:split.txt", ["one", "tow", "three"], None),
    ],
)
def test_warnings_before_extraction(split, logs, warning, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(extraction, "run_all", lambda *arguments, **settings: Outcome([], []))
    monkeypatch.chdir(tmp_path)
    Path("split.txt").write_text("one train\ntow test\nthree validation\n")
    with caplog.at_level(logging.WARNING, "offpiste"), pytest.raises(DatasetError, match="not a dataset"):
        extract([f"{name}.csv" for name in logs], small_rig(), tmp_path / "d.zarr", split=split)
    assert len(caplog.records) == (warning is not None)
    assert warning is None or warning in caplog.text


def in_memory(monkeypatch: pytest.MonkeyPatch, logs: dict[str, Log]) -> list[Path]:
    """Replace files by logs in memory."""

    def open_log(path: Path, clock: object) -> Log:
        logs[path.stem].path = path
        return logs[path.stem]

    monkeypatch.setattr(extraction, "open_log", open_log)
    return [Path(f"{name}.csv") for name in logs]


def in_kilometres(log: simulated.MemoryLog) -> simulated.MemoryLog:
    """Return a log with a fatal fault: positions in kilometres."""
    return log.change("odom", "x", lambda x: 1e-3 * x).change("odom", "y", lambda y: 1e-3 * y)


def test_unusable_logs_are_refused_and_others_extracted(tmp_path, monkeypatch, caplog) -> None:
    log = simulated.drive_log(60.0)
    logs = in_memory(monkeypatch, {"one": in_kilometres(log), "two": in_kilometres(log), "good": log})
    with pytest.raises(UnusableLog, match=r"one\.csv: unusable: position:.*--force"):
        extract([logs[0], logs[2]], simulated.rig(), tmp_path / "d.zarr")
    assert [drive.name for drive in store.open_dataset(tmp_path / "d.zarr").drives] == ["good"]
    with (
        caplog.at_level(logging.ERROR, "offpiste"),
        pytest.raises(DatasetError, match=r"2 logs .*leave out 'one\.csv', 'two\.csv'"),
    ):
        extract(logs, simulated.rig(), tmp_path / "d.zarr")
    lines = [record.getMessage() for record in caplog.records if record.levelname == "ERROR"]
    assert [line.split(": ")[:2] for line in lines] == [["one.csv", "position"], ["two.csv", "position"]]
    with caplog.at_level(logging.INFO, "offpiste"):
        dataset = extract(logs[:1], simulated.rig(), tmp_path / "d.zarr", force=True)
    assert "fatal" in [finding.severity for finding in dataset.drives[1].findings]
    assert "  FATAL, extracted by --force: position: " in caplog.text


def test_logs_in_an_object_store_make_the_dataset_that_is_made_here(tmp_path) -> None:
    logs, rig = blind_drives(tmp_path, 2), load_rig("proving_ground")
    datasets = [tmp_path / "here.zarr", tmp_path / "there.zarr"]
    extract(logs, rig, datasets[0])
    with s3_server("bucket"):
        with opened("s3://bucket/logs") as (files, root):
            for log in logs:
                files.put_file(str(log), f"{root}/{log.name}")
        extract(["s3://bucket/logs/*.mcap"], rig, datasets[1], processes=2)
    assert content(datasets[0]) == content(datasets[1])


def test_a_flipped_sign_is_a_warning_with_its_fix() -> None:
    log = simulated.drive_log(60.0)
    assert findings_on(log, simulated.rig()) == ()
    flipped = log.change("steering", "command", np.negative).change("steering", "angle", np.negative)
    found = findings_on(flipped, simulated.rig())
    assert {finding.severity for finding in found} == {"warning"}
    assert any("sign = -1" in finding.line for finding in found)


def test_findings_are_stored_with_the_drive(tmp_path) -> None:
    path, rows = tmp_path / "data.zarr", circle_rows(2400)
    for name, found in (("a", (STEER,)), ("b", (STEER, YAW)), ("c", ())):
        dataset = stored_dataset(path, {name: rows}, SPLIT, findings=found)
    assert [drive.findings for drive in dataset.drives] == [(STEER,), (STEER, YAW), ()]
    first, second = "steer is positive to the right (drive a and 1 more)", "yaw does not follow the course (drive b)"
    assert dataset.findings == (first, second)
    assert f"has 2 warnings of `inspect`: {first}; {second}; run" in str(warning_line(dataset.findings))
    assert f"  warning: {STEER.line}" in extraction.described(dataset.drives[0], SPLIT)
    group = zarr.open_group(path / "a", mode="r+")
    group.attrs["findings"] = {"schema": 1, "found": [{"severity": "mild"}]}
    write_checksums(path / "a", (path / "a").rglob("zarr.json"))
    with pytest.raises(DatasetError, match=r"drive 'a' cannot be read .*mild"):
        store.open_dataset(path)


def test_an_unusable_log_comes_back_from_another_process() -> None:
    error = copy(UnusableLog([YAW, YAW], Path("a.csv")))
    assert error.findings == (YAW, YAW)
    assert str(error) == str(UnusableLog([YAW, YAW], Path("a.csv")))
    assert "(and 1 more)" in str(error)


@pytest.mark.parametrize(("then", "now", "seen"), [("train", "test", True), ("test", "test", False)])
def test_a_pca_fitted_on_test_rows_is_noticed(tmp_path, then, now, seen):
    text = write_drives(tmp_path / "parts.txt", [("drive", now)])
    about = {"logs": ["drive"], "split": text, "split_drives": [["drive", then]]}
    backbone = open_backbone("filterbank")
    extractor = FeatureExtractor(backbone, random_pca(backbone, fitted_on=about))
    job = Job(Path("drive.mcap"), "drive", small_rig(), Path("d.zarr"), ExtractSettings(parse_split(text)))
    notes = pca_overlap(extractor, circle_rows(6000), job)
    assert [note.startswith("warning: the PCA may have seen 120 s of") for note in notes] == [True] * seen
