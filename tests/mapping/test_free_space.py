"""Removal of the trail of a moving box, while walls, posts and thin trunks stay."""

import numpy as np
import pytest

from mapping.height_field import spinning_scan
from offpiste.core.errors import MapError
from offpiste.mapping.free_space import COLUMNS, ROWS, SLOPE, STEEPEST, FreeSpaceSettings, nearest_returns, passed
from offpiste.mapping.pipeline import FeatureCloud, MapPipeline, MapSettings
from offpiste.mapping.voxel_map import VoxelSettings

SMALL = VoxelSettings(reach=25.0, capacity=200_000)
SENSOR = np.array([0.0, 0.0, 1.9])


def flat(x, y):
    return np.zeros_like(x)


def behind(points, sensor, centre, size):
    """Points, with those that a box hides moved onto its side."""
    rays = points - sensor
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = [(centre + sign * np.asarray(size) / 2 - sensor) / rays for sign in (-1, 1)]
    enter, leave = np.minimum(*sides).max(axis=1), np.maximum(*sides).min(axis=1)
    hit = (enter < leave) & (enter > 0) & (enter < 1)
    return np.where(hit[:, None], sensor + rays * np.where(hit, enter, 0)[:, None], points)


def drive(free_space, *, box, things=(), scans=45):
    """A vehicle that drives 0.2 m a scan; a box crosses its way from left to right during the first 15 scans."""
    pipeline = MapPipeline(0, MapSettings(SMALL, free_space=free_space))
    still = spinning_scan(flat, SENSOR, rings=48, columns=384, furthest=30.0)
    for number in range(scans):
        ahead = np.array([0.2 * number, 0, 0])
        points = still + ahead
        points[:, 2] = still[:, 2]
        for centre, size in things:
            points = behind(points, SENSOR + ahead, np.asarray(centre), size)
        if box and number < 15:
            points = behind(points, SENSOR + ahead, np.array([8.0, 5.0 - 0.7 * number, 0.75]), (1.0, 2.0, 1.5))
        pipeline.add(FeatureCloud(points, SENSOR + ahead), ahead)
    layers = pipeline.layers()
    return layers, pipeline.voxel_map


def trail(layers):
    x = layers.origin[0] + layers.resolution * np.arange(layers.elevation.shape[1])
    y = layers.origin[1] + layers.resolution * np.arange(layers.elevation.shape[0])
    tall = np.nan_to_num(layers.obstacle_height) > 0.3
    return int(tall[np.ix_(np.abs(y) < 6, np.abs(x - 8) < 0.7)].sum())


def test_the_trail_of_a_moving_box_goes():
    with_trail, without = (
        trail(drive(free_space, box=True, scans=80)[0]) for free_space in (None, FreeSpaceSettings())
    )
    assert with_trail > 80
    assert without < 0.2 * with_trail


def test_what_stands_still_stays():
    things = [
        ((8.0, 3.0, 1.0), (0.1, 0.1, 2.0)),  # a thin trunk
        ((6.0, -3.0, 0.6), (0.1, 0.1, 1.2)),  # a post
        ((12.0, 0.0, 0.75), (0.3, 4.0, 1.5)),  # a wall
        ((9.0, -5.0, 0.4), (1.0, 1.0, 0.8)),  # a bush
    ]
    (before, held), (after, cleared) = (drive(s, box=False, things=things) for s in (None, FreeSpaceSettings()))
    assert (np.nan_to_num(before.obstacle_height) > 0.3).sum() > 20
    np.testing.assert_array_equal(before.obstacle_height, after.obstacle_height)
    assert held.occupied == cleared.occupied


@pytest.mark.parametrize("seed", range(2))
def test_loops_agree_with_plain_numpy(seed):
    rng = np.random.default_rng(seed)
    sensor = rng.uniform(-1e3, 1e3, 3)
    points = sensor + rng.normal(size=(4000, 3)) * [15, 15, 2]
    points[:2] = [[np.nan, 0, 0], sensor]
    left_out = rng.random(4000) < 0.1
    returns = nearest_returns(points, sensor, left_out)
    near, many = plain_image(points[~left_out], sensor)
    np.testing.assert_allclose(returns.near, near, rtol=1e-6)  # fused multiply-add
    np.testing.assert_array_equal(returns.many, many)

    settings = FreeSpaceSettings(reach=20.0, every=1, times=1, returns=3, beyond=0.2)
    pipeline = MapPipeline(0, MapSettings(SMALL, ghosts=None, free_space=settings))
    pipeline.voxel_map.recentre(sensor[:2], sensor[2])
    places = sensor + rng.uniform(-15, 15, (3000, 3)) * [1, 1, 0.1]
    distance = np.linalg.norm(places - sensor, axis=1).astype(np.float32)
    pipeline.voxel_map.insert(places, None, np.zeros(3000, bool), distance)
    before = held_places(pipeline.voxel_map)
    assert pipeline._free_space is not None
    gone = pipeline._free_space.clear(points, sensor, left_out)
    after = {tuple(place) for place in held_places(pipeline.voxel_map)[:, :3]}
    free = passed(returns, before[:, :3], sensor, settings) & (before[:, 3] > 0)
    expected = {tuple(place) for place in before[~free, :3]}
    assert gone > 20
    assert len(after ^ expected) <= 2  # places on a pixel's edge, rounded otherwise
    assert pipeline.voxel_map.occupied == len(after)


def held_places(held):
    """x, y, z of each voxel's hit, and its level in its column."""
    voxels, size, n = held.voxels, held.settings.size, held.cells
    result = []
    for j in range(held.low[1], held.low[1] + n):
        for i in range(held.low[0], held.low[0] + n):
            head = voxels.heads[j % n, i % n]
            for level in range(31):
                if head[1] >> level & 1:
                    x, y, z = voxels.seen[voxels.slots[j % n, i % n, level], :3].astype(float)
                    result.append(((i + 0.5 + x) * size, (j + 0.5 + y) * size, (head[0] + level + z) * size, level))
    return np.array(result)


def plain_image(points, sensor):
    x, y, z = (points - sensor).astype(np.float32).T
    with np.errstate(invalid="ignore", divide="ignore"):
        away, r = np.abs(x) + np.abs(y), np.sqrt(x * x + y * y)
        row = np.floor((z / r - np.float32(STEEPEST)) * np.float32(1 / SLOPE))
        around = np.where(x >= 0, 1 + y / away, 3 - y / away)
    nearest, count = np.full((ROWS, COLUMNS), np.inf, np.float32), np.zeros((ROWS, COLUMNS), int)
    for i in np.flatnonzero((away > 0.01) & (row >= 0) & (row < ROWS)):
        at = int(row[i]), min(int(around[i] * np.float32(COLUMNS / 4)), COLUMNS - 1)
        count[at] += 1
        nearest[at] = min(nearest[at], r[i])
    near, many = np.full_like(nearest, np.inf), np.zeros_like(count)
    for down in (-1, 0, 1):
        rows = slice(max(down, 0), ROWS + min(down, 0)), slice(max(-down, 0), ROWS + min(-down, 0))
        for along in (-1, 0, 1):
            near[rows[0]] = np.minimum(near[rows[0]], np.roll(nearest, along, axis=1)[rows[1]])
            many[rows[0]] += np.roll(count, along, axis=1)[rows[1]]
    return near, many


def test_settings_are_checked():
    with pytest.raises(MapError, match="free space"):
        FreeSpaceSettings(times=0)
