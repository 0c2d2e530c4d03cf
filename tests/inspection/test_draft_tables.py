"""First rigs of tables that nobody has seen: headers with units, short names, signed pedals, steering angles."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loggers import assert_drafted

from offpiste.core.errors import LogError
from offpiste.inspection.draft_pose import pose_cure
from offpiste.inspection.draft_rig import draft_rig
from offpiste.inspection.draft_sensors import missing
from offpiste.inspection.draft_values import check_draft_values
from offpiste.inspection.inspect import inspect_log
from offpiste.logs import open_log
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import Rig, load_rig, parse_rig

WHEELBASE, WIDEST = 1.8, 0.35
"""Of the vehicle that is driven here [m, rad]."""


def driven(seconds: float = 40.0) -> dict[str, np.ndarray]:
    """A bicycle, 20 samples a second: time, pose, velocities, angle of the wheels, pedals below and above zero."""
    t = np.arange(0, seconds, 0.05)
    speed = 4 + 1.5 * np.sin(t / 3)
    angle = WIDEST * np.sin(t / 1.7)
    yaw_rate = speed * np.tan(angle) / WHEELBASE
    yaw = 0.4 + np.cumsum(yaw_rate) * 0.05
    x, y = np.cumsum(speed * np.cos(yaw)) * 0.05, np.cumsum(speed * np.sin(yaw)) * 0.05
    pedal = np.clip(0.9 * np.cos(t / 3), -0.6, 0.8)
    return {
        "t": t, "x": x, "y": y, "yaw": np.arctan2(np.sin(yaw), np.cos(yaw)), "speed": speed, "zero": 0 * t + 0.001 * x,
        "yaw_rate": yaw_rate, "angle": angle, "pedal": pedal, "throttle": np.maximum(pedal, 0),
        "brake": np.maximum(-pedal, 0), "compass": (90 - np.degrees(yaw)) % 360,
    }  # fmt: skip


DRIVEN = driven()
Columns = Mapping[str, tuple[str, float]]
"""Headers, and of which quantity they are, times what."""


def written(path: Path, columns: Columns, *, separator: str = ",", below: str = "", mark: str = "") -> Path:
    """A table of the drive."""
    values = np.stack([DRIVEN[name] * factor for name, factor in columns.values()], axis=1)
    rows = [separator.join(f"{value:.6f}" for value in row) for row in values]
    path.write_text(mark + "\n".join([separator.join(columns), *([below] if below else []), *rows]) + "\n", "utf-8")
    return path


def drafted(path: Path) -> Rig:
    return parse_rig(draft_rig(open_log(path)), where="draft")


DEG = 180 / np.pi
POSE: Columns = {"t": ("t", 1), "x": ("x", 1), "y": ("y", 1), "yaw": ("yaw", 1)}
TABLES: Mapping[str, dict[str, Any]] = tomllib.loads(Path(__file__).with_name("headers.toml").read_text("utf-8"))


@pytest.mark.parametrize("name", TABLES)
def test_names_and_units_are_read(tmp_path: Path, name: str) -> None:
    columns, wanted = TABLES[name]["columns"], TABLES[name]["channels"]
    path = written(tmp_path / "drive.csv", columns)
    rig = drafted(path)
    assert_drafted(rig, wanted)
    # Read as drafted, every channel is what was driven.
    drive = drive_from_log(open_log(path, clock=rig.clock), rig)
    truth = {
        "position": np.column_stack((DRIVEN["x"], DRIVEN["y"])), "yaw": DRIVEN["yaw"][:, None],
        "yaw_rate": DRIVEN["yaw_rate"][:, None], "throttle": DRIVEN["throttle"][:, None],
        "brake": DRIVEN["brake"][:, None], "steer_angle": DRIVEN["angle"][:, None],
        "steer": DRIVEN["angle"][:, None] / rig.vehicle.max_steer,
    }  # fmt: skip
    for channel in truth.keys() & rig.channels.keys():
        if channel == "steer" and "steering" in columns:
            continue
        values = drive.channels[channel].values
        turns = 2 * np.pi * np.round((values - truth[channel]) / (2 * np.pi)) if channel == "yaw" else 0.0
        np.testing.assert_allclose(values - turns, truth[channel], atol=2e-3, err_msg=channel)
    np.testing.assert_allclose(drive.channels["position"].time, DRIVEN["t"], atol=1e-6)
    assert inspect_log(open_log(path, clock=rig.clock), rig).usable


@pytest.mark.parametrize("header", ["delta", "delta [deg]", "steering_angle"])
def test_an_angle_gives_steering_and_wheelbase(tmp_path: Path, header: str) -> None:
    in_degrees = "deg" in header
    rig = drafted(written(tmp_path / "drive.csv", {**POSE, header: ("angle", DEG if in_degrees else 1)}))
    assert rig.vehicle.max_steer == pytest.approx(WIDEST, rel=1e-3)
    assert rig.channels["steer_angle"].unit == ("deg" if in_degrees else "")
    assert (rig.channels["steer"].unit, rig.channels["steer"].scale) == ("deg" if in_degrees else "rad", 1.0)
    assert rig.vehicle.wheelbase == pytest.approx(WHEELBASE, rel=0.1)


def test_a_brake_pressure_beside_a_command_is_the_actuator(tmp_path: Path) -> None:
    """Whatever its unit; where it is the only brake, it stands for the command."""
    columns = {**POSE, "throttle": ("throttle", 1), "brake_cmd": ("brake", 1), "brake_pressure": ("brake", 8.5)}
    channels = drafted(written(tmp_path / "drive.csv", columns)).channels
    assert channels["brake"].fields == ("brake_cmd",)
    pressure = channels["brake_pressure"]
    assert (pressure.fields, pressure.clip) == (("brake_pressure",), (0.0, 1.0))
    largest = 8.5 * DRIVEN["brake"].max()
    assert pressure.scale == pytest.approx(1 / largest, rel=0.02)


@pytest.mark.parametrize(("ratio", "in_hand"), [(1.0, False), (4.0, True), (7.0, True)])
def test_an_angle_that_hardly_turns_the_vehicle_is_of_the_steering_wheel(
    tmp_path: Path, ratio: float, in_hand: bool
) -> None:
    """A fast circuit's bends need no more of it than road wheels could be turned."""
    curvature = DRIVEN["angle"] / (2.5 * ratio)
    yaw = np.cumsum(np.gradient(DRIVEN["t"]) * DRIVEN["speed"] * np.tan(curvature))
    step = np.gradient(DRIVEN["t"]) * DRIVEN["speed"]
    x, y = np.cumsum(step * np.cos(yaw)), np.cumsum(step * np.sin(yaw))
    path = tmp_path / "drive.csv"
    columns = np.column_stack([DRIVEN["t"], x, y, yaw, DRIVEN["throttle"], np.degrees(DRIVEN["angle"])])
    np.savetxt(path, columns, delimiter=",", header="t,x,y,yaw,throttle,Steered Angle [deg]", comments="", fmt="%.7f")
    rig = drafted(path)
    assert ("steer_angle" in rig.channels) != in_hand
    assert (rig.channels["steer"].unit == "") == in_hand
    turned = np.tan(np.abs(DRIVEN["angle"]).max() / ratio / 2.5)
    assert np.tan(rig.vehicle.max_steer) / rig.vehicle.wheelbase == pytest.approx(turned, rel=0.25)


