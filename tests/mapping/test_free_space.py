"""Removal of the trail of a moving box, while walls, posts and thin trunks stay."""

import inspect

import numpy as np
import pytest

from mapping.height_field import spinning_scan
from mapping.test_voxel_kernels import contents
from offpiste.mapping import free_space
from offpiste.mapping.free_space import FreeSpace, FreeSpaceSettings, nearest_returns
from offpiste.mapping.pipeline import FeatureCloud, MapPipeline, MapSettings
from offpiste.mapping.voxel_map import VoxelMap, VoxelSettings

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
    on_the_way = (np.abs(layers.centres - [8.0, 0.0]) < [0.7, 6.0]).all(axis=-1)
    return int((np.nan_to_num(layers.obstacle_height[on_the_way]) > 0.3).sum())


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


def test_an_image_holds_the_returns_of_the_pixels_around_each_direction():
    """The last column is beside the first; the last row is not beside the first."""
    points = SENSOR + np.array([[1e-3, -5.0, 0.0], [-1e-3, -7.0, 0.0], [0.0, 6.0, -5.9], [0.0, 6.0, 3.55], [0, 1, 0]])
    image = nearest_returns(points, SENSOR, np.array([False, False, False, False, True]))
    np.testing.assert_array_equal(image.many[40, [253, 254, 255, 0, 1, 2]], [0, 1, 2, 2, 1, 0])
    np.testing.assert_allclose(image.near[40, [253, 254, 255, 0, 1, 2]], [np.inf, 7, 5, 5, 5, np.inf], rtol=1e-6)
    np.testing.assert_array_equal(image.many[[0, 1, 2, 40, 62, 63], 128], [1, 1, 0, 0, 1, 1])
    assert image.many.sum() == 9 + 9 + 6 + 6


@pytest.mark.parametrize("seed", range(3))
def test_voxels_are_cleared_alike_without_the_library(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    sensor = rng.uniform(-1e3, 1e3, 3)
    clouds = [sensor + rng.normal(size=(n, 3)) * [15, 15, 2] for n in (4000, 0, 3000, 4000)]
    clouds[0][:5] = [[np.nan, 0, 0], sensor, [np.inf, 0, 0], [1e300, 0, 0], SENSOR]
    places = sensor + rng.uniform(-15, 15, (5000, 3)) * [1, 1, 0.1]
    left_out = [rng.random(len(points)) < 0.1 for points in clouds]
    settings = FreeSpaceSettings(reach=12.0, every=2, times=2, returns=3, beyond=0.2)
    found = []
    for put, clear in (
        (free_space.put_returns, free_space.clear_passed),
        (free_space.put_returns.plain, free_space.clear_passed.plain),
    ):
        monkeypatch.setattr(free_space, "put_returns", put)
        monkeypatch.setattr(free_space, "clear_passed", clear)
        held = VoxelMap(1, SMALL)
        held.recentre(sensor[:2] + np.array([15.0, 0.0]), sensor[2])  # rows of the sensor's square end at the border
        held.insert(places, places[:, :1], np.ones(5000, bool), np.ones(5000))
        space = FreeSpace(held, settings)
        gone = [space.clear(points, sensor, mask) for points, mask in zip(clouds, left_out, strict=True)]
        gone += [space.clear(clouds[0], np.array([x, 0.0, 0.0]), left_out[0]) for x in (np.nan, 1e300, -1e300)]
        image = nearest_returns(clouds[0], sensor, left_out[0])
        found.append((gone, image.many, held.occupied, *contents(held)))
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)
    assert sum(gone) > 15


def test_arrays_of_other_shapes_are_refused():
    points, mask = np.zeros((3, 3)), np.zeros(3, bool)
    for given in (
        (points[:, :2], SENSOR, mask),
        (points, SENSOR, mask[:2]),
        (points, SENSOR[:2], mask),
        (points, SENSOR[None], mask),
    ):
        with pytest.raises(ValueError, match="points, left_out and sensor have shapes"):
            inspect.unwrap(nearest_returns)(*given)
