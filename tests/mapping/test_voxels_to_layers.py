"""Conversion of voxels into layers: each rule alone, with answers worked out by hand."""

import numpy as np
import pytest
import torch

from mapping.test_voxel_map import SMALL, flatten, put
from offpiste.mapping.terrain_sampler import sample_maps, stack_maps
from offpiste.mapping.voxel_map import VoxelMap, VoxelSettings
from offpiste.mapping.voxels_to_layers import FlattenSettings, neighbour_offsets

N = 30


def column(heights, **options):
    """The layers' cell at (0.1, 0.1) with hits at heights; features are their numbers, None for a hit without any."""
    held = VoxelMap(1, SMALL)
    for number, z in heights:
        put(held, [0.1, 0.1, z], None if number is None else [number])
    layers = flatten(held, FlattenSettings(**options))
    assert layers.known.sum() == 13  # itself and the 12 neighbours within 0.4 m that it fills
    names = ("elevation", "obstacle_height", "features", "valid")
    return {name: getattr(layers, name)[N, N].tolist() for name in names}


def ground(rise_x, rise_y, *, scatter=0.0, keep=1.0):
    """A plane hit once in each cell, up to `scatter` from its centre, with `keep` of the hits; features are x."""
    rng = np.random.default_rng(0)
    held = VoxelMap(1, SMALL)
    centres = (np.mgrid[-N:N, -N:N].reshape(2, -1).T + 0.5) * 0.2
    xy = centres + rng.uniform(-scatter, scatter, centres.shape)
    points = np.column_stack((xy, rise_x * xy[:, 0] + rise_y * xy[:, 1] + 0.03))
    points = points[rng.random(len(points)) < keep]
    put(held, points, points[:, :1])
    return held


def test_the_lowest_voxel_is_the_ground_and_gives_the_features():
    found = column([(1, 0.1), (2, 0.7), (3, 1.5)])
    assert (found["features"], found["valid"]) == ([1.0], True)
    assert (found["elevation"], found["obstacle_height"]) == (pytest.approx(0.1), pytest.approx(1.4))


def test_features_count_within_half_a_metre_of_the_ground():
    assert column([(None, 0.1), (2, 0.55), (3, 0.9)])["features"] == [2.0]
    assert column([(None, 0.1), (2, 0.59)])["valid"]
    assert not column([(None, 0.1), (2, 0.61)])["valid"]
    assert column([(None, 0.1), (2, 0.61)], feature_height=0.6)["valid"]
    assert not column([(1, 1.0), (None, 0.1)])["valid"]  # ground found below a bush


def test_obstacles_reach_up_to_the_vehicles_height_and_branches_are_driven_under():
    assert column([(1, 0.1), (2, 2.05)])["obstacle_height"] == pytest.approx(1.95)
    assert column([(1, 0.1), (2, 2.15)])["obstacle_height"] == 0
    assert column([(1, 0.1), (2, 1.0), (3, 2.15), (4, 4.5)])["obstacle_height"] == pytest.approx(0.9)
    assert column([(1, 0.1), (2, 2.15)], vehicle_height=2.1)["obstacle_height"] == pytest.approx(2.05)


def test_a_branch_beside_ground_is_not_ground_up_to_a_metre_away():
    """A column with a branch 3 m up as its only hit takes the ground of its neighbour; a step of 1.9 m is ground."""
    held = VoxelMap(1, SMALL)
    put(held, [0.1, 0.1, 0.1], [1.0])
    put(held, [0.3, 0.1, 3.1], [2.0])
    layers = flatten(held)
    assert (layers.elevation[N, N + 1], layers.features[N, N + 1]) == (pytest.approx(0.1), 1)
    assert (layers.known[N, N + 1], layers.observed[N, N + 1]) == (True, False)
    put(held, [0.3, 0.1, 1.9], [3.0])
    layers = flatten(held)
    assert (layers.elevation[N, N + 1], layers.observed[N, N + 1]) == (pytest.approx(1.9), True)
    for cells, is_ground in ((5, False), (6, True)):
        held = VoxelMap(1, SMALL)
        put(held, [[0.1, 0.1, 0.1], [0.1 + 0.2 * cells, 0.1, 3.1]], [1.0])
        assert flatten(held).observed[N, N + cells] == is_ground
    steep = float(np.tan(np.radians(40)))
    for rise in ((steep, 0.0), (steep / np.sqrt(2), -steep / np.sqrt(2))):
        assert flatten(ground(*rise)).observed.all()


