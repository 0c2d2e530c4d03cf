"""First rigs of logs with the messages of drivers and stacks that off-road vehicles run."""

import dataclasses
import re
from collections.abc import Mapping

import numpy as np
import pytest
from simulated import MAX_STEER, MemoryLog, drive_log, severe

from offpiste.core.errors import LogError
from offpiste.inspection.channel_guesses import guess_channels
from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.inspect import inspect_log
from offpiste.logs.drive import drive_from_log
from offpiste.logs.log import Topic
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig, parse_rig

CLEAN = drive_log()
TIME, ODOM = CLEAN.data["odom"]
STEERING = CLEAN.data["steering"]


def _quantities() -> dict[str, np.ndarray]:
    """What a vehicle's messages hold, by the poses' stamps."""
    yaw = 2 * np.arctan2(ODOM["qz"], ODOM["qw"])
    at = {name: np.interp(TIME, *pair) for name, pair in {
        "throttle": (CLEAN.data["pedals"][0], CLEAN.data["pedals"][1]["throttle"]),
        "brake": (CLEAN.data["pedals"][0], CLEAN.data["pedals"][1]["brake"]),
        "steer": (STEERING[0], STEERING[1]["command"]),
        "angle": (STEERING[0], STEERING[1]["angle"]),
    }.items()}  # fmt: skip
    return ODOM | at | {
        "0": 0 * TIME,
        "1": 0 * TIME + 1,
        "latitude": 47.4 + ODOM["y"] / 111_180,
        "longitude": 8.5 + ODOM["x"] / 75_500,
        "height": 450 + ODOM["z"],
        "east": np.cos(yaw) * ODOM["vx"] - np.sin(yaw) * ODOM["vy"],
        "north": np.sin(yaw) * ODOM["vx"] + np.cos(yaw) * ODOM["vy"],
        "azimuth": np.rad2deg(np.pi / 2 - yaw) % 360,
        "azimuth in rad": (np.pi / 2 - yaw) % (2 * np.pi),
        "counted latitude": np.round(1e7 * (47.4 + ODOM["y"] / 111_180)),
        "counted longitude": np.round(1e7 * (8.5 + ODOM["x"] / 75_500)),
        "counted height": np.round(1e3 * (450 + ODOM["z"])),
        "counted azimuth": np.round(1e5 * (np.rad2deg(np.pi / 2 - yaw) % 360)),
        "counted north": np.round(1e3 * (np.sin(yaw) * ODOM["vx"] + np.cos(yaw) * ODOM["vy"])),
        "counted east": np.round(1e3 * (np.cos(yaw) * ODOM["vx"] - np.sin(yaw) * ODOM["vy"])),
        "down": -ODOM["z"],
        "sinking": -ODOM["vz"],
        "right": -ODOM["wy"],
        "clockwise": -ODOM["wz"],
        "half azimuth cos": np.cos((np.pi / 2 - yaw) / 2),
        "half azimuth sin": np.sin((np.pi / 2 - yaw) / 2),
        "wheel": 14 * at["angle"],
        "wheel in deg": 800 * at["angle"],
        "tire command": MAX_STEER * at["steer"],
        "speed command": np.interp(TIME + 0.4, TIME, ODOM["vx"]),
        "duty": ODOM["vx"] / 20,
        "steering pulse": 1500 - 400 * at["steer"],
        "throttle pulse": 1500 + 400 * (at["throttle"] - at["brake"]),
        "middle pulse": 0 * TIME + 1500,
    }  # fmt: skip


QUANTITIES = _quantities()
POSE = {f"pose.pose.position.{axis}": axis for axis in "xyz"}
POSE |= {f"pose.pose.orientation.{axis}": f"q{axis}" for axis in "xyzw"}
VECTOR = ("vector.x", "vector.y", "vector.z")
COMMANDS = {"/cmd": {"throttle": "throttle", "brake": "brake", "steer": "steer"}}


