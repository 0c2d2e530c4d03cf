"""Courses and goals, and the point of a path nearest to each cell."""

import itertools
import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from offpiste.core.errors import PlanningError
from offpiste.planning.cost_map import cost_map
from offpiste.planning.costs.layers import Hazards
from offpiste.planning.course import ASTRAY, BLOCK, NEAR, Course, Goal, along_path, ways_from
from planning_maps import layers
from runtime.stream import course

SIZE = 0.2
"""Size of the cells in tests of `along_path` [m]."""


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
def test_a_path_of_no_length_is_refused(path):
    with pytest.raises(PlanningError, match="shorter than"):
        Course(path, np.ones(len(path)))


COURSES = """
import numpy as np
from offpiste.core.errors import PlanningError
from offpiste.planning.course import Course

for change in ({"speed": np.array([3.0, np.nan, 3.0])}, {"speed": np.ones(5)}, {"alternative": np.zeros((2, 2))}):
    try:
        Course(**{"path": np.array([[0.0, 0], [5, 0], [9, 0]]), "speed": np.ones(3), **change})
    except PlanningError as error:
        print(error.what)
"""


def test_what_does_not_go_with_its_path_is_refused():
    """Also where shapes are not checked, as they are in tests."""
    done = subprocess.run((sys.executable, "-c", COURSES), capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [
        "3 speeds for 3 points, or one that is not finite",
        "5 speeds for 3 points, or one that is not finite",
        "a second way of 2 points beside a path of 3",
    ]


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


def test_of_two_ways_the_nearer_one_counts():
    x = np.arange(-10.0, 11.0)
    upper, lower = (np.stack((x, side * 4 * np.cos(np.pi * x / 20) ** 2), axis=1) for side in (1, -1))
    speed = np.linspace(3.0, 7.0, 21)
    course, ground = Course(upper, speed, alternative=lower), layers(41, 0.5)
    found = course.layers(ground)
    one, other = Course(upper, speed).layers(ground), Course(lower, speed).layers(ground)
    nearer = one[..., :1] <= other[..., :1]
    np.testing.assert_array_equal(found, np.where(nearer, one, other))
    assert 0.2 < nearer.mean() < 0.8
    np.testing.assert_allclose(course.densified(0.5).alternative, Course(lower, speed).densified(0.5).path, atol=1e-9)


def test_one_way_until_they_part_and_once_the_other_is_far():
    line = course()

    def parted(apart):
        away = apart * np.clip((line.path[:, 0] - 20.0) / 10.0, 0.0, 1.0)
        return replace(line, alternative=line.path + np.stack((np.zeros_like(away), away), axis=1))

    assert [way.number for way in ways_from(line, np.zeros(2))] == [0]
    assert [way.number for way in ways_from(parted(0.5), np.zeros(2))] == [0]
    both = ways_from(parted(8.0), np.zeros(2))
    assert [way.number for way in both] == [0, 1]
    for way, path in zip(both, parted(8.0).ways, strict=True):
        np.testing.assert_array_equal(way.course.path, path)
        assert way.course.alternative is None
    section = Course(line.path[35:], line.speed[35:], np.inf, line.path[35:] + np.array((0.0, 8.0)))
    for y, numbers in ((0.0, [0]), (4.0 - 0.4 * ASTRAY, [0, 1]), (4.0, [0, 1]), (8.0, [1])):
        assert [way.number for way in ways_from(section, np.array((36.0, y)))] == numbers
