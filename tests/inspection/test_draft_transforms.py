"""First rigs of logs whose pose is a transform alone, and rigs that name transforms."""

from pathlib import Path
from unittest.mock import ANY

import pytest
from test_message_families import QUANTITIES, TIME

from offpiste.core.errors import LogError
from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.inspect import TopicRow, inspect_log
from offpiste.logs.formats.bag import BagLog
from offpiste.logs.ros.writer import McapWriter, make
from offpiste.logs.transforms import STAMPED
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig, parse_rig
from sensor_bags import stamp, transforms


def recorded(path: Path, parent: str, child: str) -> BagLog:
    """A drive whose pose is a transform between these frames, beside one of a map."""
    with McapWriter(path) as writer:
        for seconds, row in zip(TIME - TIME[0], zip(*QUANTITIES.values(), strict=True), strict=True):
            of = dict(zip(QUANTITIES, row, strict=True))
            turn, place = [of[f"q{axis}"] for axis in "xyzw"], [of[axis] for axis in "xyz"]
            joints = (parent, child, place, turn), ("map", "odom", (9, 0, 0), (0, 0, 0, 1))
            writer.write("/tf", transforms(*joints, seconds=seconds), stamp(seconds))
            for name in ("throttle", "brake", "steer"):
                writer.write(f"/{name}", make("std_msgs/Float64", data=of[name]), stamp(seconds))
    return BagLog(path)


def named(rig: Rig, topic: str) -> Rig:
    return edited(rig, [Edit(f"channels.{name}.topic", topic) for name in ("position", "orientation")])


def test_a_pose_that_is_a_transform_alone(tmp_path: Path) -> None:
    log = recorded(tmp_path / "log.mcap", "odom", "base_link")
    rig = parse_rig(draft_rig(log), where="test")
    assert {rig.channels[name].topic for name in ("position", "orientation")} == {"/tf odom -> base_link"}
    for found in (inspect_log(log), inspect_log(log, rig)):
        assert found.usable, found.findings
        assert found.topics[-1] == TopicRow("/tf odom -> base_link", STAMPED, len(TIME), pytest.approx(50), ANY)


def test_a_mistyped_transform_has_the_nearest_as_its_cure(tmp_path: Path) -> None:
    log = recorded(tmp_path / "log.mcap", "odom", "base_link")
    rig = parse_rig(draft_rig(log), where="test")
    mistyped = inspect_log(log, named(rig, "/tf odom -> base_footprint"))
    lacking = [finding for finding in mistyped.findings if finding.severity == "fatal"]
    assert {finding.where for finding in lacking} == {"position", "orientation"}
    for finding in lacking:
        assert finding.remedy == f'channels.{finding.where}.topic = "/tf odom -> base_link"'
        assert finding.evidence.startswith("there is: /tf odom -> base_link, /tf map -> odom, ")


def test_frames_of_any_names_are_read_where_a_rig_names_them(tmp_path: Path) -> None:
    rig = parse_rig(draft_rig(recorded(tmp_path / "log.mcap", "odom", "base_link")), where="test")
    other = recorded(tmp_path / "other.mcap", "start", "rig7")
    with pytest.raises(LogError, match=r"no topic looks like a pose .*, /tf start -> rig7"):
        draft_rig(other)
    by_hand = inspect_log(other, named(rig, "/tf start -> rig7"))
    assert by_hand.usable, by_hand.findings
    assert by_hand.topics[-1].name == "/tf start -> rig7"


def test_a_world_in_the_body_is_no_pose(tmp_path: Path) -> None:
    log = recorded(tmp_path / "log.mcap", "base_link", "odom")
    with pytest.raises(LogError, match=r"/tf has it the other way round \(child odom in base_link\), .*Odometry"):
        draft_rig(log)
    rig = parse_rig(draft_rig(recorded(tmp_path / "right.mcap", "odom", "base_link")), where="test")
    found = inspect_log(log, named(rig, "/tf base_link -> odom"))
    turned = [finding for finding in found.findings if finding.what == "its transform has the pose the other way round"]
    assert {(finding.where, finding.severity) for finding in turned} == {
        ("position", "fatal"),
        ("orientation", "fatal"),
    }
