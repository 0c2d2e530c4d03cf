"""First rigs of logs whose pose is spread over topics, and of controls with the names that loggers use."""

import dataclasses

import numpy as np
import pytest
from simulated import MAX_STEER, MemoryLog, drive_log

from offpiste.inspection.channel_guesses import guess_channels
from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.draft_sensors import missing
from offpiste.logs.log import Topic
from offpiste.rig.rig import Rig, parse_rig

CLEAN = drive_log()
TIME, ODOM = CLEAN.data["odom"]


class Typed(MemoryLog):
    """Topics whose names end in their type."""

    @property
    def topics(self) -> dict[str, Topic]:
        return {name: dataclasses.replace(topic, type=name.split("/")[-1]) for name, topic in super().topics.items()}


def _receiver_and_imu(sign: float = 1.0) -> Typed:
    """A GNSS receiver at 10 Hz, an IMU and a gamepad."""
    rows = np.arange(0, len(TIME), max(round(0.1 / float(np.median(np.diff(TIME)))), 1))
    fix = {"latitude": 47.4 + ODOM["y"] / 111_180, "longitude": 8.5 + ODOM["x"] / 75_500, "altitude": 450 + ODOM["z"]}
    half = sign * np.arctan2(ODOM["qz"], ODOM["qw"])
    turned = {"orientation.x": 0 * half, "orientation.y": 0 * half, "orientation.z": np.sin(half),
              "orientation.w": np.cos(half), "angular_velocity.x": ODOM["wx"], "angular_velocity.y": ODOM["wy"],
              "angular_velocity.z": ODOM["wz"]}  # fmt: skip
    time, pedals = CLEAN.data["pedals"]
    steer = np.interp(time, CLEAN.data["steering"][0], CLEAN.data["steering"][1]["command"])
    axes = {"axes[0]": steer, "axes[1]": 0 * time, "axes[2]": 1 - 2 * pedals["brake"],
            "axes[5]": 1 - 2 * pedals["throttle"]}  # fmt: skip
    log = {"gnss/NavSatFix": (TIME[rows], {name: values[rows] for name, values in fix.items()})}
    return Typed(log | {"imu/Imu": (TIME, turned), "joy/Joy": (time, axes)})


def _drafted(log: MemoryLog) -> Rig:
    return parse_rig(draft_rig(log), where="draft")


def test_a_receiver_an_imu_and_a_gamepad_make_a_rig() -> None:
    channels = _drafted(_receiver_and_imu()).channels
    assert (channels["position"].topic, channels["position"].unit) == ("gnss/NavSatFix", "lat lon")
    assert channels["orientation"].topic == channels["angular_velocity"].topic == "imu/Imu"
    assert channels["steer"].fields == ("axes[0]",)
    assert channels["throttle"].fields == ("axes[5]",)


@pytest.mark.parametrize("name", ["mapping/icp_odom", "ground_truth/pose"])
@pytest.mark.parametrize("dense", [True, False])
def test_a_plain_odometry_comes_after_a_pose_that_is_corrected_and_dense(name: str, dense: bool) -> None:
    """Even if that is a pose alone: what slips is no measure of how the vehicle moves."""
    some = slice(None) if dense else slice(None, None, 20)
    pose = {field: values[some] for field, values in ODOM.items() if field[0] not in "vw"}
    log = Typed({"base/odom": (TIME, ODOM), name: (TIME[some], pose)})
    channels = _drafted(log).channels
    assert channels["position"].topic == (name if dense else "base/odom")
    assert ("linear_velocity" in channels) == (not dense)


@pytest.mark.parametrize(
    ("field", "channel"),
    [
        ("thr_pct", "throttle"),
        ("brk_pct", "brake"),
        ("str_cmd", "steer"),
        ("commands/servo/position", "steer"),
        ("tps", "throttle"),
        ("p_brake_f", "brake_pressure"),
        ("brake_pressure", "brake_pressure"),
    ],
)
def test_short_names_of_loggers(field: str, channel: str) -> None:
    log = MemoryLog({"table": (TIME, {"a": TIME, field: np.sin(TIME), "b": TIME})})
    assert (channel, (field,)) in {(guess.channel, guess.fields) for guess in guess_channels(log)}


def _actuators() -> Typed:
    """Commands in an array of no names, with the measured angle of the wheels, a quarter of a second behind."""
    time, pedals = CLEAN.data["pedals"]
    steer_time, steering = CLEAN.data["steering"]
    command, angle = (
        np.interp(time - late, steer_time, steering[name]) for late, name in ((-0.2, "command"), (0.05, "angle"))
    )
    array = {
        "data[0]": 255 * pedals["throttle"],
        "data[1]": 255 * 0.6 * pedals["brake"],
        "data[2]": 511.5 * (command + 1),
        "data[3]": np.degrees(angle),
    }
    return Typed({"odom": (TIME, ODOM), "actuators/Float32MultiArray": (time, array)})


