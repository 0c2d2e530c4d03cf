"""Entries of sensor_msgs/JointState identified by their names."""

from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from bag_files import custom, mcap_file
from offpiste.core.errors import LogError, RigError
from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.inspect import inspect_log
from offpiste.logs.channel import read_channel
from offpiste.logs.formats.bag import BagLog
from offpiste.logs.log import JOINT_ARRAYS, open_log
from offpiste.logs.ros.sensor_messages import Joints
from offpiste.logs.ros.writer import floats
from offpiste.rig.rig import parse_rig
from sensor_bags import joints
from sensor_drive import written

COLUMNS = ("x", "y", "yaw")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record a drive along a winding path at 4 m/s, entirely as messages of joints."""
    path = tmp_path_factory.mktemp("joints") / "drive.mcap"
    time = np.arange(0, 60, 0.05)
    rate = 0.4 * np.sin(time / 2)
    yaw = np.cumsum(rate) * 0.05
    x, y = (np.cumsum(4 * f(yaw)) * 0.05 for f in (np.cos, np.sin))
    messages = []
    for t, *pose, turn in zip(time, x, y, yaw, rate, strict=True):
        messages.append((t, "odometry", joints(t, pose, COLUMNS)))
        messages.append((t, "command", joints(t, [0.3 + 0.1 * np.sin(t), turn], ("throttle", "steer"))))
    return written(path, messages)


def test_a_first_rig_says_which_entry_is_what_and_reads_the_log(log: Path) -> None:
    text = draft_rig(open_log(log))
    assert "yaw is position[2]" in text
    assert inspect_log(open_log(log), parse_rig(text, where="draft")).usable


@pytest.mark.parametrize(
    ("names", "arrays", "joints"),
    [
        (["left", ""], ([1.0, 2.0, 3.0], [4.0], [5.0]),
         {"position[0]": "left", "velocity[0]": "left_vel", "effort[0]": "left_effort"}),
        (["a", "a"], ([1.0, 2.0], [], []), {"position[0]": "a", "position[1]": "a"}),
    ],
)  # fmt: skip
def test_entries_have_the_names_of_their_joints(names: list[str], arrays: tuple, joints: dict[str, str]) -> None:
    message = SimpleNamespace(name=names, **dict(zip(("position", "velocity", "effort"), arrays, strict=True)))
    found = Joints([message])
    assert found.fields == tuple(f"{kind}[{i}]" for kind in JOINT_ARRAYS for i in range(len(getattr(message, kind))))
    assert found.names == joints
    assert found.reader(found.fields[::-1])(message) == [value for array in arrays for value in array][::-1]
    assert Joints([]).fields == ()


def opened(path: Path, messages: list[tuple[float, list[float], tuple[str, ...]]]) -> BagLog:
    """Record stamps [s], positions and names of joints."""
    return BagLog(written(path, [(each[0], "joints", joints(*each)) for each in messages]))


@pytest.mark.parametrize("names", [("steer", "boom"), ("boom1", "steer")])
def test_an_order_that_changes_on_the_way_is_followed(tmp_path: Path, names: tuple[str, str]) -> None:
    orders = [1 if k < 1500 else -1 for k in range(3000)]
    messages = [(k / 10, [float(k), -1.0][::order], names[::order]) for k, order in enumerate(orders)]
    log = opened(tmp_path / "log.mcap", messages)
    assert log.topics["joints"].joints == {"position[0]": names[0], "position[1]": names[1]}
    values = log.read("joints", ["position[0]", "position[1]"]).values
    np.testing.assert_array_equal(values, np.column_stack((np.arange(3000), np.full(3000, -1))))


def test_publishers_that_share_a_topic_are_told_apart(tmp_path: Path) -> None:
    messages = [(0.0, [], ())]
    for k in range(1, 40):
        messages += [(k, [float(k)], ("steer",)), (k + 0.5, [float(-k), 0.5], ("left", "right"))]
    log = opened(tmp_path / "log.mcap", messages)
    assert log.topics["joints"].joints == {"position[0]": "steer", "position[1]": "left", "position[2]": "right"}
    values = log.read("joints", ["position[0]", "position[2]", "position[1]"]).values
    assert np.isnan(values[0]).all()
    np.testing.assert_array_equal(values[1::2], [[k, np.nan, np.nan] for k in range(1, 40)])
    np.testing.assert_array_equal(values[2::2], [[np.nan, 0.5, -k] for k in range(1, 40)])


def test_orders_that_differ_from_file_to_file_are_followed(tmp_path: Path) -> None:
    for number, order in ((0, 1), (1, -1)):
        messages = [(30 * number + k, [1.0, 2.0][::order], ("left", "boom")[::order]) for k in range(30)]
        opened(tmp_path / f"drive_{number}.mcap", messages)
    values = BagLog(tmp_path).read("joints", ["position[0]", "position[1]"]).values
    np.testing.assert_array_equal(values, np.tile([1.0, 2.0], (60, 1)))


def test_other_sequences_are_as_long_as_the_first_that_is_not_empty(tmp_path: Path) -> None:
    store, name, messages = custom("float64[] data\n", [{"data": floats(data)} for data in ([], [], [1, 2], [3])])
    log = BagLog(mcap_file(tmp_path / "log.mcap", messages, msgtype=name, store=store))
    assert log.topics["/odom"].fields == ("data[0]", "data[1]")
    np.testing.assert_array_equal(log.read("/odom", ["data[1]"]).values[:, 0], [np.nan, np.nan, 2, np.nan])


def test_a_rig_that_names_joints_reads_them_wherever_another_log_has_them(log: Path, tmp_path: Path) -> None:
    text = draft_rig(open_log(log))
    assert 'joints = ["steer"]' in text
    rig = parse_rig(text, where="test")
    names, values = ("steer", "brake", "throttle"), [0.5, 0.0, 0.2]
    messages = [(t, "command", joints(t, values, names)) for t in np.arange(0, 1, 0.05)]
    other = BagLog(written(tmp_path / "other.mcap", messages))
    assert (read_channel(other, rig, "steer", rig.channels["steer"])[0].values == 0.5).all()
    assert (read_channel(other, rig, "throttle", rig.channels["throttle"])[0].values == 0.2).all()
    wrong = msgspec.structs.replace(rig.channels["steer"], joints=("wheel",))
    message = r"'command' has no joint 'wheel' in position; fix joints in the rig; available: steer, brake, throttle"
    with pytest.raises(LogError, match=message):
        read_channel(other, rig, "steer", wrong)


def test_a_rig_names_all_joints_of_a_channel_or_none(log: Path) -> None:
    text = draft_rig(open_log(log)).replace('joints = ["steer"]', 'joints = ["steer", "throttle"]')
    with pytest.raises(RigError, match=r"steer\.joints must name every field; name each, or remove it"):
        parse_rig(text, where="test")
