"""The cost map by hand: values of its layers at places on and off the map."""

import math

import numpy as np
import pytest
import torch

from offpiste.planning.cost_map import cost_map
from offpiste.planning.costs.layers import Hazards
from planning_maps import layers, straight

HERE = torch.zeros(2, dtype=torch.float64)


def test_unknown_ground_has_no_nan():
    ground = layers(9, 1.0)
    for part in (ground.slope, ground.roughness, ground.obstacle_height, ground.elevation):
        part[:] = np.nan
    ground.known[:] = False
    costs = cost_map(ground, straight(), Hazards())
    assert not costs.layers.isnan().any()
    assert (costs.layers[..., costs.names.index("hazard")] == Hazards().unknown).all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_places_find_their_nearest_cell_and_the_border_off_the_map(dtype):
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