def test_an_array_of_commands_and_a_measured_angle_is_read_by_its_numbers() -> None:
    log = _actuators()
    text = draft_rig(log)
    rig = parse_rig(text, where="draft")
    fields = {name: rig.channels[name].fields for name in ("throttle", "brake", "steer", "steer_angle")}
    assert fields == {
        "throttle": ("data[0]",),
        "brake": ("data[1]",),
        "steer": ("data[2]",),
        "steer_angle": ("data[3]",),
    }
    assert [rig.channels[name].scale for name in ("throttle", "brake")] == [pytest.approx(1 / 255, rel=1e-3)] * 2
    steer = rig.channels["steer"]
    assert (steer.scale, steer.offset) == (pytest.approx(1 / 511.5, rel=1e-3), -1.0)
    assert rig.channels["steer_angle"].unit == "deg"


def test_a_velocity_of_its_own_topic_gets_the_frame_that_fits() -> None:
    pose = {name: values for name, values in ODOM.items() if name[0] not in "vw"}
    yaw = 2 * np.arctan2(ODOM["qz"], ODOM["qw"])
    world = {"twist.linear.x": ODOM["vx"] * np.cos(yaw), "twist.linear.y": ODOM["vx"] * np.sin(yaw),
             "twist.linear.z": ODOM["vz"]}  # fmt: skip
    log = Typed(CLEAN.data | {"odom": (TIME, pose), "velocity/TwistStamped": (TIME, world)})
    velocity = _drafted(log).channels["linear_velocity"]
    assert (velocity.topic, velocity.frame) == ("velocity/TwistStamped", "world")
    asked = Typed({("cmd_" if name[0] == "v" else "") + name: data for name, data in log.data.items()})
    assert "linear_velocity" not in _drafted(asked).channels


def test_pulses_of_a_servo_and_a_speed_controller() -> None:
    time, pedals = CLEAN.data["pedals"]
    steer = np.interp(time, CLEAN.data["steering"][0], CLEAN.data["steering"][1]["command"])
    columns = {"servo_us": 1500 - 400 * steer, "esc_us": 1500 + 400 * (pedals["throttle"] - pedals["brake"])}
    rig = _drafted(Typed({"odom": (TIME, ODOM), "radio": (time, columns)}))
    throttle, brake, servo = (rig.channels[name] for name in ("throttle", "brake", "steer"))
    assert (throttle.scale, throttle.offset, throttle.sign) == (0.002, -3.0, 1)
    assert (brake.fields, brake.scale, brake.offset, brake.sign) == (throttle.fields, 0.002, -3.0, -1)
    reach = float(np.abs(columns["servo_us"] - 1500).max())
    assert (servo.scale, servo.offset) == (pytest.approx(1 / reach, rel=1e-3), pytest.approx(-1500 / reach, rel=1e-3))


@pytest.mark.parametrize(("trim", "sign"), [(-13.0, -1.0), (31.0, 1.0)])
def test_a_trimmed_servo_goes_straight_where_the_motion_says(trim: float, sign: float) -> None:
    time, steering = CLEAN.data["steering"]
    pulses = np.round(1500 + trim + sign * 400 * steering["command"] / np.abs(steering["command"]).max())
    servo = _drafted(Typed({"odom": (TIME, ODOM), "servo": (time, {"servo_us": pulses})})).channels["steer"]
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


def test_a_joint_of_the_steering_is_its_measured_angle() -> None:
    time, steering = CLEAN.data["steering"]
    log = Jointed({
        "odom": (TIME, ODOM),
        "joint_states": (time, {"position[0]": steering["angle"], "position[1]": np.cumsum(steering["angle"])}),
        "ackermann_cmd": (time, {"drive.steering_angle": 0.4 * steering["command"]}),
    })  # fmt: skip
    channels = _drafted(log).channels
    assert (channels["steer"].topic, channels["steer"].unit) == ("ackermann_cmd", "rad")
    assert channels["steer_angle"].fields == ("position[0]",)


class Jointed(MemoryLog):
    """Joint states: messages name their entries."""

    @property
    def topics(self) -> dict[str, Topic]:
        """The names of a car's two joints."""
        joints = {"position[0]": "front_steer_joint", "position[1]": "rear_wheel_joint"}
        return super().topics | {"joint_states": dataclasses.replace(super().topics["joint_states"], joints=joints)}


TWO_ROBOTS = MemoryLog({f"/{robot}/{topic}": data for number, robot in enumerate(("robot1", "robot2"))
                        for topic, data in drive_log(seconds=20, seed=number).data.items()})  # fmt: skip


@pytest.mark.parametrize("namespace", ["/robot1", "robot2/"])
def test_a_namespace_chooses_one_of_several_vehicles(namespace: str) -> None:
    channels = parse_rig(draft_rig(TWO_ROBOTS, namespace), where="test").channels
    assert {source.topic.split("/")[1] for source in channels.values()} == {namespace.strip("/")}
    assert {"position", "throttle", "brake", "steer"} <= set(channels)


def test_a_control_that_never_changes_is_named() -> None:
    still = CLEAN.change("pedals", "throttle", lambda values: 0.25 + 0 * values)
    (line,) = [line for line in missing(draft_rig(still)) if line.startswith("throttle")]
    assert line.startswith("throttle: pedals throttle is always 0.25; without it no model")
    unsteered = still.change("steering", "command", np.zeros_like).change("steering", "angle", np.zeros_like)
    (line,) = [line for line in missing(draft_rig(unsteered)) if line.startswith("steering")]
    assert line.startswith("steering: steering command is always 0; no model")
