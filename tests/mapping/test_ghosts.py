"""Detection of returns below the ground, but not of ditches, holes, drops and ground under branches."""

import inspect

import numpy as np
import pytest

from mapping.height_field import spinning_scan, with_detours
from offpiste.mapping import ghosts
from offpiste.mapping.ghosts import GhostFinder, GhostSettings
from offpiste.mapping.pipeline import FeatureCloud, MapPipeline, MapSettings
from offpiste.mapping.voxel_map import VoxelSettings

SENSOR = np.array([0.0, 0.0, 1.9])
SMALL = VoxelSettings(reach=25.0, capacity=100_000)


def rolling(x, y):
    return 0.25 * np.sin(0.35 * x) * np.cos(0.3 * y) + 0.05 * np.sin(2.1 * x) * np.sin(1.7 * y)


def ditch(depth, width, turn, away=5.0):
    """Rolling ground with a ditch across, along or at an angle to x."""
    return lambda x, y: rolling(x, y) - depth * (np.abs(np.cos(turn) * x + np.sin(turn) * y - away) < width / 2)


GROUNDS = {
    "half a metre": ditch(0.5, 1.0, 0.0),
    "two metres, narrow": ditch(2.0, 1.0, 0.7),
    "two metres, wide": ditch(2.0, 3.0, 0.0),
    "along the way": ditch(1.5, 2.0, np.pi / 2, away=1.5),
    "holes": lambda x, y: rolling(x, y) - 1.0 * (((x % 6) - 3) ** 2 + ((y % 6) - 3) ** 2 < 1.5),
    "drop": lambda x, y: rolling(x, y) - 3.0 * (x > 6),
    "cliff beside": lambda x, y: rolling(x, y) - 10.0 * (y > 4),
    "step up": lambda x, y: rolling(x, y) + 0.8 * (x > 6),
    "hills": lambda x, y: rolling(x, y) + 3 * np.sin(0.25 * x) * np.sin(0.2 * y),
}


@pytest.mark.parametrize("ground", GROUNDS.values(), ids=GROUNDS)
def test_no_ditch_or_drop_is_filled(ground):
    sensor = SENSOR + np.array([0, 0, ground(np.zeros(1), np.zeros(1))[0]])
    points = spinning_scan(ground, sensor, rings=40, columns=256, furthest=25.0)
    low = points[:, 2] - rolling(*points[:, :2].T)
    assert low.min() < -0.4 or ground in (GROUNDS["step up"], GROUNDS["hills"])  # what must stay is there
    assert not GhostFinder().find(points, sensor).any()


def test_reflected_returns_are_found():
    points = spinning_scan(rolling, SENSOR, rings=40, columns=256, furthest=25.0)
    planted, ghosts = with_detours(points, SENSOR, 0.005, np.random.default_rng(0))
    found = GhostFinder().find(planted, SENSOR)
    assert ghosts.sum() >= 30
    assert not (found & ~ghosts).any()
    deep = ghosts & (planted[:, 2] < -1.5)
    assert found[deep].mean() > 0.97
    assert found[ghosts].mean() > 0.9


@pytest.mark.parametrize("seed", range(4))
def test_ghosts_are_the_same_without_the_library(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    n = 3000
    sensor = rng.uniform(-1e4, 1e4, 3)
    away, turn = rng.exponential(12, n), rng.uniform(-np.pi, np.pi, n)
    height = rng.normal(-1.8, 0.2, n) - rng.exponential(3, n) * (rng.random(n) < 0.1)
    points = sensor + np.stack((away * np.cos(turn), away * np.sin(turn), height), axis=1)
    points[:4] = [[np.nan, 0, 0], sensor, [np.inf, 0, 0], sensor + np.array([1e-3, 0, -5])]
    settings = GhostSettings(
        depth=float(rng.uniform(0.2, 1)), sectors=int(rng.integers(8, 80)), rings=int(rng.integers(8, 60)), window=2
    )
    found = GhostFinder(settings).find(points, sensor)
    assert 0 < found.sum() < n / 5
    monkeypatch.setattr(ghosts, "place_returns", ghosts.place_returns.plain)
    np.testing.assert_array_equal(GhostFinder(settings).find(points, sensor), found)
    assert len(GhostFinder(settings).find(points[:0], sensor)) == 0


def test_arrays_of_other_shapes_are_refused():
    for points, sensor in ((np.zeros((3, 2)), SENSOR), (np.zeros((3, 3)), SENSOR[:2])):
        with pytest.raises(ValueError, match="have shapes"):
            inspect.unwrap(GhostFinder.find)(GhostFinder(), points, sensor)


def test_pits_leave_the_map():
    points = spinning_scan(rolling, SENSOR, rings=40, columns=256, furthest=25.0)
    planted, ghosts = with_detours(points, SENSOR, 0.005, np.random.default_rng(0))

    def mapped(scan, settings):
        pipeline = MapPipeline(0, settings)
        left_out = pipeline.add(FeatureCloud(scan, SENSOR), np.zeros(3))
        return pipeline.layers().elevation, left_out.sum()

    right, none = mapped(points, MapSettings(SMALL))
    before, kept = mapped(planted, MapSettings(SMALL, ghosts=None))
    after, left_out = mapped(planted, MapSettings(SMALL))
    assert (none, kept) == (0, 0)
    assert left_out > 0.9 * ghosts.sum()
    assert np.nanmin(right) > -1 > np.nanmin(before)
    assert np.nanmin(after) > -1.2
    pits = [np.sum(np.abs(layer - right) > 0.5) for layer in (before, after)]
    assert pits[1] < 0.1 * pits[0]
