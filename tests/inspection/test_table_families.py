"""First rigs of tables as simulators, autopilots, receivers and loggers write them."""

from collections.abc import Mapping

import numpy as np
import pytest
from simulated import MemoryLog
from test_message_families import ODOM, QUANTITIES, TIME, cured

from offpiste.inspection.channel_guesses import guess_channels
from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.inspect import inspect_log
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import parse_rig

RNG = np.random.default_rng(0)
MORE: Mapping[str, np.ndarray] = {
    "latitude in rad": np.deg2rad(QUANTITIES["latitude"]),
    "longitude in rad": np.deg2rad(QUANTITIES["longitude"]),
    "azimuth in hundredths": np.round(100 * QUANTITIES["azimuth"]),
    "throttle in %": 100 * QUANTITIES["throttle"],
    "brake in %": 100 * QUANTITIES["brake"],
    "throttle in mV": 500 + 4000 * QUANTITIES["throttle"],
    "brake in mV": 400 + 3000 * QUANTITIES["brake"],
    "brake in bar": 60 * QUANTITIES["brake"],
    "brake in C": 300 + 50 * QUANTITIES["brake"],
    "steer to the right in %": -100 * QUANTITIES["steer"],
    "wheel in deg": np.rad2deg(QUANTITIES["wheel"]),
    "wx in deg/s": np.rad2deg(ODOM["wx"]),
    "wy in deg/s": np.rad2deg(ODOM["wy"]),
    "wz in deg/s": np.rad2deg(ODOM["wz"]),
    "g": 1 + 0.02 * RNG.standard_normal(len(TIME)),
}
PLACES = {"Latitude": "latitude", "Longitude": "longitude"}
PEDALS = {"throttle": "throttle", "brake": "brake", "steer": "steer"}
FAMILIES: Mapping[str, tuple[dict[str, str], dict[str, tuple[str, ...]]]] = {
    "nuScenes": (
        {"pos_0": "x", "pos_1": "y", "pos_2": "z", "orientation_0": "qw", "orientation_1": "qx", "orientation_2": "qy",
         "orientation_3": "qz", "vel_0": "vx", "vel_1": "vy", "vel_2": "vz", "rotation_rate_0": "wx",
         "rotation_rate_1": "wy", "rotation_rate_2": "wz"} | PEDALS,
        {"position": ("pos_0", "pos_1", "pos_2"),
         "orientation": ("orientation_1", "orientation_2", "orientation_3", "orientation_0"),
         "linear_velocity": ("vel_0", "vel_1", "vel_2"),
         "angular_velocity": ("rotation_rate_0", "rotation_rate_1", "rotation_rate_2")},
    ),
    "ulog2csv": (
        {"position[0]": "x", "position[1]": "y", "position[2]": "z", "q[0]": "qw", "q[1]": "qx", "q[2]": "qy",
         "q[3]": "qz", "velocity[0]": "east", "velocity[1]": "north", "velocity[2]": "0"} | PEDALS,
        {"orientation": ("q[1]", "q[2]", "q[3]", "q[0]"),
         "linear_velocity": ("velocity[0]", "velocity[1]", "velocity[2]")},
    ),
    "GLOBAL_POSITION_INT": (
        {"lat": "counted latitude", "lon": "counted longitude", "alt": "counted height", "hdg": "azimuth in hundredths",
         "servo1_raw": "steering pulse", "servo3_raw": "throttle pulse"},
        {"position": ("lat", "lon"), "yaw": ("hdg",), "throttle": ("servo3_raw",), "steer": ("servo1_raw",)},
    ),
    "radians": (
        {"latitude": "latitude in rad", "longitude": "longitude in rad", "height": "height", "heading": "azimuth"}
        | PEDALS,
        {"position": ("latitude", "longitude")},
    ),
    "radians in units": (
        {"Lat (rad)": "latitude in rad", "Lon (rad)": "longitude in rad", "HDG (deg)": "azimuth"} | PEDALS,
        {"position": ("Lat (rad)", "Lon (rad)"), "yaw": ("HDG (deg)",)},
    ),
    "JAUS": (
        PLACES
        | {"Yaw": "azimuth in rad", "PropulsiveLinearEffortX": "throttle in %", "ResistiveLinearEffortX": "brake in %",
           "PropulsiveRotationalEffortZ": "steer to the right in %"},
        {"throttle": ("PropulsiveLinearEffortX",), "brake": ("ResistiveLinearEffortX",),
         "steer": ("PropulsiveRotationalEffortZ",)},
    ),
    "MoTeC": (
        PLACES
        | {"Heading": "azimuth", "Throttle Pos [%]": "throttle in %", "Brake Pressure Front [bar]": "brake in bar",
           "Brake Temp FL [C]": "brake in C", "Steered Angle [deg]": "wheel in deg"},
        {"brake": ("Brake Pressure Front [bar]",), "steer": ("Steered Angle [deg]",)},
    ),
    "CANape": (
        PLACES
        | {"Heading": "azimuth", "AccPdl [%]": "throttle in %", "BrkPrs [bar]": "brake in bar",
           "StrWhlAng [deg]": "wheel in deg", "VehSpd [m/s]": "vx"},
        {"throttle": ("AccPdl [%]",), "brake": ("BrkPrs [bar]",), "steer": ("StrWhlAng [deg]",),
         "wheel_speed": ("VehSpd [m/s]",)},
    ),
    "Volkswagen": (
        PLACES
        | {"Heading": "azimuth", "MO_Fahrpedalrohwert_01 [%]": "throttle in %", "ESP_Bremsdruck [bar]": "brake in bar",
           "LWI_VZ_Lenkradwinkel": "g", "LWI_Lenkradwinkel [deg]": "wheel in deg"},
        {"throttle": ("MO_Fahrpedalrohwert_01 [%]",), "brake": ("ESP_Bremsdruck [bar]",),
         "steer": ("LWI_Lenkradwinkel [deg]",)},
    ),
    "Torque": (
        PLACES
        | {"Bearing": "azimuth", "G(x)": "g", "G(y)": "g", "G(z)": "g", "Brake(%)": "brake in %",
           "Accelerator PedalPosition D(%)": "throttle in %", "Steering(deg)": "wheel in deg"},
        {"position": ("Latitude", "Longitude"), "throttle": ("Accelerator PedalPosition D(%)",)},
    ),
    "openpilot": (
        {
            "liveLocationKalman.positionECEF.value[0]": "x", "liveLocationKalman.positionECEF.value[1]": "y",
            "liveLocationKalman.positionECEF.value[2]": "0",
            "liveLocationKalman.positionGeodetic.value[0]": "latitude",
            "liveLocationKalman.positionGeodetic.value[1]": "longitude",
            "liveLocationKalman.positionGeodetic.value[2]": "height",
            "liveLocationKalman.velocityNED.value[0]": "north", "liveLocationKalman.velocityNED.value[1]": "east",
            "liveLocationKalman.velocityNED.value[2]": "0", "liveLocationKalman.orientationNED.value[0]": "0",
            "liveLocationKalman.orientationNED.value[1]": "0", "liveLocationKalman.orientationNED.value[2]": "0",
            "liveLocationKalman.calibratedOrientationNED.value[0]": "0",
            "liveLocationKalman.calibratedOrientationNED.value[1]": "0",
            "liveLocationKalman.calibratedOrientationNED.value[2]": "azimuth in rad",
            "carState.steeringAngleDeg": "wheel in deg", "carState.gas": "throttle", "carState.brake": "brake",
        },
        {
            "position": tuple(f"liveLocationKalman.positionGeodetic.value[{k}]" for k in range(3)),
            "yaw": ("liveLocationKalman.calibratedOrientationNED.value[2]",),
            "linear_velocity": ("liveLocationKalman.velocityNED.value[1]", "liveLocationKalman.velocityNED.value[0]"),
            "throttle": ("carState.gas",), "brake": ("carState.brake",), "steer": ("carState.steeringAngleDeg",),
        },
    ),
    "north, east, down": (
        {"pos_n": "y", "pos_e": "x", "pos_d": "down", "heading": "azimuth in rad"} | PEDALS,
        {"position": ("pos_n", "pos_e", "pos_d"), "yaw": ("heading",)},
    ),
    "q0": (
        {"x": "x", "y": "y", "z": "z", "att.q0": "qw", "att.q1": "qx", "att.q2": "qy", "att.q3": "qz",
         "Gyro Yaw Velocity [deg/s]": "wz in deg/s", "GPS Speed": "vx", "brk_bar": "brake in bar"} | PEDALS,
        {"orientation": ("att.q1", "att.q2", "att.q3", "att.q0"), "yaw_rate": ("Gyro Yaw Velocity [deg/s]",)},
    ),
    "EuRoC": (
        {f"p_RS_R_{axis} [m]": axis for axis in "xyz"} | {f"q_RS_{axis} []": f"q{axis}" for axis in "wxyz"}
        | {"v_RS_R_x [m s^-1]": "east", "v_RS_R_y [m s^-1]": "north", "v_RS_R_z [m s^-1]": "vz"}
        | {f"b_w_RS_S_{axis} [rad s^-1]": "1" for axis in "xyz"} | {f"w_RS_S_{a} [rad s^-1]": f"w{a}" for a in "xyz"}
        | PEDALS,
        {"position": ("p_RS_R_x [m]", "p_RS_R_y [m]", "p_RS_R_z [m]"),
         "orientation": ("q_RS_x []", "q_RS_y []", "q_RS_z []", "q_RS_w []"),
         "linear_velocity": ("v_RS_R_x [m s^-1]", "v_RS_R_y [m s^-1]", "v_RS_R_z [m s^-1]"),
         "angular_velocity": ("w_RS_S_x [rad s^-1]", "w_RS_S_y [rad s^-1]", "w_RS_S_z [rad s^-1]")},
    ),
    "RaceChrono": (
        PLACES
        | {"bearing": "azimuth", "x_rate_of_rotation": "wx in deg/s", "y_rate_of_rotation": "wy in deg/s",
           "z_rate_of_rotation": "wz in deg/s", "accelerator_pos": "throttle in %", "brake_pos": "brake in %",
           "steering_angle": "wheel in deg"},
        {"position": ("Latitude", "Longitude"),
         "angular_velocity": ("x_rate_of_rotation", "y_rate_of_rotation", "z_rate_of_rotation")},
    ),
    "ArduPilot": (
        PLACES | {"DesYaw": "0", "Yaw": "azimuth", "DesYawRate": "0", "YawRate": "wz"} | PEDALS,
        {"yaw": ("Yaw",), "yaw_rate": ("YawRate",)},
    ),
    "pedals as potentiometers": (
        PLACES | {"Heading": "azimuth", "APPS_mV": "throttle in mV", "bps_front": "brake in mV",
                  "bps_rear": "brake in mV", "steer": "steer"},
        {"throttle": ("APPS_mV",), "brake": ("bps_front",)},
    ),
    "French": (
        PLACES | {"Cap": "azimuth", "Heading": "azimuth", "Vitesse": "vx", "Angle volant [°]": "wheel in deg",
                  "Accélérateur %": "throttle in %", "Frein %": "brake in %", "Vitesse de lacet": "wz"},
        {"wheel_speed": ("Vitesse",), "steer": ("Angle volant [°]",), "throttle": ("Accélérateur %",),
         "brake": ("Frein %",), "yaw_rate": ("Vitesse de lacet",)},
    ),
    "Japanese": (
        {"緯度": "latitude", "経度": "longitude", "方位": "azimuth", "車速": "vx", "ハンドル角[deg]": "wheel in deg",
         "アクセル開度[%]": "throttle in %", "ブレーキ圧[bar]": "brake in bar", "ブレーキ温度": "brake in C",
         "ヨーレート": "wz"},
        {"position": ("緯度", "経度"), "yaw": ("方位",), "wheel_speed": ("車速",), "steer": ("ハンドル角[deg]",),
         "throttle": ("アクセル開度[%]",), "brake": ("ブレーキ圧[bar]",), "yaw_rate": ("ヨーレート",)},
    ),
}  # fmt: skip


