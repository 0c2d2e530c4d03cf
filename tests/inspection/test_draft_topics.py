"""First rigs of logs whose pose is spread over topics, and of controls with the names that loggers use."""

import numpy as np
import pytest
from loggers import CLEAN, ODOM, QUANTITIES, TIME, drafted
from simulated import MAX_STEER, MemoryLog, drive_log

from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.draft_sensors import missing
from offpiste.rig.rig import parse_rig


@pytest.mark.parametrize("name", ["mapping/icp_odom", "ground_truth/pose"])
@pytest.mark.parametrize("dense", [True, False])
def test_a_plain_odometry_comes_after_a_pose_that_is_corrected_and_dense(name: str, dense: bool) -> None:
    """Even if that is a pose alone: what slips is no measure of how the vehicle moves."""
    some = slice(None) if dense else slice(None, None, 20)
    pose = {field: values[some] for field, values in ODOM.items() if field[0] not in "vw"}
    log = MemoryLog({"base/odom": (TIME, ODOM), name: (TIME[some], pose)})
    channels = drafted(log).channels
    assert channels["position"].topic == (name if dense else "base/odom")
    assert ("linear_velocity" in channels) == (not dense)


def test_a_velocity_of_its_own_topic_gets_the_frame_that_fits() -> None:
    pose = {name: values for name, values in ODOM.items() if name[0] not in "vw"}
    world = {f"twist.linear.{axis}": QUANTITIES[of] for axis, of in zip("xyz", ("east", "north", "vz"), strict=True)}
    log = MemoryLog(CLEAN.data | {"odom": (TIME, pose), "velocity": (TIME, world)})
    velocity = drafted(log).channels["linear_velocity"]
    assert (velocity.topic, velocity.frame) == ("velocity", "world")
    asked = MemoryLog({("cmd_" if name[0] == "v" else "") + name: data for name, data in log.data.items()})
    assert "linear_velocity" not in drafted(asked).channels


@pytest.mark.parametrize(("trim", "sign"), [(-13.0, -1.0), (31.0, 1.0)])
def test_a_trimmed_servo_goes_straight_where_the_motion_says(trim: float, sign: float) -> None:
    time, steering = CLEAN.data["steering"]
    pulses = np.round(1500 + trim + sign * 400 * steering["command"] / np.abs(steering["command"]).max())
    servo = drafted(MemoryLog({"odom": (TIME, ODOM), "servo": (time, {"servo_us": pulses})})).channels["steer"]
    assert -servo.offset / servo.scale == pytest.approx(1500 + trim, abs=3)
    reach = np.abs(pulses - 1500 - trim).max()
    assert 1 / servo.scale == pytest.approx(reach, abs=4)


@pytest.mark.parametrize("each", [1.0, 180 / np.pi])
def test_a_command_with_the_numbers_of_the_angle_is_one(each: float) -> None:
    """As a share, 1 would be a radian."""
    time, columns = CLEAN.data["steering"]
    asked = {"command": each * MAX_STEER * columns["command"], "angle": each * columns["angle"]}
    text = draft_rig(MemoryLog(CLEAN.data | {"steering": (time, asked)}))
    rig, largest = parse_rig(text, where="draft"), MAX_STEER * np.abs(columns["command"]).max()
    assert (rig.channels["steer"].unit, rig.channels["steer"].clip) == ("rad" if each == 1 else "deg", (-1.0, 1.0))
    assert rig.vehicle.max_steer == pytest.approx(largest, rel=1e-3)
    assert "at steer = 1; the largest of this log" in text

    share = draft_rig(CLEAN)
    assert parse_rig(share, where="draft").channels["steer"].unit == ""
    assert parse_rig(share, where="draft").vehicle.max_steer == pytest.approx(MAX_STEER, rel=0.1)
    assert "at steer = 1; by the steering angle of this log" in share


TWO_ROBOTS = MemoryLog({f"/{robot}/{topic}": data for number, robot in enumerate(("robot1", "robot2"))
                        for topic, data in drive_log(seconds=20, seed=number).data.items()})  # fmt: skip


@pytest.mark.parametrize("namespace", ["/robot1", "robot2/"])
def test_a_namespace_chooses_one_of_several_vehicles(namespace: str) -> None:
    channels = drafted(TWO_ROBOTS, namespace).channels
    assert {source.topic.split("/")[1] for source in channels.values()} == {namespace.strip("/")}
    assert {"position", "throttle", "brake", "steer"} <= set(channels)


def test_a_control_that_never_changes_is_named() -> None:
    still = CLEAN.change("pedals", "throttle", lambda values: 0.25 + 0 * values)
    (line,) = [line for line in missing(draft_rig(still)) if line.startswith("throttle")]
    assert line.startswith("throttle: pedals throttle is always 0.25; without it no model")
    unsteered = still.change("steering", "command", np.zeros_like).change("steering", "angle", np.zeros_like)
    (line,) = [line for line in missing(draft_rig(unsteered)) if line.startswith("steering")]
    assert line.startswith("steering: steering command is always 0; no model")
