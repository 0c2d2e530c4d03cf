"""Velocities to the side: of tyres that slip, recorded to the left as a body's are, or to the right."""

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, pointing, rig

from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.findings import Finding
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.velocity import _UNITS, _gain, fit_wheel_speed
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import Edit, edited

CLEAN = drive_log(seed=0)


def _sliding(sign: float) -> MemoryLog:
    """The vehicle slides outwards in its curves: it goes to the right of its heading in left ones."""
    _, odom = CLEAN.data["odom"]
    slip = -0.02 * odom["vx"] * odom["wz"]
    yaw = 2 * np.arctan2(odom["qz"], odom["qw"]) - slip
    columns = {
        "qz": np.sin(yaw / 2),
        "qw": np.cos(yaw / 2),
        "wz": np.gradient(yaw, 0.02),
        "vx": odom["vx"] * np.cos(slip),
        "vy": sign * odom["vx"] * np.sin(slip),
    }
    log = CLEAN
    for field, values in columns.items():
        log = log.change("odom", field, lambda _, values=values: values)
    return log


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_velocity_to_the_side_that_is_positive_to_the_right_is_found(sign: float) -> None:
    log = _sliding(sign)
    found = [f for f in inspect_log(log, rig()).findings if f.where == "linear_velocity"]
    assert [(f.severity, f.what) for f in found] == [("warning", "is positive to the right")] * (sign < 0)
    for finding in found:
        # Poses whose z points up are not turned for it: the velocity alone is wrong.
        assert finding.cures[0] == (Edit("channels.linear_velocity.frame", "unknown"),)
        cured = inspect_log(log, edited(rig(), finding.cures[0]))
        assert not [f for f in cured.findings if f.where == "linear_velocity" and f.severity != "note"]


def test_a_heading_alone_leaves_the_axes_of_the_velocity_open() -> None:
    """Without an orientation nothing says which way z points, and axes with y to the right explain it."""
    log = _sliding(-1.0)
    _, odom = log.data["odom"]
    log = log.change("odom", "qx", lambda _: 2 * np.arctan2(odom["qz"], odom["qw"]))
    changes = [Edit("channels.orientation", None), Edit("channels.angular_velocity", None)]
    changes += [Edit("channels.yaw", {"topic": "odom", "fields": ["qx"]})]
    (finding,) = (f for f in inspect_log(log, edited(rig(), changes)).findings if f.where == "linear_velocity")
    assert finding.cures[0] == (Edit("motion.axes", "body down"),)


@pytest.mark.parametrize("axes", ["z up", "body down", "world down", "ned"])
def test_a_biased_rate_is_cured_about_any_axis(axes: str) -> None:
    log, given = pointing(CLEAN.change("odom", "wz", lambda rate: rate + 0.1), axes)
    (finding,) = (f for f in inspect_log(log, given).findings if f.severity != "note")
    assert finding.what == "is not zero without turning"
    ((edit,),) = finding.cures
    assert edit.value == pytest.approx(0.1 if axes in ("world down", "ned") else -0.1, abs=0.01)
    assert not [f for f in inspect_log(log, edited(given, [edit])).findings if f.severity != "note"]


@pytest.mark.parametrize("frame", ["world", "body"])
def test_a_velocity_of_north_east_down_is_read_in_their_order(frame: str) -> None:
    time, odom = CLEAN.data["odom"]
    yaw = 2 * np.arctan2(odom["qz"], odom["qw"])
    north_east_down = {"vx": odom["vx"] * np.sin(yaw), "vy": odom["vx"] * np.cos(yaw), "vz": -odom["vz"]}
    log = MemoryLog({**CLEAN.data, "odom": (time, odom | north_east_down)})
    read = edited(rig(), [Edit("channels.linear_velocity.frame", frame)])
    (found,) = [f for f in inspect_log(log, read).findings if f.where == "linear_velocity"]
    assert found.what == "is north, east, down, and is read as east, north, up"
    cured = edited(read, found.cures[0])
    assert (cured.channels["linear_velocity"].fields, cured.channels["linear_velocity"].frame) == (
        ("vy", "vx"),
        "world",
    )
    assert not [f for f in inspect_log(log, cured).findings if f.where == "linear_velocity"]


def test_joints_that_turn_in_rad_are_given_the_size_of_their_wheels() -> None:
    """A wheel of 0.3 m turns 3.34 times as fast as the vehicle drives, which is near to km/h."""
    time, odom = CLEAN.data["odom"]
    log = MemoryLog({**CLEAN.data, "wheels": (time, {"v": odom["vx"] / 0.299})})
    given = edited(rig(), [Edit("channels.wheel_speed", {"topic": "wheels", "fields": ["v"]})])
    joint = edited(given, [Edit("channels.wheel_speed.joints", ["left"])])
    drive = drive_from_log(log, given)
    fit = fit_wheel_speed(drive, driven_path(drive))
    keys = [_gain("wheel_speed", fit, each, "m/s", _UNITS)[0].cures[0][0].key for each in (given, joint)]
    assert keys == ["channels.wheel_speed.unit", "channels.wheel_speed.scale"]


def _wheels(per_speed: float, unit: str) -> list[Finding]:
    """What is found of wheels that count this much for each m/s, read in a unit."""
    time, odom = CLEAN.data["odom"]
    noise = 0.02 * np.random.default_rng(0).standard_normal(len(time))
    log = MemoryLog({**CLEAN.data, "wheels": (time, {"v": per_speed * odom["vx"] + noise})})
    source = {"topic": "wheels", "fields": ["v"]} | ({"unit": unit} if unit else {})
    given = edited(rig(), [Edit("channels.wheel_speed", source)])
    return [finding for finding in inspect_log(log, given).findings if finding.where == "wheel_speed"]


@pytest.mark.parametrize(("true", "read"), [("mph", "km/h"), ("km/h", "mph"), ("kn", "km/h")])
def test_wheels_under_the_name_of_another_unit_are_read_in_theirs(true: str, read: str) -> None:
    """Wheels that spin never count so evenly."""
    (finding,) = _wheels(_UNITS[true], read)
    assert (finding.severity, finding.cures) == ("warning", ((Edit("channels.wheel_speed.unit", true),),))
    assert _wheels(_UNITS[true], true) == []


def test_what_tyres_may_be_off_by_as_well_is_a_question() -> None:
    (knots,) = _wheels(_UNITS["kn"], "mph")
    assert (knots.severity, knots.what) == ("note", "may be in kn")
    (turning,) = _wheels(1 / 0.36, "km/h")
    assert turning.severity == "note"
    assert "radius of 0.36 m" in turning.remedy
    for off in (0.95, 1.05):
        assert _wheels(3.6 * off, "km/h") == []
        assert _wheels(off, "") == []