@pytest.mark.parametrize("factor", [1.0, 100.0, 0.5])
def test_a_pedal_with_a_sign_is_throttle_and_brake(tmp_path: Path, factor: float) -> None:
    path = written(tmp_path / "drive.csv", {**POSE, "throttle": ("pedal", factor), "steer": ("angle", 1)})
    rig = drafted(path)
    assert rig.channels["throttle"].fields == rig.channels["brake"].fields == ("throttle",)
    channels = drive_from_log(open_log(path), rig).channels
    scale = 1.0 if factor == 100 else factor  # of percent, although this driver never goes beyond 80
    np.testing.assert_allclose(channels["throttle"].values[:, 0], DRIVEN["throttle"] * scale, atol=1e-3)
    np.testing.assert_allclose(channels["brake"].values[:, 0], DRIVEN["brake"] * scale, atol=1e-3)
    assert "brake" not in rig.absent


@pytest.mark.parametrize(
    ("separator", "below", "mark"),
    [(",", "s,m,m,rad,-,deg", ""), (";", "[s];[m];[m];[rad];;[deg]", "\ufeff"), ("\t", "sec\tm\tm\trad\t1\t°", "")],
)
def test_a_row_of_units_below_the_header(tmp_path: Path, separator: str, below: str, mark: str) -> None:
    columns = {**POSE, "throttle": ("throttle", 1.0), "steering": ("angle", DEG)}
    path = written(tmp_path / "drive.csv", columns, separator=separator, below=below, mark=mark)
    log = open_log(path)
    assert log.topics[""].fields == tuple(columns)
    assert log.topics[""].count == len(DRIVEN["t"])
    rig = drafted(path)
    assert rig.channels["steer_angle"].unit == "deg"
    assert rig.vehicle.max_steer == pytest.approx(WIDEST, rel=1e-3)


