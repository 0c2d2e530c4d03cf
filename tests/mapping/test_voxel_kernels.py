"""Compiled loops against plain NumPy on random input: every border, rule and move."""

import inspect

import numpy as np
import pytest

from mapping import plain_map
from offpiste.mapping import voxel_map
from offpiste.mapping.voxel_map import FUSION_RULES, VoxelMap, VoxelSettings, voxels_in
from offpiste.mapping.voxels_to_layers import Flattener, FlattenSettings


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


def assert_same(layers, wanted, tolerance):
    for name in ("known", "observed", "valid"):
        np.testing.assert_array_equal(getattr(layers, name), getattr(wanted, name), err_msg=name)
    for name in ("elevation", "normal", "slope", "roughness", "obstacle_height", "features", "distance"):
        found, right = getattr(layers, name), getattr(wanted, name)
        np.testing.assert_allclose(found, right, atol=tolerance, rtol=1e-4, err_msg=name)
    np.testing.assert_array_equal(layers.origin, wanted.origin)


def compare(rule="closest", features=3, threads=2, seed=0, far=0.0, flat=None, scans=8):
    """Drive about, insert, flatten at every step into the same memory."""
    rng = np.random.default_rng(seed)
    settings = VoxelSettings(size=0.2, reach=4.0, height_reach=20.0, rule=rule, capacity=40_000, threads=threads)
    flat = flat or FlattenSettings()
    found, wanted = VoxelMap(features, settings), plain_map.empty_reference(features, settings)
    flattener, layers = Flattener(found, flat), None
    centre = np.array([far, -far, 0.5 * far / 1e4])
    for step in range(scans):
        centre = centre + rng.normal(0, [1.0, 1.0, 0.3]) * (20 if step == 5 else 1)
        found.recentre(centre[:2], centre[2])
        wanted = plain_map.recentred(wanted, centre[:2], float(centre[2]))
        cloud = scan(rng, centre, 1500, features)
        found.insert(*cloud)
        wanted = plain_map.inserted(wanted, *cloud)
        assert found.lost == 0
        assert found.occupied == len(wanted.places.cell)
        layers = flattener.layers(layers)
        assert_same(layers, plain_map.flattened(wanted, flat), 3e-5)
    assert 0.1 < layers.observed.mean() < 0.95
    assert layers.valid.any()


@pytest.mark.parametrize("rule", FUSION_RULES)
@pytest.mark.parametrize("features", [0, 40])
def test_loops_agree_with_numpy(rule, features):
    compare(rule, features, seed=features)


def test_loops_agree_with_numpy_with_other_settings_and_at_utm_coordinates():
    compare(flat=FlattenSettings(0.1, 0.9, vehicle_height=1.0, overhang_radius=0.2, plane_radius=0.2), threads=1)
    compare(flat=FlattenSettings(3.0, 0.0, vehicle_height=5.8, overhang_radius=0.0, plane_radius=0.6), threads=1)
    compare(far=4.5e6)


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
def test_the_library_agrees_with_its_plain_functions(rule, channels, capacity, monkeypatch):
    rng = np.random.default_rng(channels)
    settings = VoxelSettings(reach=4.0, height_reach=1e300, rule=rule, capacity=capacity)
    library, plain = VoxelMap(channels, settings), VoxelMap(channels, settings)
    for far in (0.0, 1.5, -1.0, 40.0, 4.5e6):
        centre = np.array([far, -far, 1e-4 * far])
        points, values, has, distance = scan(rng, centre, 3000, channels)
        points[5::50, 2] = centre[2] + rng.uniform(-25, 25, len(points[5::50]))
        points[6:10, 2] = -1e300, 1e300, 3e8, -3e8
        for held, rules in ((library, 3), (plain, 0)):
            monkeypatch.setattr(voxel_map, "COMPILED_RULES", rules)
            held.recentre(centre[:2], centre[2])
            held.insert(points, values, has, distance)
            held.insert(points[:9], None, has[:9], distance[:9])
            held.insert(points[:0], values[:0], has[:0], distance[:0])
        (where, fields, changed), (plain_where, plain_fields, plain_changed) = contents(library), contents(plain)
        assert len(fields) == len(plain_fields) > 100
        assert library.lost == plain.lost
        assert (library.lost > 0) == (capacity == 500)
        np.testing.assert_array_equal(where, plain_where)
        np.testing.assert_allclose(fields, plain_fields, atol=1e-5 if far < 1e6 else 1e-3, rtol=1e-5)
        np.testing.assert_array_equal(changed, plain_changed)


def test_arrays_of_other_shapes_are_refused():
    held = VoxelMap(2, VoxelSettings(reach=2.0, capacity=100))
    cloud = np.zeros((3, 3)), np.zeros((3, 2), np.float32), np.ones(3, bool), np.ones(3)
    for number, wrong in enumerate((cloud[0][:, :2], *(array[:2] for array in cloud[1:]))):
        with pytest.raises(ValueError, match="number N"):
            inspect.unwrap(VoxelMap.insert)(held, *cloud[:number], wrong, *cloud[number + 1 :])
    assert held.occupied == 0


@pytest.mark.parametrize("rule", FUSION_RULES)
def test_reading_changed_columns_only_gives_the_same_bits_as_reading_all(rule):
    """Moves over every border and corner, back again, out of the map, scans without a move and moves without a scan."""
    rng = np.random.default_rng(0)
    settings = VoxelSettings(reach=3.0, height_reach=20.0, rule=rule, capacity=20_000)
    held = VoxelMap(2, settings)
    kept, layers, rare = Flattener(held, FlattenSettings()), None, Flattener(held, FlattenSettings())
    moves = [(dx, dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1)] * 2 + [(9, 0), (-9, 0), (3, -3), (0.2, 0), (-0.2, 0.2)]
    centre = np.zeros(3)
    for number, move in enumerate(rng.permutation(moves)):
        centre[:2] += move
        held.recentre(centre[:2], 0.0)
        if number % 4 != 3:
            held.insert(*scan(rng, centre, 300, 2, spread=3.5))
        layers = kept.layers(layers)
        wanted = Flattener(held, FlattenSettings()).layers()
        others = [layers, rare.layers()] if number % 5 == 4 else [layers]
        for found in others:
            for name, value in vars(wanted).items():
                np.testing.assert_array_equal(getattr(found, name), value, err_msg=f"{name} after {number}")
