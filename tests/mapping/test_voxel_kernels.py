"""The compiled library against the plain functions on random input, and layers of changed columns against all."""

import inspect

import numpy as np
import pytest

from offpiste.mapping import voxel_map
from offpiste.mapping.ground import find_spans
from offpiste.mapping.terrain_map import empty_layers
from offpiste.mapping.voxel_map import FUSION_RULES, VoxelMap, VoxelSettings, voxels_in
from offpiste.mapping.voxels_to_layers import Flattener, FlattenSettings
from offpiste.native import library


def scan(rng, centre, n, features, spread=5.0):
    """Points of bumpy ground, bushes and branches around a place; some far off, some not numbers."""
    xy = centre[:2] + rng.uniform(-spread, spread, (n, 2))
    z = 0.3 * xy[:, 0] % 7 + 0.1 * np.sin(xy[:, 1]) + np.where(rng.random(n) < 0.3, rng.uniform(0, 9, n), 0)
    z += rng.normal(0, 0.02, n) + centre[2]
    points = np.column_stack((xy, z))
    points[::97] = np.nan
    points[1::89, rng.integers(3)] = np.inf
    points[2::83, 2] += 50
    distance = rng.uniform(0, 40, n).astype(np.float32)
    distance[3::79] = [np.nan, np.inf, -1.0][rng.integers(3)]
    values = rng.normal(size=(n, features)).astype(np.float32)
    if features:
        values[4::73, 0] = np.nan
    return points, values, rng.random(n) < 0.6, distance


def contents(held):
    """Heads, fields of each voxel in order, and numbers of the last changes; slots may be others."""
    index = np.arange(held.cells)
    row, column, level, slots = voxels_in(held.voxels, index, index)
    heads, fields = held.voxels.heads[row, column], held.voxels.seen[slots]
    np.testing.assert_array_equal(heads[level == 0, voxel_map.LOWEST], slots[level == 0])
    assert len(slots) == len(np.unique(slots)) == held.occupied
    fields[fields[:, voxel_map.FEATURE_HITS] == 0, voxel_map.FEATURES :] = 0  # not initialised
    return np.column_stack((row, column, level, heads[:, :3])), fields, held.voxels.changed


@pytest.mark.parametrize("rule", FUSION_RULES)
@pytest.mark.parametrize(("channels", "capacity"), [(0, 40_000), (3, 40_000), (3, 500)])
def test_voxels_are_the_same_without_the_library(rule, channels, capacity, monkeypatch):
    rng = np.random.default_rng(channels)
    threads = 2 if channels else 1
    settings = VoxelSettings(reach=4.0, height_reach=1e300, rule=rule, capacity=capacity, threads=threads)
    compiled, plain = VoxelMap(channels, settings), VoxelMap(channels, settings)
    for far in (0.0, 1.5, -1.0, 40.0, 4.5e6):
        centre = np.array([far, -far, 1e-4 * far])
        points, values, has, distance = scan(rng, centre, 3000, channels)
        points[5::50, 2] = centre[2] + rng.uniform(-25, 25, len(points[5::50]))
        points[6:10, 2] = -1e300, 1e300, 3e8, -3e8
        for held, rules in ((compiled, 3), (plain, 0)):
            monkeypatch.setattr(voxel_map, "COMPILED_RULES", rules)
            held.recentre(centre[:2], centre[2])
            held.insert(points, values, has, distance)
            held.insert(points[:9], None, has[:9], distance[:9])
            held.insert(points[:0], values[:0], has[:0], distance[:0])
        (where, fields, changed), (plain_where, plain_fields, plain_changed) = contents(compiled), contents(plain)
        assert len(fields) == len(plain_fields) > 100
        assert compiled.lost == plain.lost
        assert (compiled.lost > 0) == (capacity == 500)
        np.testing.assert_array_equal(where, plain_where)
        np.testing.assert_allclose(fields, plain_fields, atol=1e-5 if far < 1e6 else 1e-3, rtol=1e-5)
        np.testing.assert_array_equal(changed, plain_changed)