def test_columns_that_are_not_understood_are_listed(tmp_path: Path) -> None:
    path = written(tmp_path / "drive.csv", {**POSE, "lenkung": ("angle", 1), "q17": ("speed", 1)})
    text = draft_rig(open_log(path))
    assert "# Not read: columns: q17" in text
    assert parse_rig(text, where="draft").channels["steer"].fields == ("lenkung",)  # which the turning follows
    path = written(tmp_path / "without.csv", {**POSE, "q17": ("speed", 1)})
    text = draft_rig(open_log(path))
    assert "# Not read: columns: q17" in text
    assert "q17" in missing(text)[0]
    path = written(tmp_path / "other.csv", {"t": ("t", 1), "q1": ("x", 1), "q2": ("y", 1)})
    with pytest.raises(LogError, match="available: columns t, q1, q2"):
        draft_rig(open_log(path))


def test_what_was_never_measured_is_noted_until_it_is(tmp_path: Path) -> None:
    rig = drafted(written(tmp_path / "drive.csv", {**POSE, "steering": ("angle", 1 / WIDEST)}))
    assert rig.vehicle.source.startswith("GUESSED")
    (finding,) = check_draft_values(rig)
    assert finding.severity == "note"
    assert "mass = 1000 kg and a wheelbase of 2 m" in finding.evidence
    (again,) = check_draft_values(edited(rig, [Edit("vehicle.source", "")]))
    assert again.what == finding.what
    assert check_draft_values(edited(rig, [Edit("vehicle.source", "data sheet")])) == []
    assert check_draft_values(load_rig("tartandrive2")) == []


@pytest.mark.parametrize("names", [("Easting [m]", "Northing [m]"), ("xGPS", "yGPS")], ids=" ".join)
def test_a_compass_is_turned_round(tmp_path: Path, names: tuple[str, str]) -> None:
    """With x and y exchanged, heading and steering (a servo, positive to the right) fit as well, in a mirror."""
    columns = {"t": ("t", 1), names[0]: ("x", 1), names[1]: ("y", 1), "Heading [deg]": ("compass", 1)}
    path = written(tmp_path / "drive.csv", {**columns, "Servo [deg]": ("angle", -DEG)})
    rig = drafted(path)
    assert rig.channels["position"].fields == names
    inspection = inspect_log(open_log(path))
    cure = {edit.key: edit.value for edit in inspection.cure}
    assert cure == {"channels.yaw.sign": -1, "channels.yaw.offset": -90.0, "channels.steer.sign": -1}
    assert "clockwise" in inspection.findings[0].what
    yaw = drive_from_log(open_log(path), edited(rig, inspection.cure)).channels["yaw"].values[:, 0]
    np.testing.assert_allclose(np.angle(np.exp(1j * (yaw - DRIVEN["yaw"]))), 0, atol=1e-4)