def table(columns: Mapping[str, str]) -> MemoryLog:
    return MemoryLog({"": (TIME, {name: (MORE | QUANTITIES)[quantity] for name, quantity in columns.items()})})


@pytest.mark.parametrize("name", FAMILIES)
def test_channels_are_found_in_a_table_of(name: str) -> None:
    columns, expected = FAMILIES[name]
    log = table(columns)
    rig = parse_rig(draft_rig(log), where="draft")
    assert {channel: rig.channels[channel].fields for channel in expected} == expected
    assert cured(log, rig) == []


@pytest.mark.parametrize(
    ("asked", "measured"),
    [
        ("SetSteerAngle", "ActualSteerAngle"),
        ("steering_angle_request", "steering_angle"),
        ("target_steering_angle", "current_steering_angle"),
        ("steer_cmd", "measured_steer"),
    ],
)
def test_what_is_set_and_what_is_measured_of_a_steering(asked: str, measured: str) -> None:
    log = table({"x": "x", "y": "y", "yaw": "0"} | {asked: "tire command", measured: "angle"})
    yaw = 2 * np.arctan2(ODOM["qz"], ODOM["qw"])
    channels = parse_rig(draft_rig(log.change("", "yaw", lambda values: yaw)), where="draft").channels
    assert (channels["steer"].fields, channels["steer_angle"].fields) == ((asked,), (measured,))