def report(command: str, output: str) -> dict[str, str]:
    """A report of pacmod3_msgs, with nobody at the pedals."""
    return {"enabled": "1", "override_active": "0", "pacmod_fault": "0", "manual_input": "0", "command": command,
            "output": output}  # fmt: skip


FAMILIES: Mapping[str, tuple[dict[str, dict[str, str]], dict[str, tuple[str, ...]]]] = {
    "NovAtel INSPVA": (
        {"/inspva": {"latitude": "latitude", "longitude": "longitude", "height": "height", "north_velocity": "north",
                     "east_velocity": "east", "up_velocity": "vz", "roll": "0", "pitch": "0", "azimuth": "azimuth"}}
        | COMMANDS,
        {"position": ("latitude", "longitude", "height"), "yaw": ("azimuth",),
         "linear_velocity": ("east_velocity", "north_velocity", "up_velocity")},
    ),
    "u-blox NavPVT": (
        {"/ublox/navpvt": {"lon": "counted longitude", "lat": "counted latitude", "height": "counted height",
                           "vel_n": "counted north", "vel_e": "counted east", "heading": "counted azimuth"}}
        | COMMANDS,
        {"position": ("lat", "lon"), "yaw": ("heading",), "linear_velocity": ("vel_e", "vel_n")},
    ),
    "Inertial Sense, quaternion": (
        {"/ins2": {"qn2b[0]": "half azimuth cos", "qn2b[1]": "0", "qn2b[2]": "0", "qn2b[3]": "half azimuth sin",
                   "lla[0]": "latitude", "lla[1]": "longitude", "lla[2]": "height"}}
        | COMMANDS,
        {"position": ("lla[0]", "lla[1]", "lla[2]"), "orientation": ("qn2b[1]", "qn2b[2]", "qn2b[3]", "qn2b[0]")},
    ),
    "PX4": (
        {"/fmu/out/vehicle_odometry": {
            "position[0]": "y", "position[1]": "x", "position[2]": "down", "q[0]": "half azimuth cos", "q[1]": "0",
            "q[2]": "0", "q[3]": "half azimuth sin", "velocity[0]": "north", "velocity[1]": "east",
            "velocity[2]": "sinking", "angular_velocity[0]": "wx", "angular_velocity[1]": "right",
            "angular_velocity[2]": "clockwise"}}
        | COMMANDS,
        {"position": ("position[0]", "position[1]", "position[2]"), "orientation": ("q[1]", "q[2]", "q[3]", "q[0]"),
         "angular_velocity": ("angular_velocity[0]", "angular_velocity[1]", "angular_velocity[2]")},
    ),
    "Xsens": (
        {"/filter/positionlla": dict(zip(VECTOR, ("latitude", "longitude", "height"), strict=True)),
         "/filter/quaternion": {f"quaternion.{axis}": f"q{axis}" for axis in "xyzw"},
         "/filter/velocity": dict(zip(VECTOR, ("east", "north", "vz"), strict=True)),
         "/filter/free_acceleration": dict(zip(VECTOR, ("vx", "vy", "vz"), strict=True))}
        | COMMANDS,
        {"position": VECTOR, "orientation": tuple(f"quaternion.{axis}" for axis in "xyzw"), "linear_velocity": VECTOR},
    ),
    "pacmod3": (
        {"/odom": POSE, "/pacmod/accel_rpt": report("throttle", "throttle"),
         "/pacmod/brake_rpt": report("brake", "brake"), "/pacmod/steering_rpt": report("steer", "wheel")},
        {"throttle": ("output",), "brake": ("output",), "steer": ("output",)},
    ),
    "Autoware": (
        {"/localization/kinematic_state": POSE,
         "/control/command/control_cmd": {
             "lateral.steering_tire_angle": "tire command", "lateral.steering_tire_rotation_rate": "0",
             "longitudinal.velocity": "speed command", "longitudinal.acceleration": "0"},
         "/vehicle/status/steering_status": {"steering_tire_angle": "angle"},
         "/vehicle/command/actuation_cmd": {
             "actuation.accel_cmd": "throttle", "actuation.brake_cmd": "brake", "actuation.steer_cmd": "0"}},
        {"throttle": ("actuation.accel_cmd",), "brake": ("actuation.brake_cmd",),
         "steer": ("lateral.steering_tire_angle",), "steer_angle": ("steering_tire_angle",)},
    ),
    "F1TENTH": (
        {"/odom": POSE,
         "/ackermann_cmd": {"drive.steering_angle": "tire command", "drive.steering_angle_velocity": "0",
                            "drive.speed": "speed command", "drive.acceleration": "0", "drive.jerk": "0"},
         "/sensors/core": {"state.temp_fet": "height", "state.temp_motor": "height", "state.current_motor": "duty",
                           "state.speed": "vx", "state.duty_cycle": "duty", "state.voltage_input": "1"}},
        {"throttle": ("drive.speed",), "steer": ("drive.steering_angle",)},
    ),
    "Dataspeed DBW2": (
        {"/odom": POSE,
         "/vehicle/throttle/report": {"percent_input": "throttle", "percent_cmd": "0", "enabled": "1", "fault": "0"},
         "/vehicle/brake/report": {"cmd_type": "0", "torque_input": "brake", "percent_input": "brake", "enabled": "1"},
         "/vehicle/steering/report": {"steering_wheel_angle": "wheel", "steering_wheel_torque": "wy", "enabled": "1"}},
        {"throttle": ("percent_input",), "brake": ("percent_input",), "steer": ("steering_wheel_angle",)},
    ),
    "MAVROS": (
        {"/mavros/local_position/odom": POSE,
         "/mavros/rc/out": {"channels[0]": "steering pulse", "channels[1]": "middle pulse",
                            "channels[2]": "throttle pulse", "channels[3]": "middle pulse"}},
        {"throttle": ("channels[2]",), "brake": ("channels[2]",), "steer": ("channels[0]",)},
    ),
    "AutoRally": (
        {"/pose_estimate": POSE,
         "/chassisState": {"throttleRelayEnabled": "1", "steering": "steer", "throttle": "throttle",
                           "frontBrake": "brake", "autonomousEnabled": "1"},
         "/wheelSpeeds": {"lfSpeed": "vx", "rfSpeed": "vx", "lbSpeed": "vx", "rbSpeed": "vx"}},
        {"throttle": ("throttle",), "brake": ("frontBrake",), "steer": ("steering",),
         "wheel_speed": ("lfSpeed", "rfSpeed", "lbSpeed", "rbSpeed")},
    ),
}  # fmt: skip


