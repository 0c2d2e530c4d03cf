"""TartanDrive 2 folders: the recorded drives, and damaged folders."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from offpiste.core.errors import LogError
from offpiste.logs.formats.tartandrive import TartanDriveLog
from offpiste.rig.channels import Clock


def modality(drive: Path, name: str, array: np.ndarray, stamps: np.ndarray | None = None) -> Path:
    folder = drive / name
    folder.mkdir(parents=True)
    np.save(folder / "data.npy", array)
    np.savetxt(folder / "timestamps.txt", np.arange(len(array)) if stamps is None else stamps)
    return folder


def test_real_drives(data_folder: Path) -> None:
    log = TartanDriveLog(data_folder / "tartandrive2" / "drives" / "2023-11-02-16-00-43_down_meadows")
    assert {topic: log.topics[topic].count for topic in log.topics} == {
        "cmd": 2155, "controls": 10775, "current_position": 2155, "gps_odom": 10775, "novatel_imu": 21550,
        "shock_pos": 10775, "steering_angle": 2155, "super_odom": 21550, "tartanvo_odom": 2155, "wheel_rpm": 10775,
    }  # fmt: skip
    odometry = log.topics["gps_odom"]
    assert (odometry.type, odometry.fields) == ("odometry.npy", tuple(map(str, range(13))))
    quaternions = log.read("gps_odom", ["3", "4", "5", "6"]).values
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0, atol=1e-6)


def test_folder_without_array_is_an_empty_topic(tmp_path: Path) -> None:
    modality(tmp_path, "odom", np.zeros((3, 2)))
    (tmp_path / "odom" / "data.npy").unlink()
    log = TartanDriveLog(tmp_path)
    assert (log.topics["odom"].count, log.topics["odom"].fields) == (0, ())
    with pytest.raises(LogError, match="topic 'odom' is empty; declare its channels absent in the rig"):
        log.read("odom", ["0"])


@pytest.mark.parametrize("values", [np.array([4, 5, 6], np.int16), np.array([[4], [5], [6]])])
def test_numbers_of_any_type_are_columns(tmp_path: Path, values: np.ndarray) -> None:
    modality(tmp_path, "angle", values)
    log = TartanDriveLog(tmp_path)
    assert log.topics["angle"].fields == ("0",)
    assert log.read("angle", ["0"]).values.tolist() == [[4.0], [5.0], [6.0]]


def as_file(array: np.ndarray) -> bytes:
    file = BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


ARRAY = as_file(np.zeros((200, 2)))


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        *(
            ("data.npy", content, "not a readable array: .*; export the folder again")
            for content in (*(ARRAY[:keep] for keep in (0, 4, 60, -1, -1000)), b"\x80\x04]\x94.", as_file([{"a": 1}]))
        ),
        ("data.npy", as_file(["a", "b"]), r"holds <U1, shape \(2,\), not rows of numbers"),
        ("timestamps.txt", b"0\n1\n2\n", "3 stamps for 2 samples; the folder was cut short or mixed; export it again"),
        ("timestamps.txt", b"0.0\nsoon\n", "stamps are not numbers: .*soon.*; export the folder again"),
    ],
)
def test_damaged_files_are_refused(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    folder = modality(tmp_path, "odom", np.zeros((2, 2)))
    (folder / name).write_bytes(content)
    with pytest.raises(LogError, match=f"odom(/{name})?: {message}"):
        TartanDriveLog(tmp_path).read("odom", ["0"])


@pytest.mark.parametrize(("unit", "seconds"), [("ms", 0.02), ("", 20.0)])
def test_stamps_are_read_in_the_rigs_unit(tmp_path: Path, unit: str, seconds: float) -> None:
    modality(tmp_path, "odometry", np.zeros((4, 3)), np.arange(4) * 20.0)
    log = TartanDriveLog.open(tmp_path, Clock(column="x", unit=unit))  # type: ignore[arg-type]
    np.testing.assert_allclose(log.read("odometry", ("0",)).time, np.arange(4) * seconds)
