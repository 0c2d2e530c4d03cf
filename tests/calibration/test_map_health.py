"""Ghosts, height drift, moving objects and pits in maps."""

from dataclasses import replace

import numpy as np
import pytest

from mapping.height_field import spinning_scan, with_detours
from offpiste.calibration.map_health import (
    MapHealth,
    PlacedScan,
    find_pits,
    height_rates,
    map_health,
    moving_shares,
)
from offpiste.calibration.samples import Gathered, Scan
from offpiste.inspection.sensors import check_map_health
from offpiste.logs.channel import Channel
from offpiste.logs.measurements import Lidar
from offpiste.logs.poses import Poses
from offpiste.rig.sensors import LidarSource

GOOD = MapHealth(1_000_000, 0.0, 0.002, 0.0003, 60, 0.0, 40)


def rolling(x, y):
    return 0.25 * np.sin(0.35 * x) * np.cos(0.3 * y)


@pytest.fixture(scope="module")
def drive():
    """Scans every half second of a vehicle at 2 m/s."""
    scans = []
    for number in range(10):
        sensor = np.array([number, 0.0, 1.9])
        points = spinning_scan(rolling, sensor, rings=40, columns=256, furthest=30.0, seed=number)
        scans.append(PlacedScan(0.5 * number, points, sensor, np.zeros(len(points), bool)))
    return scans


def test_drift_of_the_height_is_measured(drive):
    assert np.median(height_rates(drive)) < 0.01
    for rate in (0.05, -0.2):
        rising = [replace(s, points=s.points + np.array([0, 0, rate * s.time])) for s in drive]
        assert np.median(height_rates(rising)) == pytest.approx(abs(rate), abs=0.01)


def test_moving_returns_are_measured(drive):
    assert np.mean(moving_shares(drive)) < 1e-3
    rng = np.random.default_rng(0)
    boxes = []
    for scan in drive:
        box = scan.sensor + np.array([7, 12 - 3 * scan.time, -1]) + rng.uniform(-0.6, 0.6, (200, 3))
        points = np.concatenate((scan.points, box))
        boxes.append(replace(scan, points=points, ghosts=np.zeros(len(points), bool)))
    shares = moving_shares(boxes)
    assert len(shares) == 9
    assert np.median(shares) == pytest.approx(200 / len(boxes[0].points), rel=0.4)


def test_ghosts_are_counted(drive):
    identity = np.tile([0.0, 0, 0, 1], (2, 1))
    times = np.array([-1.0, 10.0])
    place = np.array([[0.0, 0, 0], [0.0, 0, 0]])
    poses = Poses(Channel("position", "m", times, place), Channel("orientation", "", times, identity), 100.0)
    lidar = Lidar("top", np.eye(4), LidarSource(topic="/points"))
    points, ghosts = with_detours(drive[0].points, drive[0].sensor, 0.003, np.random.default_rng(0))
    scan = Scan(np.array([0.0]), np.zeros(len(points), int), points - drive[0].sensor, 0.0)
    health = map_health({"top": lidar}, Gathered({"top": [scan]}, {}), poses)
    near = np.linalg.norm(scan.points[:, :2], axis=1) < 25
    assert health.returns == near.sum() < len(points)
    assert health.ghosts == pytest.approx(ghosts[near].mean(), rel=0.15)
    assert np.isnan(health.drift)
    assert [f.what for f in check_map_health(health)] == ["see ghosts below the ground"]


@pytest.mark.parametrize(
    ("changed", "turned", "found"),
    [
        ({}, False, []),
        ({"drift": 0.08}, False, [("warning", "drift in height")]),
        ({"drift": 0.08}, True, [("note", "drift in height")]),  # the mounting may do this
        ({"drift": 0.08, "drift_error": 0.03}, False, []),  # not sure
        ({"drift": 0.08, "drift_pairs": 3}, False, []),
        ({"drift": 0.04}, False, [("note", "drift in height")]),
        ({"ghosts": 5e-4}, False, [("note", "see ghosts below the ground")]),
        ({"moving": 0.03}, False, [("note", "see many moving objects")]),
        ({"drift": np.nan, "drift_error": np.nan, "moving": np.nan, "ghosts": np.nan}, False, []),
    ],
)
def test_findings(changed, turned, found):
    findings = check_map_health(replace(GOOD, **changed), turned=turned)
    assert [(f.severity, f.what) for f in findings] == found
    assert all(f.remedy and f.evidence for f in findings)


def ground():
    y, x = np.mgrid[:80, :80] * 0.2
    return 300.0 + 0.3 * x + 0.2 * np.sin(y)


def test_lone_deep_cells_are_pits():
    height = ground()
    for row, column, depth in ((10, 10, 0.8), (40, 40, 13.0), (40, 41, 9.0), (79, 0, 2.0)):
        height[row, column] -= depth
    expected = height < ground() - 0.5
    height[20, 20:30] = np.nan
    np.testing.assert_array_equal(find_pits(height), expected)
    assert expected.sum() == 4