TYPES: Mapping[str, str] = {"/fmu/out/vehicle_odometry": "px4_msgs/msg/VehicleOdometry"}
"""Types of messages that say what their fields do not."""


class Log(MemoryLog):
    """Topics of which most have messages of another type than those that the drafts know."""

    @property
    def topics(self) -> dict[str, Topic]:
        types = {name: TYPES.get(name, "x/msg/X") for name in super().topics}
        return {name: dataclasses.replace(topic, type=types[name]) for name, topic in super().topics.items()}


def log_of(topics: Mapping[str, Mapping[str, str]]) -> Log:
    return Log({name: (TIME, {f: QUANTITIES[q] for f, q in fields.items()}) for name, fields in topics.items()})


def cured(log: MemoryLog, rig: Rig) -> list[str]:
    """What is left of the warnings once the rig has the first cures."""
    for _ in range(3):
        findings = severe(log, rig)
        if not any(f.cures for f in findings):
            break
        rig = edited(rig, [edit for f in findings for edit in (f.cures[0] if f.cures else ())])
    return [f"{f.where} {f.what}" for f in findings]


@pytest.mark.parametrize("name", FAMILIES)
def test_channels_are_found_in_messages_of(name: str) -> None:
    topics, expected = FAMILIES[name]
    log = log_of(topics)
    rig = parse_rig(draft_rig(log), where="draft")
    assert {channel: rig.channels[channel].fields for channel in expected} == expected
    assert cured(log, rig) == []


