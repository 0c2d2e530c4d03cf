"""Findings of `inspect` in a dataset: fatal ones stop a log, warnings are kept with the drive, one line says them."""

import logging
from copy import copy
from pathlib import Path

import numpy as np
import pytest
import simulated
import zarr

from factories import circle_rows, small_rig
from offpiste.core.checksums import write_checksums
from offpiste.core.errors import DatasetError
from offpiste.dataset import extract, store
from offpiste.dataset.extract import make_dataset
from offpiste.dataset.log_findings import LogFinding, UnusableLog, findings_by_drive, findings_on, warning_line
from offpiste.dataset.splits import parse_split
from offpiste.logs.log import Log

SPLIT = parse_split("blocks:0.5,0.25,0.25")
STEER = LogFinding("warning", "steer", "is positive to the right", "r = -0.9", "channels.steer.sign = -1")
YAW = LogFinding("fatal", "yaw", "does not follow the course", "agrees to 0.1", 'channels.yaw.unit = "deg"')


def test_a_log_in_order_has_none_and_a_flipped_sign_is_a_warning_with_its_fix() -> None:
    log = simulated.drive_log(60.0)
    assert findings_on(log, simulated.rig()) == ()
    flipped = log.change("steering", "command", np.negative).change("steering", "angle", np.negative)
    found = findings_on(flipped, simulated.rig())
    assert found
    assert all(finding.severity == "warning" for finding in found)
    assert any("sign = -1" in finding.line for finding in found)


def opened(monkeypatch: pytest.MonkeyPatch, logs: dict[str, Log]) -> list[Path]:
    """Logs in memory, in the place of files."""

    def open_log(path: Path, clock: object) -> Log:
        logs[path.stem].path = path
        return logs[path.stem]

    monkeypatch.setattr(extract, "open_log", open_log)
    return [Path(f"{name}.csv") for name in logs]


def fast(log: simulated.MemoryLog) -> simulated.MemoryLog:
    """Positions in millimetres: fatal."""
    return log.change("odom", "x", lambda x: 1000 * x).change("odom", "y", lambda y: 1000 * y)


def test_a_fatal_finding_stops_the_log_and_no_other(tmp_path, monkeypatch, caplog) -> None:
    log = simulated.drive_log(60.0)
    logs = opened(monkeypatch, {"bad": fast(log), "good": log})
    with (
        caplog.at_level(logging.INFO, "offpiste"),
        pytest.raises(UnusableLog, match=r"bad\.csv: unusable: position:.*--force"),
    ):
        make_dataset(logs, simulated.rig(), tmp_path / "d.zarr")
    assert [drive.name for drive in store.open_dataset(tmp_path / "d.zarr").drives] == ["good"]


def test_several_unusable_logs_are_named_with_each_finding(tmp_path, monkeypatch, caplog) -> None:
    log = simulated.drive_log(60.0)
    logs = opened(monkeypatch, {"one": fast(log), "two": fast(log), "good": log})
    with (
        caplog.at_level(logging.INFO, "offpiste"),
        pytest.raises(DatasetError, match=r"2 logs .*leave out 'one\.csv', 'two\.csv'"),
    ):
        make_dataset(logs, simulated.rig(), tmp_path / "d.zarr")
    lines = [record.getMessage() for record in caplog.records if record.levelname == "ERROR"]
    assert len(lines) == 2
    assert all(line.startswith(f"{name}.csv: position: ") for line, name in zip(lines, ("one", "two"), strict=True))


def test_force_extracts_it_and_keeps_what_was_found(tmp_path, monkeypatch, caplog) -> None:
    log = simulated.drive_log(60.0)
    still = log.change("odom", "x", lambda x: 1e-3 * x).change("odom", "y", lambda y: 1e-3 * y)
    logs = opened(monkeypatch, {"bad": still})
    with caplog.at_level(logging.INFO, "offpiste"):
        dataset = make_dataset(logs, simulated.rig(), tmp_path / "d.zarr", force=True)
    assert "fatal" in [finding.severity for finding in dataset.drives[0].findings]
    assert "  FATAL, extracted by --force: position: " in caplog.text


def test_findings_are_stored_with_the_drive(tmp_path) -> None:
    path = tmp_path / "data.zarr"
    store.create(path, small_rig(), SPLIT)
    for name, found in (("a", (STEER,)), ("b", (STEER, YAW)), ("c", ())):
        store.add_drive(path, name, circle_rows(2400, seed=1), SPLIT, (), findings=found)
    dataset = store.open_dataset(path)
    assert [drive.findings for drive in dataset.drives] == [(STEER,), (STEER, YAW), ()]
    assert dataset.findings == (
        "steer is positive to the right (drive a and 1 more)",
        "yaw does not follow the course (drive b)",
    )
    assert "warning: steer: is positive to the right (r = -0.9); channels.steer.sign = -1" in extract.described(
        dataset.drives[0], SPLIT
    )


@pytest.mark.parametrize(
    ("attribute", "said"),
    [
        ({"schema": 2, "found": []}, "findings of schema 2, this offpiste reads 1"),
        ({"schema": 1, "found": [{"severity": "mild"}]}, "findings cannot be read"),
        ([1, 2], "findings cannot be read"),
    ],
)
def test_what_are_no_findings_is_refused_and_none_are_fine(tmp_path, attribute, said) -> None:
    path = tmp_path / "data.zarr"
    store.create(path, small_rig(), SPLIT)
    store.add_drive(path, "a", circle_rows(2400, seed=1), SPLIT, ())
    group = zarr.open_group(path / "a", mode="r+")
    for value in (None, attribute):
        if value is None:
            del group.attrs["findings"]
        else:
            group.attrs["findings"] = value
        write_checksums(path / "a", (path / "a").rglob("zarr.json"))
        if value is None:
            assert store.open_dataset(path).drives[0].findings == ()
    with pytest.raises(DatasetError, match=said):
        store.open_dataset(path)


def test_one_line_names_the_first_and_counts_all() -> None:
    assert warning_line(findings_by_drive([("a", ())])) is None
    line = warning_line(findings_by_drive([("a", [STEER])]))
    assert line == (
        "the dataset has 1 warning of `inspect`: steer is positive to the right (drive a); `offpiste inspect` says more"
    )
    many = [LogFinding("warning", f"topic{n}", "lags", "", "") for n in range(5)]
    line = warning_line(findings_by_drive([("a", many)])) or ""
    assert "5 warnings" in line
    assert "topic2 lags (drive a), and 2 more;" in line


def test_an_unusable_log_comes_back_from_another_process() -> None:
    error = copy(UnusableLog([YAW, YAW], Path("a.csv")))
    assert error.findings == (YAW, YAW)
    assert str(error) == str(UnusableLog([YAW, YAW], Path("a.csv")))
    assert "(and 1 more)" in str(error)