@pytest.mark.parametrize(("quantity", "drafted"), [("letter", True), ("azimuth", False)])
def test_a_direction_is_a_gear_where_it_has_few_values(quantity: str, drafted: bool) -> None:
    columns = PLACES | PEDALS | {"heading": "azimuth", "MachineDirection": quantity}
    values = MORE | QUANTITIES | {"letter": np.where(np.arange(len(TIME)) < 900, 68.0, 78.0)}
    log = MemoryLog({"": (TIME, {name: values[of] for name, of in columns.items()})})
    rig = parse_rig(draft_rig(log), where="draft")
    assert ("gear" in rig.channels) == drafted
    if drafted:
        assert rig.channels["gear"].values == {"P": 0, "R": -1, "N": 0, "D": 1}


@pytest.mark.parametrize(("name", "scale"), [("CurvatureCommand_1pkm", 1000), ("commanded_curvature", 1)])
def test_a_curvature_that_is_commanded_is_no_angle_of_a_steering_wheel(name: str, scale: float) -> None:
    """It is scaled by its largest value, whose angle is `max_steer`, as small as it may be."""
    curvature = 0.15 * scale * QUANTITIES["steer"]
    columns = {name: (MORE | QUANTITIES)[of] for name, of in (PLACES | {"heading": "azimuth"}).items()}
    columns |= {"throttle": QUANTITIES["throttle"], "brake": QUANTITIES["brake"], name: curvature}
    text = draft_rig(MemoryLog({"": (TIME, columns)}))
    (line,) = (line for line in text.splitlines() if line.startswith("[channels.steer]"))
    assert "a curvature, max_steer is the angle of the road wheels that it asks for" in line
    source = parse_rig(text, where="draft").channels["steer"]
    assert source.scale * np.abs(curvature).max() == pytest.approx(1, rel=0.02)