FIRST = """
steer_pwm throttle_pwm: steer steer_pwm, throttle throttle_pwm; steering_torque steering_cmd: steer steering_cmd
steering_torque steering_rate steering_pos: steer_angle steering_pos; MotorTorqueReq: throttle MotorTorqueReq
steering_angle_cmd steering_torque_cmd drive_torque_cmd brake_torque_cmd: throttle drive_torque_cmd
parking_brake brake_light brake_pedal: brake brake_pedal; brake_temp_fl brakePressed brake: brake brake
brake_psi yaw_deg: yaw yaw_deg, brake_pressure brake_psi; brake_pct brake_front_bar: brake_pressure brake_front_bar
park_brake_psi brake_line_psi: brake_pressure brake_line_psi; gyro_yaw yaw: yaw yaw, yaw_rate gyro_yaw
Engine_Speed Vehicle_Speed: engine_rpm Engine_Speed, wheel_speed Vehicle_Speed
rpm_fl rpm_fr rpm_rl rpm_rr: wheel_speed rpm_fl
head_mot head_veh imu_yaw lat: yaw head_veh; compass_deg cog_deg lat: yaw compass_deg; bearing lat: yaw bearing
is_wheel_spd_fl_valid wheel_spd_fl wheel_spd_fr wheel_spd_rl wheel_spd_rr: wheel_speed wheel_spd_fl
PN PE PD: position PE
GForceLat GForceLong latitude longitude: position latitude; v_lat v_lon a_lat lat lon: position lat
timestamp tx ty tz qx qy qz qw: position tx; tx ty tz lat lon: position lat; fx fy fz tx ty tz x y: position x
estimated_curvature commanded_curvature: steer commanded_curvature; APPS1 APPS2: throttle APPS1
DM.Steer.AngVel DM.Steer.Ang: steer_angle DM.Steer.Ang; handlebar tiller: steer handlebar; shift_cmd: gear shift_cmd
"""
"""Columns, and for each channel the one that is read."""


@pytest.mark.parametrize("case", re.split(r"[;\n]\s*", FIRST.strip()))
def test_the_most_informative_of_several_columns_comes_first(case: str) -> None:
    columns, wanted = case.split(": ")
    log = MemoryLog({"": (TIME, dict.fromkeys(columns.split(), ODOM["x"]))})
    for channel, first in (each.split() for each in wanted.split(", ")):
        assert next(guess.fields[0] for guess in guess_channels(log) if guess.channel == channel) == first


@pytest.mark.parametrize("asked", ["wheel_angle_setpoint", "desired_angle", "target"])
@pytest.mark.parametrize("others", ["seq rate_limit timeout_ms is_valid", "enable torque current"])
def test_limits_and_switches_do_not_hide_what_a_topic_commands(asked: str, others: str) -> None:
    """Nor do other quantities, of a field that says that it is asked for."""
    beside = dict.fromkeys(others.split(), "1")
    status = {"wheel_angle": "angle", "column_torque": "wy", "driver_override": "0"}
    log = log_of(
        {"/odom": POSE, "/dbw/steering_status": status, "/dbw/steering_command": {asked: "tire command"} | beside}
        | {f"/dbw/{pedal}_cmd": {"pedal_setpoint": pedal} | beside for pedal in ("throttle", "brake")}
    )
    channels = parse_rig(draft_rig(log), where="draft").channels
    assert {name: (channels[name].topic, channels[name].fields) for name in ("steer", "steer_angle")} == {
        "steer": ("/dbw/steering_command", (asked,)),
        "steer_angle": ("/dbw/steering_status", ("wheel_angle",)),
    }
    for pedal in ("throttle", "brake"):
        assert channels[pedal].topic == f"/dbw/{pedal}_cmd"


