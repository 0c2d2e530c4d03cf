"""Cost maps by hand: hazards, speed limits, distances, directions."""

import itertools
import math

import numpy as np
import pytest
import torch

from offpiste.errors import PlanningError
from offpiste.planning.cost_map import cost_map
from offpiste.planning.costs.layers import Hazards, hazard_layers, speed_limit
from offpiste.planning.course import Course, Goal
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


def test_what_nothing_is_known_of_has_no_nan():
    ground = layers(9, 1.0)
    for part in (ground.slope, ground.roughness, ground.obstacle_height, ground.elevation):
        part[:] = np.nan
    ground.known[:] = False
    costs = cost_map(ground, straight(), Hazards())
    assert not costs.layers.isnan().any()
    assert (costs.layers[..., costs.names.index("hazard")] == Hazards().unknown).all()


def test_distance_and_direction_of_a_bent_path():
    ground = layers(41, 0.5)
    course = Course(np.array([[-10.0, 0.0], [5.0, 0.0], [5.0, 10.0]]), np.array([4.0, 4.0, 8.0]))
    found = course.layers(ground)

    def at(x, y):
        return found[round((y + 10) / 0.5), round((x + 10) / 0.5)]

    np.testing.assert_allclose(at(0, 3), [3, 1, 0, 4], atol=1e-6)
    np.testing.assert_allclose(at(0, -3), [3, 1, 0, 4], atol=1e-6)
    np.testing.assert_allclose(at(8, 5), [3, 0, 1, 6], atol=0.02)
    np.testing.assert_allclose(np.linalg.norm(found[..., 1:3], axis=-1), 1, atol=1e-6)


def test_distance_against_brute_force():
    ground, random = layers(15, 1.0), np.random.default_rng(0)
    path = random.uniform(-7, 7, (4, 2))
    found = Course(path, np.ones(4)).layers(ground)[..., 0]
    for j, i in ((0, 0), (7, 3), (14, 14), (2, 12)):
        place = ground.origin + np.array([i, j])
        ends = itertools.pairwise(path)
        near = [a + np.clip((place - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1) * (b - a) for a, b in ends]
        assert found[j, i] == pytest.approx(min(np.linalg.norm(place - p) for p in near), abs=0.25)


def test_points_are_added_evenly():
    dense = Course(np.array([[0.0, 0.0], [0.0, 3.0], [4.0, 3.0]]), np.array([1.0, 1.0, 5.0])).densified(0.5)
    np.testing.assert_allclose(np.linalg.norm(np.diff(dense.path, axis=0), axis=-1), 0.5)
    assert dense.speed[-1] == 5


def test_a_goal_is_straight_ahead_from_everywhere():
    ground = layers(21, 1.0)
    found = Goal(np.array([3.0, 4.0]), 6.0, braking=2.0).layers(ground)
    np.testing.assert_allclose(found[10, 10], [0, 0.6, 0.8, math.sqrt(20)], atol=1e-6)
    np.testing.assert_allclose(found[14, 13, 3], 0)
    assert found[0, 0, 3] == 6
    costs = cost_map(ground, Goal(np.array([3.0, 4.0]), 6.0, braking=2.0), Hazards())
    np.testing.assert_allclose(costs.layers[..., 2:].numpy(), found, rtol=1e-6)


@pytest.mark.parametrize("path", [np.full((3, 2), 7.0), np.zeros((1, 2)), np.array([[0.0, 0.0], [np.nan, 1.0]])])
def test_a_path_that_leads_nowhere_is_refused(path):
    with pytest.raises(PlanningError, match="leads nowhere"):
        Course(path, np.ones(len(path)))


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