@pytest.mark.parametrize(
    ("channels", "size", "far", "settings"),
    [
        (0, 0.2, 1e5, FlattenSettings(plane_radius=0.4)),
        (3, 0.2, 4.5e6, FlattenSettings(0.1, 0.9, vehicle_height=1.0, overhang_radius=0.2, plane_radius=0.2)),
        (40, 0.2, 0.0, FlattenSettings(3.0, 0.0, vehicle_height=5.8, overhang_radius=0.0, plane_radius=0.6)),
        (2, 0.11, 1e5, FlattenSettings(plane_radius=0.6)),
    ],
)
def test_layers_and_cells_are_the_same_without_the_library(channels, size, far, settings, monkeypatch):
    """From an empty map on, with rows that wrap around, of widths that are no multiple of a vector's."""
    rng, compiled = np.random.default_rng(channels), library.library
    held = VoxelMap(channels, VoxelSettings(size=size, reach=3.0, height_reach=20.0, capacity=40_000))
    by_library, by_numpy, of_cells = (Flattener(held, settings) for _ in range(3))
    layers = None
    centre = np.array([far, -2 * far, 3.0])
    for step in range(6):
        if step:
            centre += rng.normal(0, [1.0, 1.0, 0.3]) * (20 if step == 3 else 1)
            held.recentre(centre[:2], centre[2])
            held.insert(*scan(rng, centre, 1200, channels))
        rows, columns = rng.integers(0, held.cells, (2, 33))
        cells, layers = by_library.cells(rows, columns), by_library.layers(layers)
        alone = of_cells.cells(rows, columns)  # without layers in between
        monkeypatch.setattr(library, "library", lambda: None)
        some, wanted = by_numpy.cells(rows, columns), by_numpy.layers()
        monkeypatch.setattr(library, "library", compiled)
        for name, value in vars(wanted).items():
            exact = name in ("known", "observed", "valid", "origin")
            room = {"atol": 0.0, "rtol": 0.0} if exact else {"atol": 3e-5, "rtol": 1e-4}
            np.testing.assert_allclose(getattr(layers, name), value, err_msg=name, **room)
        assert layers.known.any() == (step > 0)
        for name in cells._fields:
            for read in (cells, alone):
                np.testing.assert_array_equal(getattr(read, name), getattr(layers, name)[rows, columns])
            np.testing.assert_allclose(getattr(some, name), getattr(wanted, name)[rows, columns], atol=1e-6)


@pytest.mark.parametrize("rule", FUSION_RULES)
def test_reading_changed_columns_only_gives_the_same_bits_as_reading_all(rule):
    """Moves over every border and corner, back again, out of the map, scans without a move and moves without a scan."""
    rng = np.random.default_rng(0)
    held = VoxelMap(2, VoxelSettings(reach=3.0, height_reach=20.0, rule=rule, capacity=20_000))
    kept, layers, rare = Flattener(held, FlattenSettings()), None, Flattener(held, FlattenSettings())
    moves = [(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)] * 2 + [(9, 0), (-9, 0), (3, -3), (0.2, 0), (-0.2, 0.2)]
    centre = np.zeros(3)
    for number, move in enumerate(rng.permutation(moves)):
        centre[:2] += move
        held.recentre(centre[:2], 0.0)
        if number % 4 != 3:
            held.insert(*scan(rng, centre, 300, 2, spread=3.5))
        layers, wanted = kept.layers(layers), Flattener(held, FlattenSettings()).layers()
        for found in [layers, rare.layers()] if number % 5 == 4 else [layers]:
            for name, value in vars(wanted).items():
                np.testing.assert_array_equal(getattr(found, name), value, err_msg=f"{name} after {number}")


def test_arrays_that_do_not_fit_are_refused():
    held = VoxelMap(2, VoxelSettings(reach=3.0, capacity=100))
    cloud = np.zeros((3, 3)), np.zeros((3, 2), np.float32), np.ones(3, bool), np.ones(3)
    for number, wrong in enumerate((cloud[0][:, :2], *(array[:2] for array in cloud[1:]))):
        with pytest.raises(ValueError, match="number N"):
            inspect.unwrap(VoxelMap.insert)(held, *cloud[:number], wrong, *cloud[number + 1 :])
    assert held.occupied == 0
    flattener = Flattener(held, FlattenSettings())
    for cells, channels in ((32, 2), (30, 3), (28, 2)):
        with pytest.raises(ValueError, match="layers of another map"):
            flattener.layers(empty_layers(cells, channels))
    for row, column in ((-1, 0), (0, 30), (30, 0), (0, -1)):
        with pytest.raises(ValueError, match="outside the map"):
            flattener.cells(np.array([3, row]), np.array([3, column]))
    assert not len(flattener.cells(np.zeros(0, np.int64), np.zeros(0, np.int64)).known)


def test_spans_reach_as_far_as_the_margin_and_the_map():
    spans = find_spans(np.array([2, 2, 5]), np.array([4, 7, 0]), 1, 8)
    assert spans.tolist() == [[0, 0], [3, 8], [3, 8], [3, 8], [0, 2], [0, 2], [0, 2], [0, 0]]
