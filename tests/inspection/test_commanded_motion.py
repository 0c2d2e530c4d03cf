"""Robots that are asked for a speed and a turn rate: what their first rigs read, and what is no such command."""

import numpy as np
import pytest
from simulated import MemoryLog, severe

from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.inspect import inspect_log
from offpiste.logs.drive import drive_from_log
from offpiste.rig.rig import Rig, parse_rig

START, STEP = 1.7e9, 0.02


def held(random: np.random.Generator, count: int, low: float, high: float, seconds: float) -> np.ndarray:
    """Values that a person at a gamepad holds for a while."""
    lengths = np.maximum((random.uniform(0.5, 1.5, count) * seconds / STEP).astype(int), 1)
    return np.repeat(random.uniform(low, high, count), lengths)[:count]


def lagging(asked: np.ndarray, seconds: float) -> np.ndarray:
    """A first order's response."""
    reached = np.zeros(len(asked))
    for i in range(1, len(asked)):
        reached[i] = reached[i - 1] + STEP / seconds * (asked[i - 1] - reached[i - 1])
    return reached


def robot(
    kind: str, seconds: float = 120.0, seed: int = 0, *, slowest: float = 0.0
) -> tuple[MemoryLog, dict[str, np.ndarray]]:
    """A log of a robot that turns and drives as it is asked to, and what it was asked for.

    Args:
        kind: of its commands: "twist" (a turn rate), "steering" (in the fields of a twist), "angle" (the same, of the
            road wheels, beside a speed), or "ackermann".
        slowest: speed that is asked for; below zero it reverses at times [m/s].
    """
    random, count = np.random.default_rng(seed), round(seconds / STEP)
    time = START + STEP * np.arange(count)
    speed = np.clip(held(random, count, min(slowest, -0.3), 3.0, 4.0), slowest, None)
    turn = held(random, count, -1.0, 1.0, 2.5)
    v = lagging(speed, 0.35)
    yaw_rate = lagging(0.8 * turn, 0.2) if kind == "twist" else v * np.tan(lagging(0.4 * turn, 0.12)) / 0.6
    yaw = np.cumsum(yaw_rate) * STEP
    noise = random.normal(0, 0.005, (2, count))
    odom = {
        "position.x": np.cumsum(v * np.cos(yaw)) * STEP + noise[0],
        "position.y": np.cumsum(v * np.sin(yaw)) * STEP + noise[1],
        "position.z": 0 * time,
        "orientation.x": 0 * time,
        "orientation.y": 0 * time,
        "orientation.z": np.sin(yaw / 2),
        "orientation.w": np.cos(yaw / 2),
    }
    if kind == "ackermann":
        topic = "ackermann_cmd/AckermannDrive"
        command = {"drive.steering_angle": 0.4 * turn, "drive.speed": speed, "drive.acceleration": 0 * time}
    else:
        pedal, asked = speed / 3.0 if kind == "steering" else speed, 0.4 * turn if kind == "angle" else turn
        command, topic = {"linear.x": pedal, "linear.y": 0 * time, "angular.z": asked}, "cmd_vel/Twist"
    idle = {"linear.x": 0.9 * speed[::10], "linear.y": 0 * speed[::10], "angular.z": turn[::10]}
    log = MemoryLog({"odom/Odometry": (time, odom), "teleop/cmd_vel/Twist": (time[::10], idle), topic: (time, command)})
    return log, command


def drafted(log: MemoryLog) -> Rig:
    return parse_rig(draft_rig(log), where="draft")


def test_a_turn_rate_and_a_speed_are_steering_and_throttle() -> None:
    log, asked = robot("twist")
    rig = drafted(log)
    throttle, steer = rig.channels["throttle"], rig.channels["steer"]
    assert throttle.topic == steer.topic == "cmd_vel/Twist", "the one that comes most often"
    assert (throttle.fields, steer.fields, steer.unit) == (("linear.x",), ("angular.z", "linear.x"), "rad/s")
    assert throttle.scale == pytest.approx(1 / asked["linear.x"].max(), rel=1e-3)
    drive = drive_from_log(log, rig)
    angle = rig.vehicle.max_steer * drive.channels["steer"].values[:, 0]
    curvature = np.tan(angle) / rig.vehicle.wheelbase
    inside = (asked["linear.x"] > 0.5) & (np.abs(angle) < 0.99 * rig.vehicle.max_steer)
    assert inside.mean() > 0.5
    asked_for = asked["angular.z"][inside] / asked["linear.x"][inside]
    np.testing.assert_allclose(curvature[inside], asked_for, rtol=1e-6)
    report = inspect_log(log, rig)
    assert not [f for f in report.findings if f.severity != "note"]
    (scale,) = [f.evidence for f in report.findings if (f.where, f.what) == ("steer", "estimated scale")]
    assert 0.7 < float(scale.split()[3]) < 0.85, scale


def test_a_speed_beside_a_steering_angle_is_the_throttle_and_no_late_clock() -> None:
    log, asked = robot("ackermann")
    rig = drafted(log)
    assert rig.channels["steer"].fields == ("drive.steering_angle",)
    assert rig.channels["throttle"].fields == ("drive.speed",)
    assert rig.channels["throttle"].scale == pytest.approx(1 / asked["drive.speed"].max(), rel=1e-3)
    assert not severe(log, rig)


@pytest.mark.parametrize("kind", ["twist", "ackermann", "angle"])
def test_a_speed_below_zero_is_a_throttle_in_reverse(kind: str) -> None:
    log, asked = robot(kind, slowest=-1.5)
    rig = drafted(log)
    drive = drive_from_log(log, rig)
    speed = asked["drive.speed" if kind == "ackermann" else "linear.x"]
    assert (speed < 0).mean() > 0.1
    np.testing.assert_allclose(drive.channels["throttle"].values[:, 0], np.abs(speed) / np.abs(speed).max(), atol=1e-3)
    clear = np.abs(speed) > 0.01 * np.abs(speed).max()
    np.testing.assert_array_equal(drive.channels["gear"].values[clear, 0], np.sign(speed[clear]))
    assert "brake" not in rig.channels
    assert not severe(log, rig)


def test_a_turn_rate_that_no_vehicle_has_is_in_degrees() -> None:
    log, _ = robot("twist")
    degrees = log.change("cmd_vel/Twist", "angular.z", np.rad2deg)
    plain, turned = drafted(log), drafted(degrees)
    assert turned.channels["steer"].unit == "deg/s"
    assert turned.vehicle.wheelbase == pytest.approx(plain.vehicle.wheelbase, rel=0.01)
