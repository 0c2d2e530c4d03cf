"""First rigs of logs as drivers, stacks, simulators, autopilots and loggers write them."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from loggers import (
    COMMANDS,
    LOGGERS,
    ODOM,
    PEDALS,
    POSE,
    QUANTITIES,
    TIME,
    YAW,
    assert_drafted,
    cured,
    drafted,
    log_of,
    logger,
)
from simulated import MemoryLog

from offpiste.core.errors import LogError
from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.naming import guess_channels
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import Edit, edited


@pytest.mark.parametrize("name", LOGGERS)
def test_channels_are_found_in_logs_of(name: str) -> None:
    log = logger(name)
    rig = drafted(log)
    assert_drafted(rig, LOGGERS[name]["channels"])
    assert cured(log, rig) == []


NAMES = tomllib.loads(Path(__file__).with_name("names.toml").read_text("utf-8"))


@pytest.mark.parametrize("columns", NAMES)
def test_the_most_informative_of_several_columns_comes_first(columns: str) -> None:
    guesses = guess_channels(MemoryLog({"": (TIME, dict.fromkeys(columns.split(), ODOM["x"]))}))
    for channel, first in NAMES[columns].items():
        assert next(guess.fields[0] for guess in guesses if guess.channel == channel) == first


@pytest.mark.parametrize("asked", ["wheel_angle_setpoint", "desired_angle", "target"])
@pytest.mark.parametrize("others", ["seq rate_limit timeout_ms is_valid", "enable torque current"])
def test_limits_and_switches_do_not_hide_what_a_topic_commands(asked: str, others: str) -> None:
    """Nor do other quantities, of a field that says that it is asked for."""
    beside = dict.fromkeys(others.split(), "1")
    status = {"wheel_angle": "angle", "column_torque": "wy", "driver_override": "0"}
    log = log_of(
        {"/odom": POSE, "/dbw/steering_status": status, "/dbw/steering_command": {asked: "0.4 steer"} | beside}
        | {f"/dbw/{pedal}_cmd": {"pedal_setpoint": pedal} | beside for pedal in ("throttle", "brake")}
    )
    channels = drafted(log).channels
    assert {name: (channels[name].topic, channels[name].fields) for name in ("steer", "steer_angle")} == {
        "steer": ("/dbw/steering_command", (asked,)),
        "steer_angle": ("/dbw/steering_status", ("wheel_angle",)),
    }
    for pedal in ("throttle", "brake"):
        assert channels[pedal].topic == f"/dbw/{pedal}_cmd"


def test_half_of_a_pose_is_named() -> None:
    """A simulator's log may have the direction ahead as a vector."""
    columns = dict.fromkeys(("pos_x", "pos_y", "dir_x", "dir_y", "throttle"), ODOM["x"])
    with pytest.raises(
        LogError, match="pos_x, pos_y may be a position, and no name is that of a heading; available: col"
    ):
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
    assert drafted(log).channels["position"].topic == "/ins/local"


@pytest.mark.parametrize("named", [("latitude", "longitude", "altitude"), ("position.x", "position.y", "position.z")])
@pytest.mark.parametrize("yaw", [False, True])
def test_an_ins_of_north_east_down_is_known_beside_latitude_and_longitude(named: tuple[str, ...], yaw: bool) -> None:
    """With places exchanged the heading fits as well, in a mirror, and all else but that is scaled to fit it."""
    fields = dict(zip(named, ("latitude", "longitude", "height"), strict=True))
    fields |= {"quaternion.x": "0", "quaternion.y": "0", "quaternion.z": "half azimuth sin",
               "quaternion.w": "half azimuth cos", "velocity.x": "north", "velocity.y": "east", "velocity.z": "-1 vz",
               "angularrate.x": "wx", "angularrate.y": "-1 wy", "angularrate.z": "-1 wz"}  # fmt: skip
    fields |= {"yawpitchroll.x": "azimuth"} if yaw else {}
    log = log_of({"/ins": fields, **COMMANDS})
    inspection = inspect_log(log)
    assert Edit("motion.axes", "ned") in inspection.cure
    rig = edited(drafted(log), inspection.cure)
    assert (rig.channels["position"].fields, rig.channels["position"].scale) == (named, 1.0)
    assert "yaw" not in rig.channels
    again = inspect_log(log, rig)
    assert {finding.severity for finding in again.findings} == {"note"}, again.findings
    drive, truth = drive_from_log(log, rig), ODOM
    driven = drive.channels["position"].values
    np.testing.assert_allclose(np.ptp(driven[:, 0]), np.ptp(truth["y"]), rtol=0.01)  # to the north
    np.testing.assert_allclose(np.ptp(driven[:, 1]), np.ptp(truth["x"]), rtol=0.01)  # and the west


