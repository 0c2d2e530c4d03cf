"""Map layers of the cost map by hand: hazards and speed limits."""

import math

import numpy as np
import pytest
import torch
from scipy.ndimage import distance_transform_edt

from offpiste.planning.costs.layers import Hazards, cost_map, hazard_layers, speed_limit
from planning_maps import layers, straight

HERE = torch.zeros(2, dtype=torch.float64)


def test_speed_limit_of_a_sine():
    limit, length, acceleration = 4.0, 3.0, 6.0
    roughness = acceleration / (2 * math.pi * limit / length) ** 2 / math.sqrt(2)
    assert speed_limit(np.array([roughness]), acceleration, length)[0] == pytest.approx(limit)
    assert np.isinf(speed_limit(np.array([0.0, np.nan]), acceleration, length)).all()


def test_hazards_of_cells():
    ground = layers(21, 1.0)
    ground.obstacle_height[10, 10], ground.obstacle_height[3, 3] = 0.5, 0.2
    ground.slope[0, 0], ground.slope[0, 1] = 0.55, np.nan
    ground.known[20, 5] = False
    hazards = Hazards(obstacle=100.0, margin=1.2, unknown=7.0, steep=30.0, steepest=0.45)
    hazard = hazard_layers(ground, hazards)[..., 0]
    wanted = np.zeros((21, 21))
    for j, i in ((10, 10), (9, 10), (11, 10), (10, 9), (10, 11)):
        wanted[j, i] = 100
    wanted[0, 0], wanted[20, 5] = 3, 7
    np.testing.assert_allclose(hazard, wanted, atol=1e-5)


def test_low_obstacles_may_count_less_than_tall_ones():
    ground = layers(21, 1.0)
    ground.obstacle_height[4, 4], ground.obstacle_height[14, 14], ground.obstacle_height[14, 13] = 1.2, 1.6, 1.2
    hazard = hazard_layers(ground, Hazards(obstacle=100.0, margin=1.2, low=0.05, tall=1.5))[..., 0]
    assert hazard[4, 4] == hazard[4, 5] == pytest.approx(5.0)
    assert hazard[14, 14] == hazard[14, 13] == hazard[14, 15] == 100.0
    assert hazard[14, 12] == pytest.approx(5.0), "near the low one alone"
    assert hazard[9, 9] == 0


@pytest.mark.parametrize("margin", [0.0, 0.5, 1.6])
def test_obstacles_reach_as_far_as_their_distance_says(margin):
    ground = layers(50, 0.4)
    ground.obstacle_height[:] = np.random.default_rng(0).random((50, 50)) > 0.97
    ground.obstacle_height[7] = np.nan
    hazard = hazard_layers(ground, Hazards(obstacle=1.0, height=0.5, margin=margin))[..., 0]
    wanted = distance_transform_edt(~(ground.obstacle_height > 0.5), sampling=0.4) <= margin + 1e-6
    np.testing.assert_array_equal(hazard == 1, wanted)


def test_unknown_ground_has_no_nan():
    ground = layers(9, 1.0)
    for part in (ground.slope, ground.roughness, ground.obstacle_height, ground.elevation):
        part[:] = np.nan
    ground.known[:] = False
    costs = cost_map(ground, straight(), Hazards())
    assert not costs.layers.isnan().any()
    assert (costs.layers[..., costs.names.index("hazard")] == Hazards().unknown).all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_places_read_their_nearest_cell_and_off_the_map_the_outside_value(dtype):
    ground = layers(5, 1.0)
    ground.obstacle_height[1, 3] = 1.0  # at x = 1, y = -1
    ground.roughness[:] = 0.1
    costs = cost_map(ground, straight(), Hazards(margin=0.1, obstacle=9.0, unknown=5.0))
    place = torch.tensor([[1.4, -1.4], [1.6, -1.0], [2.4, 2.4], [2.6, 0.0], [0.0, -99.0]], dtype=dtype)
    found = costs.at(place, HERE)
    assert found[:, 0].tolist() == [9, 0, 0, 5, 5]
    assert found[:, 1].isinf().tolist() == [False, False, False, True, True]
    assert found[:, 2].tolist() == [1, 1, 2, 0, 2]
    shifted = costs.at(place - 100, HERE + 100)
    torch.testing.assert_close(shifted, found)


def test_a_place_that_is_not_finite_has_no_distance():
    costs = cost_map(layers(5, 1.0), straight(), Hazards())
    found = costs.at(torch.tensor([[math.nan, 0.0], [0.0, math.inf], [0.0, 0.0]]), HERE)
    assert found[:, 2].isnan().tolist() == [True, True, False]
