"""Headings against courses: turned, drifting, mirrored; the lean of the body."""

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, pointing, rig

from offpiste.inspection.course import check_course, heading_fits
from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.inspect import inspect_log
from offpiste.inspection.steering import leans_inward
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
    for field, values in columns.items():
        log = log.change("odom", field, lambda _, values=values: values)
    return log


@pytest.mark.parametrize("degrees", [25.0, -90.0, 140.0])
def test_a_turned_heading_is_turned_back(degrees: float) -> None:
    log = _turned(np.radians(degrees))
    drive = drive_from_log(log, rig())
    (finding,) = check_course(drive, driven_path(drive))
    ((edit,),) = finding.cures
    assert edit.key == "channels.orientation.offset"
    assert edit.value == pytest.approx(-np.radians(degrees), abs=0.03)
    cured = drive_from_log(log, edited(rig(), [edit]))
    assert check_course(cured, driven_path(cured)) == []


@pytest.mark.parametrize("axes", ["body down", "world down", "ned"])
@pytest.mark.parametrize("degrees", [25.0, -90.0])
def test_a_turned_heading_is_turned_back_about_axes_that_point_down(degrees: float, axes: str) -> None:
    log, by_yaw = pointing(_turned(np.radians(degrees)), axes)
    by_orientation = edited(rig(), [Edit("motion.axes", axes)])
    for given, name in ((by_yaw, "yaw"), (by_orientation, "orientation")):
        drive = drive_from_log(log, given)
        (finding,) = check_course(drive, driven_path(drive))
        assert [edit.key for edit in finding.cures[0]] == [f"channels.{name}.offset"]
        cured = drive_from_log(log, edited(given, finding.cures[0]))
        assert check_course(cured, driven_path(cured)) == []


@pytest.mark.parametrize("axes", ["z up", "body down", "world down", "ned"])
@pytest.mark.parametrize("turned", [False, True])
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


@pytest.mark.parametrize("degrees", [-90.0, 30.0, 60.0])
def test_a_turned_heading_of_a_vehicle_that_reverses_at_times_is_turned_back(degrees: float) -> None:
    time = CLEAN.data["odom"][0]
    back = np.where(((time - time[0]) // 8) % 3 == 1, np.pi, 0.0)  # a third of the time
    drive = drive_from_log(_turned(back + np.radians(degrees)), rig())
    (finding,) = check_course(drive, driven_path(drive))
    ((edit,),) = finding.cures
    assert edit.value == pytest.approx(-np.radians(degrees), abs=0.05)


def test_a_vehicle_that_reverses_on_most_of_its_straights_is_not_turned() -> None:
    path = driven_path(drive_from_log(CLEAN, rig()))
    time, bends = CLEAN.data["odom"][0], np.abs(np.nan_to_num(path.yaw_rate))
    straight = np.interp(time, path.time, bends) < np.quantile(bends, 0.4)
    drive = drive_from_log(_turned(np.where(straight, np.pi, 0.0)), rig())
    assert check_course(drive, driven_path(drive)) == []


def test_a_drift_in_the_curves_is_no_fault() -> None:
    path = driven_path(drive_from_log(CLEAN, rig()))
    rate = np.interp(CLEAN.data["odom"][0], path.time, np.nan_to_num(path.yaw_rate))
    drifting = drive_from_log(_turned(np.clip(3.0 * rate, -1.2, 1.2)), rig())
    assert heading_fits(driven_path(drifting))
    assert check_course(drifting, driven_path(drifting)) == []


def test_bodies_lean_out_of_their_curves() -> None:
    path = driven_path(drive_from_log(CLEAN, rig()))
    aside = np.interp(CLEAN.data["odom"][0], path.time, np.nan_to_num(path.forward * path.yaw_rate))
    outward, inward = (drive_from_log(_turned(0.0, roll=sign * 0.03 * aside), rig()) for sign in (1, -1))
    assert not leans_inward(outward, driven_path(outward))
    assert leans_inward(inward, driven_path(inward))


def test_poses_of_north_east_down_are_recognised_by_the_lean() -> None:
    path = driven_path(drive_from_log(CLEAN, rig()))
    aside = np.interp(CLEAN.data["odom"][0], path.time, np.nan_to_num(path.forward * path.yaw_rate))
    log = _turned(0.0, roll=0.03 * aside)
    for field in ("y", "z", "qy", "qz", "vy", "vz", "wy", "wz"):
        log = log.change("odom", field, np.negative)
    from offpiste.inspection.inspect import inspect_log

    assert Edit("motion.axes", "ned") in inspect_log(log, rig()).cure