def test_what_a_receiver_measures_is_no_wheels_speed() -> None:
    guesses = {guess.channel: guess for guess in guess_channels(table(FAMILIES["q0"][0]))}
    assert "wheel_speed" not in guesses


@pytest.mark.parametrize(
    ("name", "turned", "drafted"), [("Accel", 0, True), ("Accel", 30, False), ("accel_mps2", 0, False)]
)
def test_what_is_called_accel_is_a_pedal_where_it_is_never_below_zero(name: str, turned: float, drafted: bool) -> None:
    """As of Forza, whose pedals go from 0 to 255, and of tables whose acceleration is called so."""
    log = table({"x": "x", "y": "y", "yaw": "0", name: "throttle", "Brake": "brake", "Steer": "tire command"})
    yaw = 2 * np.arctan2(ODOM["qz"], ODOM["qw"])
    log = log.change("", "yaw", lambda values: yaw).change("", name, lambda values: 255 * values - turned)
    text = draft_rig(log)
    assert (f'fields = ["{name}"]' in text) == drafted, text
    assert not drafted or parse_rig(text, where="draft").channels["throttle"].scale == pytest.approx(1 / 255, rel=1e-3)


def test_a_pressure_is_not_read_as_a_percentage() -> None:
    """A pedal that was never fully pressed: 60 bar are no 60 %."""
    columns = {
        "x": "x",
        "y": "y",
        "yaw": "azimuth in rad",
        "gas": "throttle",
        "brk_bar": "brake in bar",
        "steer": "steer",
    }
    source = parse_rig(draft_rig(table(columns)), where="draft").channels["brake"]
    assert source.unit != "percent"
    assert source.scale * 60 * QUANTITIES["brake"].max() == pytest.approx(1, rel=0.01)


