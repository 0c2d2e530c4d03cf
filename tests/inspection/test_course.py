"""Headings against the course: turned, drifting, mirrored; axes that point down."""

import numpy as np
import pytest
from simulated import MemoryLog, checked, drive_log, pointing, rig

from offpiste.inspection.course import check_course
from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.findings import Finding
from offpiste.inspection.heading_drift import check_fast_drift, check_heading_drift, check_heading_noise
from offpiste.inspection.inspect import inspect_log
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import Edit, edited

CLEAN = drive_log(seconds=60)


def _turned(angle: np.ndarray | float, log: MemoryLog = CLEAN, *, roll: np.ndarray | float = 0.0) -> MemoryLog:
    """The log with its heading turned by an angle, and the body rolled by another [rad]."""
    _, odom = log.data["odom"]
    yaw = 2 * np.arctan2(odom["qz"], odom["qw"]) + angle
    roll = np.broadcast_to(roll, yaw.shape)
    columns = {
        "qx": np.cos(yaw / 2) * np.sin(roll / 2),
        "qy": np.sin(yaw / 2) * np.sin(roll / 2),
        "qz": np.sin(yaw / 2) * np.cos(roll / 2),
        "qw": np.cos(yaw / 2) * np.cos(roll / 2),
    }
    return log.put("odom", **columns)


@pytest.mark.parametrize("degrees", [25.0, -90.0])
def test_a_turned_heading_is_turned_back(degrees: float) -> None:
    log = _turned(np.radians(degrees))
    (finding,) = checked(check_course, log)
    ((edit,),) = finding.cures
    assert edit.key == "channels.orientation.offset"
    assert edit.value == pytest.approx(-np.radians(degrees), abs=0.03)
    cured = drive_from_log(log, edited(rig(), [edit]))
    assert check_course(cured, driven_path(cured)) == []


@pytest.mark.parametrize(
    ("axes", "turned"), [("z up", True), ("body down", True), ("world down", True), ("ned", False)]
)
def test_the_heading_follows_places_of_latitude_and_longitude_whatever_the_axes(axes: str, turned: bool) -> None:
    _, odom = CLEAN.data["odom"]
    # A world of north, east, down is one of north, west, up upside down.
    east, north = (-odom["y"], odom["x"]) if axes in ("world down", "ned") else (odom["x"], odom["y"])
    log, by_yaw = pointing(_turned(0.5 if turned else 0.0), axes)
    log = log.change("odom", "x", lambda _: 50.0 + north / 111_229)
    log = log.change("odom", "y", lambda _: 8.0 + east / 71_696)
    places = [Edit("channels.position.unit", "lat lon"), Edit("channels.position.fields", ["x", "y"])]
    for given in (by_yaw, edited(rig(), [Edit("motion.axes", axes)])):
        given = edited(given, places)
        drive = drive_from_log(log, given)
        found = check_course(drive, driven_path(drive))
        assert len(found) == turned
        for finding in found:
            cured = drive_from_log(log, edited(given, finding.cures[0]))
            assert check_course(cured, driven_path(cured)) == []


@pytest.mark.parametrize("down", [True, False])
def test_a_heading_that_counts_clockwise_is_a_compass_or_an_ins_of_north_east_down(down: bool) -> None:
    """Velocities and turn rates beside it say which."""
    time, odom = CLEAN.data["odom"]
    log, by_yaw = pointing(CLEAN, "z up")
    yaw = np.unwrap(2 * np.arctan2(odom["qz"], odom["qw"]))
    x, y, rate = np.cos(yaw), np.sin(yaw), odom["wz"]
    ways = (y, x, -rate) if down else (x, y, rate)
    columns = {"vx": ways[0] * odom["vx"], "vy": ways[1] * odom["vx"], "vz": 0.0 * x, "yaw_rate": ways[2]}
    columns |= {"x": 50.0 + odom["y"] / 111_229, "y": 8.0 + odom["x"] / 71_696, "yaw": np.pi / 2 - yaw}
    log = MemoryLog({**log.data, "odom": (time, log.data["odom"][1] | columns)})
    places = [Edit("channels.position.unit", "lat lon"), Edit("channels.position.fields", ["x", "y"])]
    given = edited(by_yaw, [*places, Edit("channels.linear_velocity.frame", "world")])
    first = inspect_log(log, given).findings[0]
    assert first.what == "the heading does not follow the course: it counts clockwise"
    if down:
        assert first.cures == ((Edit("motion.axes", "ned"),),)
    else:
        assert {edit.key for edit in first.cures[0]} == {"channels.yaw.sign", "channels.yaw.offset"}
    cured = inspect_log(log, edited(given, first.cures[0]))
    assert not [f for f in cured.findings if f.severity != "note" and f.where != "steer"]


DRIVE = drive_log()


def _found(angle: np.ndarray) -> list[Finding]:
    return checked(check_heading_drift, _turned(angle, DRIVE))


@pytest.mark.parametrize("rate", [0.2, -0.5])
def test_a_drift_is_said_with_its_size(rate: float) -> None:
    time, _ = DRIVE.data["odom"]
    (finding,) = _found(np.radians(rate) * (time - time[0]))
    assert (finding.severity, finding.where) == ("warning", "orientation")
    words = finding.evidence.split()
    said, lasts = float(words[words.index("by") + 1]), float(words[words.index("in") + 1])
    assert lasts > 0.8 * np.ptp(time)
    assert said == pytest.approx(rate * lasts, rel=0.1)


@pytest.mark.parametrize("rate", [3.0, -6.0])
def test_a_drift_so_fast_that_the_heading_does_not_follow_is_said_too(rate: float) -> None:
    time, _ = DRIVE.data["odom"]
    log = _turned(np.radians(rate) * (time - time[0]), DRIVE)
    (finding,) = checked(check_fast_drift, log)
    assert (finding.severity, finding.where, finding.what) == ("warning", "orientation", "the heading drifts")
    words = finding.evidence.split()
    said, lasts = float(words[words.index("by") + 1]), float(words[words.index("in") + 1])
    assert said == pytest.approx(rate * lasts, rel=0.1)
    assert any(f.what == "the heading drifts" for f in inspect_log(log, rig()).findings)


@pytest.mark.parametrize(("noise", "found"), [(0.005, False), (0.05, True)])
def test_headings_that_scatter_are_noisy_and_those_of_a_compass_are_not(noise: float, found: bool) -> None:
    time, _ = DRIVE.data["odom"]
    findings = checked(check_heading_noise, _turned(noise * np.random.default_rng(1).standard_normal(len(time)), DRIVE))
    assert [(f.severity, f.where) for f in findings] == [("warning", "orientation")] * found
    for finding in findings:
        assert float(finding.evidence.split(" by ")[1].split()[0]) == pytest.approx(np.degrees(noise), rel=0.1)
