"""Folders of tables: recognition, names of topics, refusals and omissions."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from offpiste.core.errors import LogError
from offpiste.logs.formats.table import TablesLog
from offpiste.logs.log import open_log
from offpiste.rig.channels import Clock

TIME = np.arange(0, 20, 0.05)


def _table(path: Path, names: str, *columns: np.ndarray, time: np.ndarray = TIME) -> Path:
    np.savetxt(path, np.column_stack((time, *columns)), delimiter=",", header=names, comments="", fmt="%.6f")
    return path


def _folder(path: Path) -> Path:
    """Write a folder like ulog2csv: a table per topic, all named after the log."""
    path.mkdir()
    _table(path / "log_vehicle_pose_0.csv", "timestamp,x,y,yaw", TIME, 2 * TIME, 0 * TIME, time=1e6 * TIME)
    _table(path / "log_actuator_0.csv", "timestamp,control[0]", np.sin(TIME[::2]), time=1e6 * TIME[::2])
    return path


def test_each_table_is_a_topic_without_what_all_names_begin_with(tmp_path: Path) -> None:
    log = open_log(_folder(tmp_path / "log"))
    assert isinstance(log, TablesLog)
    assert {name: (t.count, t.fields) for name, t in log.topics.items()} == {
        "actuator_0": (200, ("timestamp", "control[0]")),
        "vehicle_pose_0": (400, ("timestamp", "x", "y", "yaw")),
    }
    samples = log.read("vehicle_pose_0", ("y", "x"))
    np.testing.assert_allclose(samples.time, TIME, atol=1e-6)
    np.testing.assert_allclose(samples.values, np.column_stack((2 * TIME, TIME)), atol=1e-5)
    assert log.clock == Clock(column="timestamp", unit="us")


def test_the_clock_of_a_rig_is_that_of_the_tables_which_have_its_column(tmp_path: Path) -> None:
    folder = _folder(tmp_path / "log")
    pq.write_table(pa.table({"stamp": TIME, "speed": TIME}), folder / "log_speed.parquet")
    log = open_log(folder, clock=Clock(column="timestamp", unit="us"))
    for topic, field in (("vehicle_pose_0", "x"), ("actuator_0", "control[0]"), ("speed", "speed")):
        assert log.read(topic, (field,)).time[-1] == pytest.approx(19.9, abs=0.06)
    assert log.clock == Clock(), "they have no column in common"


def test_a_table_without_stamps_is_left_out_and_said_to_be(tmp_path: Path) -> None:
    folder = _folder(tmp_path / "log")
    (folder / "log_parameters.csv").write_text("mass,wheelbase\n1200,2.5\n1200,2.5\n")
    log = open_log(folder)
    assert set(log.topics) == {"actuator_0", "vehicle_pose_0"}
    assert "log_parameters.csv has no column of stamps: it is left out" in log.warnings


def test_tables_with_the_same_columns_are_drives_of_their_own(tmp_path: Path) -> None:
    for name in ("monday.csv", "tuesday.csv"):
        _table(tmp_path / name, "t,x,y,yaw", TIME, TIME, TIME)
    with pytest.raises(LogError, match=r"a folder of logs: monday.csv, tuesday.csv; give one of them"):
        open_log(tmp_path)


def test_two_sensors_of_one_kind_are_topics_of_one_drive(tmp_path: Path) -> None:
    folder = _folder(tmp_path / "log")
    _table(folder / "log_speed_0.csv", "timestamp,speed", TIME, time=1e6 * TIME)
    for number in (0, 1):
        _table(folder / f"log_accel_{number}.csv", "timestamp,ax", TIME, time=1e6 * TIME)
    assert {"accel_0", "accel_1"} <= set(open_log(folder).topics)


def test_tables_of_different_times_are_refused_in_one_line(tmp_path: Path) -> None:
    folder = _folder(tmp_path / "log")
    _table(folder / "log_later.csv", "timestamp,speed", TIME[:50], time=1e6 * (TIME[:50] + 100))
    with pytest.raises(
        LogError, match=r"'later' \(10\d.\d to 1\d\d.\d s\) and 'vehicle_pose_0' \(.*\) were not recorded"
    ) as refused:
        open_log(folder)
    assert "GPS" not in str(refused.value)


def test_seconds_of_a_gps_week_are_named_beside_another_clock(tmp_path: Path) -> None:
    _table(tmp_path / "ins.csv", "gps_tow_s,lat,lon,heading", TIME, TIME, TIME, time=549_963 + TIME)
    _table(tmp_path / "can.csv", "unix_time,speed", TIME, time=1.7e9 + TIME)
    with pytest.raises(LogError, match="604800 s a week"):
        open_log(tmp_path)


def test_a_bag_beside_tables_is_the_log(tmp_path: Path) -> None:
    folder = _folder(tmp_path / "log")
    (folder / "drive.mcap").write_bytes(b"")
    assert not TablesLog.recognises(folder)


def test_a_damaged_table_is_named(tmp_path: Path) -> None:
    folder = _folder(tmp_path / "log")
    (folder / "log_broken.csv").write_text("timestamp,speed\n1,2\n2,3,4,5\n3,4\n")
    with pytest.raises(LogError, match=r"log_broken.csv"):
        open_log(folder)


def test_tables_of_the_same_stem_are_topics_of_their_own_and_the_unit_of_a_rig_holds(tmp_path: Path) -> None:
    _table(tmp_path / "drive.csv", "t,x,y", TIME, TIME, time=1e3 * TIME)
    pq.write_table(pa.table({"t": 1e3 * TIME, "speed": TIME}), tmp_path / "drive.parquet")
    log = open_log(tmp_path, clock=Clock(unit="ms"))
    assert set(log.topics) == {"drive", "drive.parquet"}
    assert log.read("drive", ("x",)).time[-1] == pytest.approx(TIME[-1])


def test_stamps_that_are_all_missing_are_no_traceback(tmp_path: Path) -> None:
    for name, columns in (("one", "t,x"), ("two", "t,y")):
        (tmp_path / f"{name}.csv").write_text(f"{columns}\n,1\n,2\n")
    assert set(open_log(tmp_path).topics) == {"one", "two"}
