"""Recognition of log formats, and refusal of other paths."""

from pathlib import Path

import numpy as np
import pytest

from bag_files import mcap_file, twists
from offpiste.core.errors import LogError
from offpiste.logs.formats.bag import BagLog
from offpiste.logs.formats.table import TableLog
from offpiste.logs.formats.tartandrive import TartanDriveLog
from offpiste.logs.log import LOG_FORMATS, open_log
from offpiste.rig.channels import Clock


@pytest.fixture
def logs(tmp_path: Path) -> dict[str, Path]:
    odometry = tmp_path / "tartan" / "odom"
    odometry.mkdir(parents=True)
    np.save(odometry / "odometry.npy", np.array([[1.0, 2.0]]))
    (odometry / "timestamps.txt").write_text("5.0\n")
    (tmp_path / "table.csv").write_text("tick,x\n2000,7\n")
    (tmp_path / "bag").mkdir()
    bag = mcap_file(tmp_path / "bag" / "bag_0.mcap", twists(1))
    return {"tartan": tmp_path / "tartan", "table": tmp_path / "table.csv", "bag": bag.parent, "mcap": bag}


def test_the_reader_fits_the_path(logs: dict[str, Path]) -> None:
    assert isinstance(open_log(logs["tartan"]), TartanDriveLog)
    assert isinstance(open_log(logs["table"], clock=Clock(column="tick")), TableLog)
    assert isinstance(open_log(logs["bag"]), BagLog)
    assert isinstance(open_log(str(logs["mcap"])), BagLog)


def test_clock_reaches_the_table(logs: dict[str, Path]) -> None:
    samples = open_log(logs["table"], clock=Clock(column="tick", unit="ms")).read("", ["x"])
    assert (samples.time.tolist(), samples.values.tolist()) == ([2.0], [[7.0]])


@pytest.mark.parametrize("name", ["table", "bag"])
def test_links_and_dots_in_a_path_are_harmless(logs: dict[str, Path], tmp_path: Path, name: str) -> None:
    path = logs[name]
    link = tmp_path / f"link{path.suffix}"
    link.symlink_to(path)
    around = path.parent / ".." / path.parent.name / path.name
    plain, *others = (open_log(each, clock=Clock(column="tick")) for each in (path, link, around))
    (topic,) = plain.topics.values()
    for log in others:
        assert log.topics == plain.topics
        one, other = (each.read(topic.name, topic.fields).values for each in (log, plain))
        np.testing.assert_array_equal(one, other)


def test_a_folder_of_another_format_may_hold_a_bag(logs: dict[str, Path]) -> None:
    (logs["tartan"] / "drive.mcap").write_bytes(logs["mcap"].read_bytes())
    assert isinstance(open_log(logs["tartan"]), TartanDriveLog)


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