def test_half_of_a_pose_is_named() -> None:
    """A simulator's log may have the direction ahead as a vector."""
    columns = dict.fromkeys(("pos_x", "pos_y", "dir_x", "dir_y", "throttle"), ODOM["x"])
    with pytest.raises(LogError, match="pos_x, pos_y may be a position, and no name is that of a heading; it has: col"):
        draft_rig(MemoryLog({"": (TIME, columns)}))
    with pytest.raises(LogError, match=r"/imu \(yaw\) may be a heading, and no name is that of a position"):
        draft_rig(log_of({"/imu": {"yaw": "azimuth in rad", "temperature": "1"}} | COMMANDS))


@pytest.mark.parametrize(("rows", "what"), [(0, "the table has no rows"), (1, "the table has one row")])
def test_a_table_without_a_drive_is_said_to_have_none(rows: int, what: str) -> None:
    columns = dict.fromkeys(("x", "y", "yaw", "throttle"), ODOM["x"][:rows])
    with pytest.raises(LogError, match=f"{what}; a drive needs many"):
        draft_rig(MemoryLog({"": (TIME[:rows], columns)}))
    with pytest.raises(LogError, match=r"no topic has (a|more than one) message"):
        draft_rig(MemoryLog({"/odom": (TIME[:rows], columns), "/cmd": (TIME[:rows], columns)}))


def test_a_pose_in_the_earths_frame_comes_last_by_its_numbers() -> None:
    """As a rotated world far away, whose name says nothing."""
    more = POSE | {f"twist.twist.angular.{axis}": f"w{axis}" for axis in "xyz"}
    log: MemoryLog = log_of({"/ins/odometry": more, "/ins/local": POSE} | COMMANDS)
    for axis, far in (("x", 4.18e6), ("y", 0.86e6), ("z", 4.72e6)):
        log = log.change("/ins/odometry", f"pose.pose.position.{axis}", lambda values, far=far: values + far)
    assert parse_rig(draft_rig(log), where="draft").channels["position"].topic == "/ins/local"


@pytest.mark.parametrize("named", [("latitude", "longitude", "altitude"), ("position.x", "position.y", "position.z")])
@pytest.mark.parametrize("yaw", [False, True])
def test_an_ins_of_north_east_down_is_known_beside_latitude_and_longitude(named: tuple[str, ...], yaw: bool) -> None:
    """With places exchanged the heading fits as well, in a mirror, and all else but that is scaled to fit it."""
    fields = dict(zip(named, ("latitude", "longitude", "height"), strict=True))
    fields |= {"quaternion.x": "0", "quaternion.y": "0", "quaternion.z": "half azimuth sin",
               "quaternion.w": "half azimuth cos", "velocity.x": "north", "velocity.y": "east", "velocity.z": "sinking",
               "angularrate.x": "wx", "angularrate.y": "right", "angularrate.z": "clockwise"}  # fmt: skip
    fields |= {"yawpitchroll.x": "azimuth"} if yaw else {}
    log = log_of({"/ins": fields, **COMMANDS})
    inspection = inspect_log(log)
    assert Edit("motion.axes", "ned") in inspection.cure
    rig = edited(parse_rig(draft_rig(log), where="test"), inspection.cure)
    assert (rig.channels["position"].fields, rig.channels["position"].scale) == (named, 1.0)
    assert "yaw" not in rig.channels
    again = inspect_log(log, rig)
    assert {finding.severity for finding in again.findings} == {"note"}, again.findings
    drive, truth = drive_from_log(log, rig), ODOM
    driven = drive.channels["position"].values
    np.testing.assert_allclose(np.ptp(driven[:, 0]), np.ptp(truth["y"]), rtol=0.01)  # to the north
    np.testing.assert_allclose(np.ptp(driven[:, 1]), np.ptp(truth["x"]), rtol=0.01)  # and the west
