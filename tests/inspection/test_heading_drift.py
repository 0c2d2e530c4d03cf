"""Headings that drift against the course: found by their size, whatever the direction; wander and slip are healthy."""

import numpy as np
import pytest
from simulated import MemoryLog, drive_log, rig

from offpiste.inspection.driven_path import driven_path
from offpiste.inspection.findings import Finding
from offpiste.inspection.heading_drift import check_heading_drift, check_heading_noise
from offpiste.logs.drive import drive_from_log

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


def test_a_heading_that_wanders_about_the_course_does_not_drift() -> None:
    time, _ = CLEAN.data["odom"]
    assert _found(np.radians(4.0) * np.sin(2 * np.pi * (time - time[0]) / 20)) == []
    assert _found(np.full(len(time), 0.05)) == []


@pytest.mark.parametrize(("noise", "found"), [(0.005, False), (0.05, True)])
def test_headings_that_scatter_are_noisy_and_those_of_a_compass_are_not(noise: float, found: bool) -> None:
    time, _ = CLEAN.data["odom"]
    drive = drive_from_log(_turned(noise * np.random.default_rng(1).standard_normal(len(time))), rig())
    findings = check_heading_noise(drive, driven_path(drive))
    assert [(f.severity, f.where) for f in findings] == [("warning", "orientation")] * found
    for finding in findings:
        assert float(finding.evidence.split(" by ")[1].split()[0]) == pytest.approx(np.degrees(noise), rel=0.1)