@pytest.mark.parametrize("more", [(), ("bus",)])
def test_a_long_table_is_said_to_be_one(tmp_path: Path, more: tuple[str, ...]) -> None:
    signals = [name for name in POSE if name != "t"]
    rows = [
        ",".join([str(time), *("1" for _ in more), name, str(DRIVEN[name][row])])
        for row, time in enumerate(DRIVEN["t"][:50])
        for name in signals
    ]
    path = tmp_path / "long.csv"
    path.write_text("\n".join([",".join(["timestamp", *more, "signal", "value"]), *rows]) + "\n", "utf-8")
    with pytest.raises(LogError, match="the table is long: it has a line, not a column, for each signal") as caught:
        draft_rig(open_log(path))
    assert "pivot_table(values='value', index='timestamp', columns='signal')" in caught.value.how


def test_latitude_and_longitude_in_messages_of_their_own_are_a_position(tmp_path: Path) -> None:
    """As of a CAN bus, decoded to a row for each message."""
    names = {"Latitude": 48.1 + DRIVEN["y"] / 111e3, "Longitude": 11.5 + DRIVEN["x"] / 74e3, "Yaw": DRIVEN["yaw"]}
    rows = [
        (time + 0.003 * number, *("" if other != name else f"{names[name][at]:.9f}" for other in names))
        for at, time in enumerate(DRIVEN["t"])
        for number, name in enumerate(names)
    ]
    path = tmp_path / "can.csv"
    path.write_text("\n".join(",".join(map(str, row)) for row in [("t", *names), *rows]) + "\n", "utf-8")
    rig = drafted(path)
    assert rig.channels["position"].fields == ("Latitude", "Longitude")
    drive = drive_from_log(open_log(path), rig)
    assert len(drive.channels["position"].time) == len(DRIVEN["t"])
    assert drive.notes == ()


@pytest.mark.parametrize(
    ("name", "factor", "unit", "sign"),
    [("attitude_3", 1, "rad", 1), ("dir_vehicle", DEG, "deg", 1), ("kurs", -DEG, "deg", -1), ("ch17", -1, "rad", -1)],
)
def test_a_heading_that_no_name_gives_away_is_found_by_the_course(
    tmp_path: Path, name: str, factor: float, unit: str, sign: int
) -> None:
    more = {"t": ("t", 1), "east": ("x", 1), "north": ("y", 1), name: ("yaw", factor), "v1": ("speed", 1)}
    path = written(tmp_path / "log.csv", more | {"target_dir": ("yaw", 1), "steering": ("angle", 1)})
    rig = drafted(path)
    yaw = rig.channels["yaw"]
    assert (yaw.fields, yaw.unit or "rad") == ((name,), unit), "what is a target is none"
    cured = edited(rig, pose_cure(open_log(path), rig))
    assert cured.channels["yaw"].sign == sign
    assert "by its numbers: the course of the position follows it" in draft_rig(open_log(path))


@pytest.mark.parametrize("straight", [False, True])
def test_no_heading_is_made_of_what_no_course_follows(tmp_path: Path, straight: bool) -> None:
    """On a straight all that hardly changes would be one."""
    along = {"east": ("t", 5), "north": ("zero", 1)} if straight else {"east": ("x", 1), "north": ("y", 1)}
    more = {"t": ("t", 1), **along, "hardly": ("zero", 1), "v1": ("speed", 1), "steering": ("angle", 1)}
    with pytest.raises(LogError, match=r"no name is that of a heading"):
        drafted(written(tmp_path / "log.csv", more))