def test_a_world_of_north_east_down_that_is_read_as_up_is_said_to_be() -> None:
    log = logger("north, east, down")
    rig = drafted(log)
    assert rig.motion.axes == "ned"
    up = edited(rig, [Edit("motion.axes", None)])
    (finding,) = (f for f in inspect_log(log, up).findings if f.where == "position" and f.severity == "warning")
    assert finding.what == "its third field is named down but read as up"
    assert edited(up, finding.cures[0]) == rig


@pytest.mark.parametrize(
    ("heading", "fields"), [("yaw", ["pos_x", "pos_z", "pos_y"]), ("azimuth", ["pos_z", "pos_x", "pos_y"])]
)
def test_a_world_whose_y_is_up_is_turned_as_its_heading_is(heading: str, fields: list[str]) -> None:
    """As of games: of two readings, one needs no edits of the heading."""
    yaw = {"yaw": YAW, "azimuth": QUANTITIES["azimuth in rad"]}
    columns = {"pos_x": ODOM["x"], "pos_y": ODOM["z"], "pos_z": ODOM["y"], "yaw": yaw[heading]}
    log = MemoryLog({"": (TIME, columns | {name: QUANTITIES[name] for name in PEDALS})})
    rig = drafted(log)
    inspection = inspect_log(log, rig)
    fatal = next(f for f in inspection.findings if f.severity == "fatal")
    assert fatal.what == "climbs as much as it drives"
    assert inspection.cure[0].value == fields
    assert cured(log, rig) == []


def test_metres_from_the_middle_of_the_earth_are_no_world() -> None:
    """48 north, 11 east; a northing of 57 degrees is as far from its origin, and is none of it."""
    up, east, north = np.array([0.657, 0.128, 0.743]), np.array([-0.191, 0.982, 0.0]), np.array([-0.73, -0.142, 0.669])
    places = 6.37e6 * up + ODOM["x"][:, None] * east + ODOM["y"][:, None] * north
    pedals = {name: QUANTITIES[name] for name in PEDALS}
    yaw = {"yaw": YAW}
    log = MemoryLog({"": (TIME, dict(zip(("x", "y", "z"), places.T, strict=True)) | yaw | pedals)})
    found = inspect_log(log, drafted(log)).findings
    assert "is in the earth's own frame (ECEF), whose z is not up" in {f.what for f in found if f.severity == "fatal"}
    utm = MemoryLog({"": (TIME, {"x": 5e5 + ODOM["x"], "y": 6.36e6 + ODOM["y"], "z": ODOM["z"] + 90} | yaw | pedals)})
    rig = drafted(utm)
    assert [f.what for f in inspect_log(utm, rig).findings if f.severity == "fatal"] == []


@pytest.mark.parametrize("shown", ["minutes", "degrees and minutes"])
def test_places_that_are_no_degrees_are_said_so_once(shown: str) -> None:
    """Minutes of arc, as in .vbo files, and ddmm.mmmm, as in sentences of NMEA."""
    values = dict(logger("radians").data[""][1])
    for name in ("latitude", "longitude"):
        degrees = QUANTITIES[name]
        values[name] = 60 * degrees if shown == "minutes" else 100 * np.floor(degrees) + 60 * (degrees % 1)
    fatal = [f for f in inspect_log(MemoryLog({"": (TIME, values)})).findings if f.severity != "note"]
    assert [(f.where, f.what) for f in fatal] == [("position (latitude), position (longitude)", "is not in degrees")]
    assert "convert to degrees" in fatal[0].remedy