def test_gaps_are_filled_up_to_the_fill_radius():
    held = VoxelMap(1, SMALL)
    put(held, [0.1, 0.1, 0.13], [5.0], 7.0)
    layers = flatten(held)
    away = np.hypot(*(np.mgrid[-N:N, -N:N] * 0.2))
    np.testing.assert_array_equal(layers.known, away < 0.4 + 1e-9)
    np.testing.assert_array_equal(layers.valid, layers.known)
    assert layers.observed.sum() == 1
    np.testing.assert_allclose(layers.elevation[layers.known], 0.13, atol=1e-6)
    assert (layers.features[layers.known] == 5).all()
    assert (layers.distance[layers.known] == 7).all()
    fine = VoxelMap(1, VoxelSettings(size=0.1, reach=3.0, capacity=100))
    put(fine, [0.05, 0.05, 0.1], [1.0])
    for radius, known in ((0.4, False), (0.5, True)):  # (0.3, 0.4) m is 0.5 m away
        assert flatten(fine, FlattenSettings(fill_radius=radius)).known[N + 3, N + 4] == known


def test_the_nearest_cell_fills_a_gap_and_ties_go_to_the_lower_y_then_the_lower_x():
    for (one, other), wanted in (
        (((-2, 0), (0, 1)), 2),
        (((1, 0), (-1, 0)), 2),
        (((0, 1), (0, -1)), 2),
        (((-1, 0), (0, -1)), 2),
        (((1, 0), (0, 1)), 1),
    ):
        held = VoxelMap(1, SMALL)
        for feature, (right, up) in ((1.0, one), (2.0, other)):
            put(held, [0.1 + 0.2 * right, 0.1 + 0.2 * up, 0.1], [feature])
        layers = flatten(held)
        assert (float(layers.features[N, N, 0]), layers.observed[N, N]) == (wanted, False)
    assert neighbour_offsets(1.0).tolist() == [[0, 0], [-1, 0], [0, -1], [0, 1], [1, 0]]


def test_features_fill_a_hit_without_any_but_not_from_another_height():
    held = VoxelMap(1, SMALL)
    put(held, [0.1, 0.1, 0.1])
    put(held, [0.3, 0.1, 0.7], [1.0])  # nearest, but 0.6 m higher
    put(held, [0.1, 0.5, 0.5], [2.0])
    layers = flatten(held)
    assert (layers.observed[N, N], layers.features[N, N]) == (True, 2)
    assert layers.elevation[N, N] == pytest.approx(0.1)


PLANES = {"z = x": (1.0, 0.0), "z = y": (0.0, 1.0), "z = -x/2 + y/3": (-0.5, 1 / 3)}


@pytest.mark.parametrize("plane", PLANES)
def test_planes_have_their_normals_and_heights_wherever_in_the_cells_they_were_hit(plane):
    rise = PLANES[plane]
    layers = flatten(ground(*rise, scatter=0.09))
    up = np.array([-rise[0], -rise[1], 1.0]) / np.sqrt(1 + rise[0] ** 2 + rise[1] ** 2)
    np.testing.assert_allclose(layers.normal, np.broadcast_to(up, layers.normal.shape), atol=2e-5)
    np.testing.assert_allclose(layers.elevation, layers.centres @ rise + 0.03, atol=1e-5)
    np.testing.assert_allclose(layers.slope, np.hypot(*rise), atol=3e-5)
    np.testing.assert_allclose(layers.roughness, 0, atol=2e-5)
    place = torch.tensor([[0.0, 0.0], [1.234, -2.345], [-5.9, 5.9]], dtype=torch.float64)
    found = sample_maps(stack_maps([layers.terrain_map()]), torch.zeros(3).long(), place, torch.zeros(3, 2).double())
    torch.testing.assert_close(found.normal, torch.as_tensor(up).expand(3, 3), atol=2e-5, rtol=0)
    np.testing.assert_allclose(found.features[:, 0], place[:, 0], atol=0.1901)
    gaps = flatten(ground(*rise, scatter=0.09, keep=0.4))
    told = np.isfinite(gaps.slope)
    assert (0.3 < gaps.observed.mean() < 0.5, told.mean() > 0.95) == (True, True)
    np.testing.assert_allclose(gaps.normal[told, :2] / -gaps.normal[told, 2:], [rise] * told.sum(), atol=3e-4)


def test_bumps_of_a_checkerboard_are_its_roughness():
    """Cells alternate 2 cm up and down: planes stay level but for the odd cell."""
    held = VoxelMap(0, SMALL)
    j, i = np.mgrid[-N:N, -N:N]
    z = 0.1 + np.where((i + j) % 2, 0.02, -0.02)
    put(held, np.column_stack(((i.ravel() + 0.5) * 0.2, (j.ravel() + 0.5) * 0.2, z.ravel())))
    layers = flatten(held)
    inner = (slice(4, -4), slice(4, -4))
    # A window of 25 has 13 of one sign: its mean is 0.02 / 25 off zero, towards the cell itself.
    np.testing.assert_allclose(layers.roughness[inner], 0.02 * 24 / 25, atol=1e-5)
    np.testing.assert_allclose(layers.slope[inner], 0, atol=1e-5)
