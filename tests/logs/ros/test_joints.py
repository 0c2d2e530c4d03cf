"""Names of joints: entries of arrays are known by what messages call them."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from offpiste.inspection.channel_guesses import guess_channels
from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.inspect import inspect_log
from offpiste.logs.opening import open_log
from offpiste.logs.ros.bag_files import joints_of
from offpiste.logs.ros.writer import McapWriter, floats, header, make
from offpiste.rig.rig import parse_rig

COLUMNS = ("x", "y", "yaw")


def _joints(at: int, names: tuple[str, ...], values: list[float]) -> object:
    empty = floats([])
    return make("sensor_msgs/JointState", header=header(at, ""), name=list(names), position=floats(values),
                velocity=empty, effort=empty)  # fmt: skip


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive along a winding path at 4 m/s, the whole of it in messages of joints."""
    path = tmp_path_factory.mktemp("joints") / "drive.mcap"
    time = np.arange(0, 60, 0.05)
    rate = 0.4 * np.sin(time / 2)
    yaw = np.cumsum(rate) * 0.05
    x, y = (np.cumsum(4 * f(yaw)) * 0.05 for f in (np.cos, np.sin))
    with McapWriter(path) as writer:
        for t, *pose, turn in zip(time, x, y, yaw, rate, strict=True):
            at = int((100 + t) * 1e9)
            writer.write("odometry", _joints(at, COLUMNS, [float(value) for value in pose]), at)
            writer.write("command", _joints(at, ("throttle", "steer"), [0.3 + 0.1 * np.sin(t), float(turn)]), at)
    return path


def test_entries_are_listed_with_their_names(log: Path) -> None:
    topic = open_log(log).topics["odometry"]
    assert topic.joints == {f"position[{i}]": name for i, name in enumerate(COLUMNS)}
    assert topic.in_words("position[2]") == "position[2] (yaw)"


def test_channels_are_guessed_from_them(log: Path) -> None:
    guessed = {guess.channel: (guess.topic, guess.fields) for guess in guess_channels(open_log(log))}
    assert guessed["position"] == ("odometry", ("position[0]", "position[1]"))
    assert guessed["yaw"] == ("odometry", ("position[2]",))
    assert guessed["throttle"] == ("command", ("position[0]",))
    assert guessed["steer"] == ("command", ("position[1]",))


def test_a_first_rig_says_which_entry_is_what_and_reads_the_log(log: Path) -> None:
    text = draft_rig(open_log(log))
    assert "yaw is position[2]" in text
    assert inspect_log(open_log(log), parse_rig(text, where="draft")).usable


def test_a_rig_with_the_names_is_led_to_the_entries(log: Path) -> None:
    text = draft_rig(open_log(log)).replace('fields = ["position[2]"]', 'fields = ["yaw"]')
    (finding,) = (f for f in inspect_log(open_log(log), parse_rig(text, where="draft")).findings if f.where == "yaw")
    assert "position[2] (yaw)" in finding.evidence
    assert finding.remedy == 'channels.yaw.fields = ["position[2]"]'


def test_kinds_follow_the_names_and_what_has_no_name_keeps_none() -> None:
    message = SimpleNamespace(name=["left", ""])
    fields = ["position[0]", "velocity[0]", "effort[0]", "position[1]", "position[2]", "other[0]"]
    assert joints_of(message, fields) == {
        "position[0]": "left", "velocity[0]": "left_vel", "effort[0]": "left_effort"
    }  # fmt: skip
    assert joints_of(SimpleNamespace(name="left"), fields) == {}
    assert joints_of(SimpleNamespace(), fields) == {}
    assert joints_of(None, fields) == {}
