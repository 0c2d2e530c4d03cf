"""The point of a path nearest to cells, against looking at all of them."""

import numpy as np
import pytest
import torch
from scipy.ndimage import distance_transform_edt

from offpiste.planning.costs.layers import Hazards, hazard_layers
from offpiste.planning.course import BLOCK, NEAR, Course, along_path
from planning_maps import layers

SIZE = 0.2


def winding(seed):
    """A path that bends, meets itself and comes back beside itself, a point every half cell."""
    corners = np.random.default_rng(seed).uniform(-12, 12, (9, 2))
    return Course(corners, np.ones(9)).densified(SIZE / 2).path


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("threads", [1, 2])
def test_near_the_path_exact_and_far_to_a_fifth_of_a_cell_or_a_diagonal(seed, threads):
    path, x, y = winding(seed), SIZE * np.arange(-90, 61), SIZE * np.arange(-70, 83)
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    found = along_path(path, np.arange(len(path), dtype=np.float32)[:, None], x, y)
    torch.set_num_threads(before)
    away = np.sqrt((x[None, :, None] - path[:, 0]) ** 2 + (y[:, None, None] - path[:, 1]) ** 2)
    least, number = away.min(axis=-1), found[..., 1].astype(int)
    # Distances are those of the points that are named.
    np.testing.assert_allclose(found[..., 0], np.take_along_axis(away, number[..., None], -1)[..., 0], rtol=1e-6)
    diagonal = np.sqrt(2) * BLOCK * SIZE
    near = least < NEAR * BLOCK * SIZE - diagonal
    assert near.mean() > 0.2
    np.testing.assert_allclose(found[..., 0][near], least[near], rtol=1e-6)
    further = found[..., 0] - least
    assert further.max() < diagonal
    assert (further[~near] < 0.2 * SIZE).mean() > 0.9


def test_a_path_of_two_points_and_hardly_any_cells():
    path, values = np.array([[0.0, 0.0], [9.0, 0.0]]), np.array([[1.0], [2.0]], np.float32)
    found = along_path(path, values, np.array([4.0]), np.array([3.0]))
    np.testing.assert_allclose(found, [[[5.0, 1.0]]])
    np.testing.assert_allclose(along_path(path, values, np.array([4.0, 6.0]), np.array([4.0]))[0, 1], [5.0, 2.0])


@pytest.mark.parametrize("margin", [0.0, 0.5, 1.6])
def test_obstacles_reach_as_far_as_their_distance_says(margin):
    ground = layers(50, 0.4)
    ground.obstacle_height[:] = np.random.default_rng(0).random((50, 50)) > 0.97
    ground.obstacle_height[7] = np.nan
    hazard = hazard_layers(ground, Hazards(obstacle=1.0, height=0.5, margin=margin))[..., 0]
    wanted = distance_transform_edt(~(ground.obstacle_height > 0.5), sampling=0.4) <= margin + 1e-6
    np.testing.assert_array_equal(hazard == 1, wanted)
