"""Compiled loops against plain NumPy on random input: every border, rule and move."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mapping import plain_map
from offpiste.mapping.voxel_map import FUSION_RULES, VoxelMap, VoxelSettings
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


def test_loops_stay_inside_their_arrays(bounds_checked):
    """Once more, compiled with bounds checks, in a process of its own."""
    code = f"import {Path(__file__).stem} as t; t.compare(); t.compare('average', 0, 3)"
    paths = os.pathsep.join((*map(str, Path(__file__).parents[:2]), os.environ.get("PYTHONPATH", "")))
    subprocess.run([sys.executable, "-c", code], env=bounds_checked | {"PYTHONPATH": paths}, check=True)


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
