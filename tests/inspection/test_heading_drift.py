"""Headings that drift against the course: found by their size, whatever the direction; wander and slip are healthy."""

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig, steered

from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.findings import Finding
from offpiste.inspection.heading_drift import check_fast_drift, check_heading_drift, check_heading_noise
from offpiste.inspection.inspect import inspect_log
from offpiste.logs.drive import drive_from_log
from offpiste.rig.edits import Edit, edited

CLEAN = drive_log(seed=0)


def _turned(angle: np.ndarray) -> MemoryLog:
    _, odom = CLEAN.data["odom"]
    yaw = 2 * np.arctan2(odom["qz"], odom["qw"]) + angle
    return CLEAN.change("odom", "qz", lambda _: np.sin(yaw / 2)).change("odom", "qw", lambda _: np.cos(yaw / 2))


def _found(angle: np.ndarray) -> list[Finding]:
    drive = drive_from_log(_turned(angle), rig())
    return check_heading_drift(drive, driven_path(drive))


@pytest.mark.parametrize("rate", [0.2, -0.5])
def test_a_drift_is_said_with_its_size(rate: float) -> None:
    time, _ = CLEAN.data["odom"]
    (finding,) = _found(np.radians(rate) * (time - time[0]))
    assert (finding.severity, finding.where) == ("warning", "orientation")
    words = finding.evidence.split()
    said, lasts = float(words[words.index("by") + 1]), float(words[words.index("in") + 1])
    assert lasts > 0.8 * np.ptp(time)
    assert said == pytest.approx(rate * lasts, rel=0.1)


@pytest.mark.parametrize("rate", [3.0, -6.0])
def test_a_drift_so_fast_that_the_heading_does_not_follow_is_said_too(rate: float) -> None:
    time, _ = CLEAN.data["odom"]
    log = _turned(np.radians(rate) * (time - time[0]))
    drive = drive_from_log(log, rig())
    (finding,) = check_fast_drift(drive, driven_path(drive))
    assert (finding.severity, finding.where, finding.what) == ("warning", "orientation", "the heading drifts")
    words = finding.evidence.split()
    said, lasts = float(words[words.index("by") + 1]), float(words[words.index("in") + 1])
    assert said == pytest.approx(rate * lasts, rel=0.1)
    assert any(f.what == "the heading drifts" for f in inspect_log(log, rig()).findings)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_heading_that_has_nothing_to_do_with_the_course_does_not_drift(seed: int) -> None:
    time, _ = CLEAN.data["odom"]
    wandering = np.cumsum(np.random.default_rng(seed).normal(size=len(time))) * 0.1
    drive = drive_from_log(_turned(wandering), rig())
    assert check_fast_drift(drive, driven_path(drive)) == []


def test_a_heading_that_rests_while_the_vehicle_goes_in_circles_does_not_drift() -> None:
    time = np.arange(0, 100, 0.02)
    angle = 0.3 * time
    odom = {"x": 10 * np.cos(angle), "y": 10 * np.sin(angle), "z": 0 * time}
    odom |= {"qx": 0 * time, "qy": 0 * time, "qz": 0 * time, "qw": 1 + 0 * time}
    others = [name for name in rig().channels if name not in ("position", "orientation")]
    gone = (*rig().absent, "throttle", "brake", "steer", "steer_angle")
    posed = edited(rig(), [*(Edit(f"channels.{name}", None) for name in others), Edit("absent", list(gone))])
    drive = drive_from_log(MemoryLog({"odom": (time, odom)}), posed)
    assert check_fast_drift(drive, driven_path(drive)) == []


def test_a_heading_that_wanders_about_the_course_does_not_drift() -> None:
    time, _ = CLEAN.data["odom"]
    assert _found(np.radians(4.0) * np.sin(2 * np.pi * (time - time[0]) / 20)) == []
    assert _found(np.full(len(time), 0.05)) == []


def test_tyres_that_slip_in_right_curves_first_and_left_ones_then_do_not_drift() -> None:
    time, columns = CLEAN.data["steering"]
    curves = 0.15 * columns["command"] + np.where(time < np.median(time), -0.4, 0.4)
    turned = steered(CLEAN, curves, follows=0.0)
    _, odom = turned.data["odom"]
    slip = -0.06 * odom["vx"] * odom["wz"]
    yaw = np.unwrap(2 * np.arctan2(odom["qz"], odom["qw"])) - slip
    slid = turned.change("odom", "qz", lambda _: np.sin(yaw / 2)).change("odom", "qw", lambda _: np.cos(yaw / 2))
    drive = drive_from_log(slid, rig())
    assert np.ptp(slip) > np.radians(8)
    assert check_heading_drift(drive, driven_path(drive)) == []


@pytest.mark.parametrize(("noise", "found"), [(0.005, False), (0.05, True)])
def test_headings_that_scatter_are_noisy_and_those_of_a_compass_are_not(noise: float, found: bool) -> None:
    time, _ = CLEAN.data["odom"]
    drive = drive_from_log(_turned(noise * np.random.default_rng(1).standard_normal(len(time))), rig())
    findings = check_heading_noise(drive, driven_path(drive))
    assert [(f.severity, f.where) for f in findings] == [("warning", "orientation")] * found
    for finding in findings:
        assert float(finding.evidence.split(" by ")[1].split()[0]) == pytest.approx(np.degrees(noise), rel=0.1)
