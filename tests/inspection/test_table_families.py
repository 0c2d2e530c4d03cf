"""First rigs of tables as simulators, autopilots, receivers and loggers write them."""

from collections.abc import Mapping

import numpy as np
import pytest
from simulated import MemoryLog
from test_message_families import ODOM, QUANTITIES, TIME, cured

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
    "brake in bar": 60 * QUANTITIES["brake"],
    "brake in C": 300 + 50 * QUANTITIES["brake"],
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
    "MoTeC": (
        PLACES
        | {"Heading": "azimuth", "Throttle Pos [%]": "throttle in %", "Brake Pressure Front [bar]": "brake in bar",
           "Brake Temp FL [C]": "brake in C", "Steered Angle [deg]": "wheel in deg"},
        {"brake": ("Brake Pressure Front [bar]",), "steer": ("Steered Angle [deg]",)},
    ),
    "Volkswagen": (
        PLACES
        | {"Heading": "azimuth", "MO_Fahrpedalrohwert_01 [%]": "throttle in %", "ESP_Bremsdruck [bar]": "brake in bar",
           "LWI_VZ_Lenkradwinkel": "g", "LWI_Lenkradwinkel [deg]": "wheel in deg"},
        {"throttle": ("MO_Fahrpedalrohwert_01 [%]",), "brake": ("ESP_Bremsdruck [bar]",),
         "steer": ("LWI_Lenkradwinkel [deg]",)},
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