def test_a_potentiometer_at_rest_is_a_pedal_that_is_released() -> None:
    channels = parse_rig(draft_rig(table(FAMILIES["pedals as potentiometers"][0])), where="draft").channels
    for channel, rest, reach in (("throttle", 500, 4000), ("brake", 400, 3000)):
        source = channels[channel]
        assert source.scale * rest + source.offset == pytest.approx(0, abs=0.01)
        pressed = reach * QUANTITIES[channel].max() + rest
        assert source.scale * pressed + source.offset == pytest.approx(1, abs=0.02)


def test_the_pedal_of_an_aim_logger_is_found() -> None:
    columns = {name: quantity for name, quantity in PEDALS.items() if quantity != "throttle"}
    text = draft_rig(table({"x": "x", "y": "y", "yaw": "azimuth in rad", "PPS": "throttle"} | columns))
    assert parse_rig(text, where="draft").channels["throttle"].fields == ("PPS",)


def test_a_world_of_north_east_down_that_is_read_as_up_is_said_to_be() -> None:
    columns, _ = FAMILIES["north, east, down"]
    log = table(columns)
    rig = parse_rig(draft_rig(log), where="draft")
    assert rig.motion.axes == "ned"
    up = edited(rig, [Edit("motion.axes", None)])
    (finding,) = (f for f in inspect_log(log, up).findings if f.where == "position" and f.severity == "warning")
    assert finding.what == "its third field is named down, and is read as up"
    assert edited(up, finding.cures[0]) == rig


@pytest.mark.parametrize(
    ("prefix", "down"),
    [("vehicle_local_position.", True), ("vehicle_odometry_0/position/", True), ("vehicle_odometry/pose/pose/", False),
     ("positionNED.", True), ("planned_position.", False)],
)  # fmt: skip
def test_a_pose_of_px4_or_one_that_is_named_so_points_down(prefix: str, down: bool) -> None:
    columns = {f"{prefix}{axis}": of for axis, of in zip("xyz", ("y", "x", "z"), strict=True)}
    text = draft_rig(table(columns | {"heading": "azimuth in rad"} | PEDALS))
    assert (parse_rig(text, where="draft").motion.axes == "ned") == down


@pytest.mark.parametrize("name", ["cog", "GPS Heading", "Course Angle", "course over ground"])
def test_a_course_over_ground_is_said_to_be_no_heading(name: str) -> None:
    columns = {"x": "x", "y": "y", name: "azimuth in rad"} | PEDALS
    log = table(columns)
    found = inspect_log(log, parse_rig(draft_rig(log), where="draft")).findings
    (note,) = (f for f in found if f.what.startswith("is a course over ground"))
    assert (note.severity, note.where) == ("note", "yaw")


def test_places_in_radians_are_said_to_be() -> None:
    columns, _ = FAMILIES["radians"]
    text = draft_rig(table(columns)).replace("scale = 57.2957795131\n", "")
    found = {f.what for f in inspect_log(table(columns), parse_rig(text, where="draft")).findings if "lat" in f.where}
    assert found == {"is in radians"}


