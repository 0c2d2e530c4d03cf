"""Copies of the steering: late ones that pass for its command, and poses that are computed from it."""

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig, steered

from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.recorded_log import RememberedLog, read_topics
from offpiste.inspection.steering_copies import check_copies
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import Edit, edited

CLEAN = drive_log(seed=3)
COMMAND = CLEAN.data["steering"][1]["command"]


def _found(log: MemoryLog, *edits: Edit) -> list[str]:
    findings = inspect_log(log, edited(rig(), list(edits))).findings
    assert "fatal" not in {f.severity for f in findings}
    return [f"{f.where} {f.what}; {f.remedy}" for f in findings if f.what.startswith("is computed")]


def test_a_pose_that_is_the_steering_times_the_speed_is_computed() -> None:
    """As of a VESC's odometry, which no tyre and no servo delays."""
    (found,) = _found(steered(CLEAN, COMMAND, follows=0.0))
    assert found.startswith("orientation is computed from channel steer;")
    assert "measured" in found
    assert "may be one" not in found


def test_another_pose_of_the_log_is_named() -> None:
    log = steered(CLEAN, COMMAND, follows=0.0)
    places, old = ("x", "y", "z", "qx", "qy", "qz", "qw"), CLEAN.data["odom"]
    names = [*(f"pose.position.{k}" for k in "xyz"), *(f"pose.orientation.{k}" for k in "xyzw")]
    still = dict.fromkeys(names, 0.0 * old[0] + 1.0)
    moving = dict(zip(names, (old[1][field] for field in places), strict=True))
    (found,) = _found(MemoryLog({**log.data, "/pf/pose": (old[0], moving), "/map/pose": (old[0], still)}))
    assert found.endswith("Here /pf/pose may be one")


@pytest.mark.parametrize("follows", [0.1, 0.2])
def test_wheels_that_follow_their_command_are_no_formula_of_it(follows: float) -> None:
    """The measured angle of a simulator's own is left out: its pose is one."""
    log = steered(CLEAN, COMMAND, follows=follows)
    assert _found(log, Edit("channels.steer_angle", None), Edit("absent", [*rig().absent, "steer_angle"])) == []


def test_a_measured_pose_is_not_computed() -> None:
    assert _found(CLEAN) == []


@pytest.mark.parametrize("slip", [0.05, 0.1])
def test_a_rear_axle_that_slips_is_not_computed(slip: float) -> None:
    """It goes aside of where it heads, in proportion to its turning."""
    log = steered(CLEAN, COMMAND, follows=0.0)
    time, odom = log.data["odom"]
    yaw = np.unwrap(2 * np.arctan2(odom["qz"], odom["qw"]))
    step, course = float(np.median(np.diff(time))), yaw - slip * odom["wz"]
    x, y = (np.cumsum(odom["vx"] * way(course)) * step for way in (np.cos, np.sin))
    assert _found(MemoryLog({**log.data, "odom": (time, odom | {"x": x, "y": y})})) == []


def test_a_vehicle_that_turns_one_way_alone_shows_no_formula() -> None:
    assert _found(steered(CLEAN, np.abs(COMMAND), follows=0.0)) == []


def test_a_gyroscope_is_no_late_copy_of_the_steering() -> None:
    log = drive_log(seed=0)
    time, columns = log.data["steering"]

    def named(topic: str) -> list[str]:
        late = {topic: (time + 0.5, {"z": columns["command"]})}
        both = MemoryLog({**log.data, **late})
        recorded, _ = read_topics(RememberedLog(both, rig()), rig())
        return [finding.where for finding in check_copies(drive_from_log(both, rig()), recorded)]

    assert named("/status") == ["/status z"]
    assert named("/imu/imu") == []
