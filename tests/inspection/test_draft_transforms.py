"""First rigs of logs whose pose is a transform alone, and rigs that name transforms."""

from pathlib import Path
from unittest.mock import ANY

import pytest
from loggers import QUANTITIES, TIME, drafted

from offpiste.core.errors import LogError
from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.inspect import TopicRow, inspect_log
from offpiste.logs.formats.bag import BagLog
from offpiste.logs.ros.writer import McapWriter, make
from offpiste.logs.transforms import STAMPED
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig
from sensor_bags import stamp, transforms

ROWS = 2000
"""Number of recorded samples, 40 s."""


def recorded(path: Path, parent: str, child: str) -> BagLog:
    """A drive whose pose is a transform between these frames, beside one of a map."""
    with McapWriter(path) as writer:
        for seconds, row in zip((TIME - TIME[0])[:ROWS], zip(*QUANTITIES.values(), strict=True), strict=False):
            of = dict(zip(QUANTITIES, row, strict=True))
            turn, place = [of[f"q{axis}"] for axis in "xyzw"], [of[axis] for axis in "xyz"]
            joints = (parent, child, place, turn), ("map", "odom", (9, 0, 0), (0, 0, 0, 1))
            writer.write("/tf", transforms(*joints, seconds=seconds), stamp(seconds))
            for name in ("throttle", "brake", "steer"):
                writer.write(f"/{name}", make("std_msgs/Float64", data=of[name]), stamp(seconds))
    return BagLog(path)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> BagLog:
    return recorded(tmp_path_factory.mktemp("transforms") / "log.mcap", "odom", "base_link")


@pytest.fixture(scope="module")
def rig(log: BagLog) -> Rig:
    return drafted(log)


def named(rig: Rig, topic: str) -> Rig:
    return edited(rig, [Edit(f"channels.{name}.topic", topic) for name in ("position", "orientation")])


def test_a_pose_that_is_a_transform_alone(log: BagLog, rig: Rig) -> None:
    assert {rig.channels[name].topic for name in ("position", "orientation")} == {"/tf odom -> base_link"}
    found = inspect_log(log)
    assert found.usable, found.findings
    assert found.topics[-1] == TopicRow("/tf odom -> base_link", STAMPED, ROWS, pytest.approx(50), ANY)


def test_a_mistyped_transform_has_the_nearest_as_its_cure(log: BagLog, rig: Rig) -> None:
    mistyped = inspect_log(log, named(rig, "/tf odom -> base_footprint"))
    lacking = [finding for finding in mistyped.findings if finding.severity == "fatal"]
    assert {finding.where for finding in lacking} == {"position", "orientation"}
    for finding in lacking:
        assert finding.remedy == f'channels.{finding.where}.topic = "/tf odom -> base_link"'
        assert finding.evidence.startswith("there is: /tf odom -> base_link, /tf map -> odom, ")


def test_a_world_in_the_body_is_no_pose(tmp_path: Path, rig: Rig) -> None:
    log = recorded(tmp_path / "log.mcap", "base_link", "odom")
    with pytest.raises(LogError, match=r"/tf has it the other way round \(child odom in base_link\), .*Odometry"):
        draft_rig(log)
    found = inspect_log(log, named(rig, "/tf base_link -> odom"))
    turned = [f for f in found.findings if f.what == "its transform has the pose the other way round"]
    assert {(f.where, f.severity) for f in turned} == {("position", "fatal"), ("orientation", "fatal")}