@pytest.mark.parametrize(
    ("heading", "fields"), [("yaw", ["pos_x", "pos_z", "pos_y"]), ("azimuth", ["pos_z", "pos_x", "pos_y"])]
)
def test_a_world_whose_y_is_up_is_turned_as_its_heading_is(heading: str, fields: list[str]) -> None:
    """As of games: of two readings, one needs no edits of the heading."""
    yaw = {"yaw": 2 * np.arctan2(ODOM["qz"], ODOM["qw"]), "azimuth": np.deg2rad(QUANTITIES["azimuth"])}
    columns = {"pos_x": ODOM["x"], "pos_y": ODOM["z"], "pos_z": ODOM["y"], "yaw": yaw[heading]}
    log = MemoryLog({"": (TIME, columns | {name: QUANTITIES[name] for name in PEDALS})})
    rig = parse_rig(draft_rig(log), where="draft")
    inspection = inspect_log(log, rig)
    fatal = next(f for f in inspection.findings if f.severity == "fatal")
    assert fatal.what == "climbs as much as it drives"
    assert inspection.cure[0].value == fields
    assert cured(log, rig) == []


def test_a_world_of_unity_is_read_with_the_angle_about_its_y() -> None:
    yaw = np.degrees(2 * np.arctan2(ODOM["qz"], ODOM["qw"]))
    pose = {"position.x": ODOM["y"], "position.y": 0.2 * ODOM["z"], "position.z": ODOM["x"]}
    angles = {"eulerAngles.x": 0.1 * yaw, "eulerAngles.y": yaw % 360, "eulerAngles.z": 0.05 * yaw[::-1]}
    velocity = {"velocity.x": QUANTITIES["north"], "velocity.y": 0 * yaw, "velocity.z": QUANTITIES["east"]}
    log = MemoryLog({"": (TIME, pose | angles | velocity | {name: QUANTITIES[name] for name in PEDALS})})
    rig = parse_rig(draft_rig(log), where="draft")
    cured_rig = edited(rig, inspect_log(log, rig).cure)
    assert cured_rig.channels["position"].fields == ("position.z", "position.x", "position.y")
    assert cured_rig.channels["yaw"].fields == ("eulerAngles.y",)
    assert cured_rig.channels["linear_velocity"].fields == ("velocity.z", "velocity.x", "velocity.y")
    assert cured(log, rig) == []


def test_metres_from_the_middle_of_the_earth_are_no_world() -> None:
    """48 north, 11 east; a northing of 57 degrees is as far from its origin, and is none of it."""
    up, east, north = np.array([0.657, 0.128, 0.743]), np.array([-0.191, 0.982, 0.0]), np.array([-0.73, -0.142, 0.669])
    places = 6.37e6 * up + ODOM["x"][:, None] * east + ODOM["y"][:, None] * north
    pedals = {name: QUANTITIES[name] for name in PEDALS}
    yaw = {"yaw": 2 * np.arctan2(ODOM["qz"], ODOM["qw"])}
    log = MemoryLog({"": (TIME, dict(zip(("x", "y", "z"), places.T, strict=True)) | yaw | pedals)})
    found = inspect_log(log, parse_rig(draft_rig(log), where="draft")).findings
    assert "is in the earth's own frame (ECEF), whose z is not up" in {f.what for f in found if f.severity == "fatal"}
    utm = MemoryLog({"": (TIME, {"x": 5e5 + ODOM["x"], "y": 6.36e6 + ODOM["y"], "z": ODOM["z"] + 90} | yaw | pedals)})
    rig = parse_rig(draft_rig(utm), where="draft")
    assert [f.what for f in inspect_log(utm, rig).findings if f.severity == "fatal"] == []


