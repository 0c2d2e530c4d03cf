"""Every format gives the same drive, and other paths are refused."""

from pathlib import Path

import numpy as np
import pytest

from offpiste.core.errors import LogError
from offpiste.logs.drive import read_drive
from offpiste.logs.formats.tartandrive import TartanDriveLog
from offpiste.logs.log import LOG_FORMATS, open_log
from offpiste.rig.rig import parse_rig
from tests.fuzz.recordings import CONTAINERS, driven, rig_text


@pytest.mark.parametrize("kind", CONTAINERS)
def test_every_format_gives_the_same_drive_through_links_and_dots(kind: str, tmp_path: Path) -> None:
    container, rig, recorded = CONTAINERS[kind], parse_rig(rig_text(kind), where="test"), driven()
    path, link = tmp_path / container.name, tmp_path / f"link{Path(container.name).suffix}"
    container.write(recorded, path)
    link.symlink_to(path)
    pose, commands = recorded["odom"], recorded["commands"]
    stamps = commands.time - (0.004 if kind in ("csv", "parquet") else 0.0)  # rows of a table have one stamp
    for each in (path, link, tmp_path / ".." / tmp_path.name / container.name):
        channels = read_drive(each, rig).channels
        np.testing.assert_allclose(channels["position"].time, pose.time, atol=1e-6)
        np.testing.assert_allclose(channels["position"].values, pose.values[:, :3])
        np.testing.assert_allclose(channels["orientation"].values, pose.values[:, 3:])
        np.testing.assert_allclose(channels["steer"].time, stamps, atol=1e-6)
        np.testing.assert_allclose(channels["steer"].values, commands.values[:, 2:])


@pytest.mark.parametrize("kind", CONTAINERS)
def test_stamps_and_numbers_pass_through_unchanged(kind: str, tmp_path: Path) -> None:
    container, recorded = CONTAINERS[kind], driven()
    pose = recorded["odom"]
    pose.time[[2, 5, 6]] = pose.time[[5, 2, 5]]
    pose.values[:4, 0] = np.nan, np.inf, -np.inf, 1e300
    container.write(recorded, tmp_path / container.name)
    log = open_log(tmp_path / container.name)
    samples = log.read(container.topics["odom"], [container.fields[name] for name in ("z", "x")])
    np.testing.assert_allclose(samples.time, pose.time, atol=1e-6)
    np.testing.assert_array_equal(samples.values, pose.values[:, [2, 0]])


def test_a_folder_of_another_format_may_hold_a_bag(tmp_path: Path) -> None:
    CONTAINERS["tartandrive"].write(driven(), tmp_path)
    (tmp_path / "drive.mcap").touch()
    assert isinstance(open_log(tmp_path), TartanDriveLog)


def test_no_such_path(tmp_path: Path) -> None:
    (tmp_path / "a.bag").symlink_to(tmp_path / "gone.bag")
    for name in ("a.bag", "b.mcap"):
        with pytest.raises(LogError, match=rf"{name}: no such file or folder"):
            open_log(tmp_path / name)


def test_unknown_format(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    for path in (tmp_path, tmp_path / "notes.txt"):
        with pytest.raises(LogError, match=r"no known log format; give a ROS bag \(\.bag, \.mcap, \.db3") as error:
            open_log(path)
        for name, kind in LOG_FORMATS.items():
            assert kind.description, name
            assert kind.description in str(error.value)