@pytest.mark.parametrize(("unit", "scale"), [("m", 1.0), ("cm", 0.01)])
def test_a_world_of_unreal_is_turned_so_that_left_is_left(unit: str, scale: float) -> None:
    """Its y is to the right, its yaw counts clockwise, and all else is seen in the same mirror."""
    yaw = 2 * np.arctan2(ODOM["qz"], ODOM["qw"])
    world = {
        "x": (ODOM["x"], QUANTITIES["east"]),
        "y": (-ODOM["y"], -QUANTITIES["north"]),
        "z": (ODOM["z"], ODOM["vz"]),
    }
    columns = {f"location.{axis}": place / scale for axis, (place, _) in world.items()}
    columns |= {f"velocity.{axis}": velocity / scale for axis, (_, velocity) in world.items()}
    columns |= {"rotation.yaw": np.degrees(-yaw), "throttle": QUANTITIES["throttle"], "brake": QUANTITIES["brake"]}
    log = MemoryLog({"": (TIME, columns | {"steer": -QUANTITIES["steer"]})})
    rig = parse_rig(draft_rig(log), where="draft")
    inspection = inspect_log(log, rig)
    assert "the world is seen in a mirror" in {f.what for f in inspection.findings}
    rig = edited(rig, inspection.cure)
    channels = rig.channels
    assert channels["position"].unit == (unit if unit != "m" else "")
    assert channels["position"].fields[:2] == ("location.y", "location.x")
    assert (channels["yaw"].sign, channels["yaw"].offset, channels["steer"].sign) == (-1, -90.0, -1)
    velocity = channels["linear_velocity"]
    assert (velocity.frame, velocity.fields[:2], velocity.scale) == ("world", ("velocity.y", "velocity.x"), scale)
    assert rig.vehicle.max_steer == pytest.approx(0.33, abs=0.03)
    assert [f.what for f in inspect_log(log, rig).findings if f.severity != "note"] == []


def test_a_location_beside_a_plain_yaw_may_be_of_a_world_of_unreal() -> None:
    yaw = 2 * np.arctan2(ODOM["qz"], ODOM["qw"])
    columns = {"location_x": ODOM["x"], "location_y": -ODOM["y"], "location_z": ODOM["z"], "yaw": np.degrees(-yaw)}
    log = MemoryLog({"": (TIME, columns | {name: QUANTITIES[name] for name in ("throttle", "brake", "steer")})})
    found = inspect_log(log, parse_rig(draft_rig(log), where="draft")).findings
    (finding,) = (f for f in found if "mirror" in f.what)
    assert (finding.severity, finding.cures) == ("note", ())
    assert 'channels.position.fields = ["location_y", "location_x", "location_z"]' in finding.remedy


@pytest.mark.parametrize(
    "columns",
    [
        "pos[0] pos[1] pos[2] pos[3]",
        "joint_pos_0 joint_pos_1",
        "motor_vel_0 motor_vel_1",
        "pos_0 pos_2",
    ],
)
def test_arrays_that_are_no_vector(columns: str) -> None:
    log = MemoryLog({"": (TIME, dict.fromkeys(columns.split(), ODOM["x"]))})
    assert list(guess_channels(log)) == []


@pytest.mark.parametrize(
    ("name", "idle", "other"), [("throttle", 30.0, 0.0), ("brake_pressure", 2.0, 0.0), ("steering_pwm", 1500.0, 7500.0)]
)
def test_a_control_that_is_still_but_for_a_sample_ends_in_findings(name: str, idle: float, other: float) -> None:
    columns = {"x": ODOM["x"], "y": ODOM["y"], "yaw": QUANTITIES["azimuth in rad"]}
    columns |= {pedal: QUANTITIES[pedal] for pedal in PEDALS if pedal not in name and name != "steering_pwm"}
    columns[name] = np.where(np.arange(len(TIME)) == 0, other, idle)
    log = MemoryLog({"": (TIME, columns)})
    assert inspect_log(log, parse_rig(draft_rig(log), where="draft")).findings


@pytest.mark.parametrize("shown", ["minutes", "degrees and minutes"])
def test_places_that_are_no_degrees_are_said_so_once(shown: str) -> None:
    """Minutes of arc, as in .vbo files, and ddmm.mmmm, as in sentences of NMEA."""
    columns, _ = FAMILIES["radians"]
    values = {name: (MORE | QUANTITIES)[of] for name, of in columns.items()}
    for name in ("latitude", "longitude"):
        degrees = QUANTITIES[name]
        values[name] = 60 * degrees if shown == "minutes" else 100 * np.floor(degrees) + 60 * (degrees % 1)
    fatal = [f for f in inspect_log(MemoryLog({"": (TIME, values)})).findings if f.severity != "note"]
    assert [(f.where, f.what) for f in fatal] == [("position (latitude), position (longitude)", "is not in degrees")]
    assert "convert to degrees" in fatal[0].remedy
