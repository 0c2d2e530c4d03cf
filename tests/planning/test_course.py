"""Courses and goals: their layers, their ways, and the position of a vehicle along them."""

import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from factories import torch_threads
from offpiste.planning.course import ASTRAY, BLOCK, NEAR, Course, CourseTracker, Goal, along_path, ways_from
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


COURSES = """
import numpy as np
from offpiste.core.errors import PlanningError
from offpiste.planning.course import Course

for change in ({"speed": np.array([3.0, np.nan, 3.0])}, {"speed": np.ones(5)}, {"alternative": np.zeros((2, 2))},
               {"alternative": np.array([[0.0, 0], [5, np.nan], [9, 0]])},
               {"path": np.full((3, 2), 7.0)}, {"path": np.array([[0.0, 0], [np.nan, 1], [2, 2]])}):
    try:
        Course(**{"path": np.array([[0.0, 0], [5, 0], [9, 0]]), "speed": np.ones(3), **change})
    except PlanningError as error:
        print(error.what)
"""


def test_inconsistent_and_short_courses_are_refused():
    """Run without the checks of shapes that are active in tests."""
    done = subprocess.run((sys.executable, "-c", COURSES), capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [
        "3 speeds for 3 points, or a non-finite speed",
        "5 speeds for 3 points, or a non-finite speed",
        "the alternative has 2 points, the path 3",
        "the alternative has a non-finite point",
        *["the path of 3 points is not finite or shorter than 0.01 m"] * 2,
    ]


def winding(seed):
    """A path that bends, meets itself and comes back beside itself, a point every half cell."""
    corners = np.random.default_rng(seed).uniform(-12, 12, (9, 2))
    return Course(corners, np.ones(9)).densified(SIZE / 2).path


@pytest.mark.parametrize(("seed", "threads"), [(0, 1), (1, 2), (2, 2)])
def test_near_the_path_exact_and_far_to_a_fifth_of_a_cell_or_a_diagonal(seed, threads):
    path, x, y = winding(seed), SIZE * np.arange(-90, 61), SIZE * np.arange(-70, 83)
    with torch_threads(threads):
        found = along_path(path, np.arange(len(path), dtype=np.float32)[:, None], x, y)
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


def test_cells_of_a_single_column_have_their_own_nearest_points():
    path, y = np.column_stack((np.zeros(81), np.linspace(0.0, 20.0, 81))), np.arange(0.0, 20.0, 0.5)
    found = along_path(path, path[:, 1:].astype(np.float32), np.array([3.0]), y)
    np.testing.assert_allclose(found[:, 0], np.column_stack((np.full(len(y), 3.0), y)))


@pytest.mark.parametrize("nowhere", [np.nan, np.inf])
def test_without_a_finite_distance_the_values_are_those_of_a_point_of_the_path(nowhere):
    values = np.array([[1.0], [2.0], [99.0]], np.float32)[:2]  # the number that follows in memory is known
    for path, x in (([[nowhere, 0.0], [nowhere, 1.0]], 4.0), ([[0.0, 0.0], [9.0, 0.0]], nowhere)):
        found = along_path(np.array(path), values, np.array([x]), np.array([3.0]))
        assert not np.isfinite(found[0, 0, 0])
        assert found[0, 0, 1] in values


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


def eight():
    """A figure of eight that crosses itself at the origin."""
    t = np.linspace(0, 2 * np.pi, 400)
    return Course(np.stack((40 * np.sin(t), 20 * np.sin(2 * t)), axis=1), np.linspace(4.0, 8.0, 400))


def straight_to(x, path=((0.0, 0.0), (100.0, 0.0)), end=math.inf):
    """Tracker of a vehicle that drove along the x axis up to `x`."""
    tracker = CourseTracker(Course(np.array(path), np.full(len(path), 5.0), end))
    for step in np.arange(0.0, x + 1e-6, 10.0):
        tracker.move(np.array((step, 0.0)))
    return tracker


def test_where_a_course_crosses_itself_the_vehicle_stays_on_its_branch():
    course = eight()
    tracker, before = CourseTracker(course), 0.0
    for place in course.path:
        assert tracker.move(place) < 0.15
        assert 0 <= tracker.progress - before < 3.0
        before = tracker.progress
    assert tracker.progress == pytest.approx(tracker.length, abs=0.3)
    assert tracker.target == pytest.approx(8.0, abs=0.05)


def test_a_lost_vehicle_is_found_anywhere():
    tracker = CourseTracker(course := eight())
    for place in course.path:
        tracker.move(place)
    tracker.lose()
    assert tracker.move(course.path[37]) < 0.1
    at_37 = np.linalg.norm(np.diff(course.path[:38], axis=0), axis=1).sum()
    assert tracker.progress == pytest.approx(at_37, abs=0.3), "a simulator put it back"
    for place in course.path[37:200]:
        tracker.move(place)
    before = tracker.progress
    tracker.lose()
    tracker.move(np.zeros(2))
    assert tracker.progress == pytest.approx(before, abs=0.5), "at the crossing, the branch of the last position"
    tracker.move(course.path[0])
    assert tracker.progress == pytest.approx(before, abs=0.5), "it does not go back again"


def test_the_position_neither_goes_back_nor_skips_ahead():
    tracker = straight_to(0.0)
    assert tracker.move(np.array((3.1, -1.5))) == pytest.approx(1.5, abs=0.02)
    for x, progress in ((1.0, 3.1), (90.0, 3.1 + 12.0)):
        tracker.move(np.array((x, 0.0)))
        assert tracker.progress == pytest.approx(progress, abs=0.5)


def test_the_section_around_the_vehicle_also_after_backing_out():
    tracker = straight_to(60.0)
    assert tracker.move(np.array((55.0, 0.0))) == pytest.approx(0.0, abs=1e-6)
    assert tracker.move(np.array((21.0, 1.5))) == pytest.approx(1.5, abs=0.02)
    assert tracker.move(np.array((10.0, 0.0))) == pytest.approx(10.0, abs=0.3), "more than 40 m behind"
    assert tracker.progress == pytest.approx(60.0)
    section = tracker.stretch(at_most=3.0)
    assert (section.path[0, 0], section.path[-1, 0]) == pytest.approx((54.0, 120.0), abs=0.3)
    assert set(section.speed) == {3.0}
    assert tracker.stretch(backed_out=True).path[0, 0] == pytest.approx(40.0)
    assert len(straight_to(0.0, ((0.0, 0.0), (0.2, 0.0))).stretch().path) >= 2


def test_beyond_its_end_a_course_follows_its_path_and_then_a_straight_line():
    path = np.array([[0.0, 0.0], [50.0, 0.0], [50.0, 30.0]])
    tracker = straight_to(50.0, path, end=15.0)
    assert tracker.progress == tracker.length == pytest.approx(15.0)
    assert tracker.stretch().path[-1] == pytest.approx((50.0, 25.0), abs=0.3), "round the corner, not straight on"
    np.testing.assert_array_equal(Course(path, np.full(3, 5.0), 15.0).driven, path[:1])
    tracker = straight_to(50.0, path)
    for y in (10.0, 20.0, 30.0, 45.0):
        tracker.move(np.array((50.0, y)))
    assert tracker.progress == tracker.length == pytest.approx(80.0)
    np.testing.assert_allclose(tracker.stretch().path[-1], (50.0, 90.0), atol=0.3)


@pytest.mark.parametrize("side", [1, -1])
def test_on_either_of_two_ways_the_vehicle_is_on_its_course(side):
    x = np.linspace(0.0, 60.0, 121)
    upper, lower = (np.stack((x, s * 8 * np.sin(np.pi * x / 60) ** 2), axis=1) for s in (1, -1))
    tracker = CourseTracker(Course(upper, np.full(121, 5.0), 50.0, lower))
    arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(upper, axis=0), axis=1))))
    for place, length in zip(upper if side == 1 else lower, arc, strict=True):
        assert tracker.move(place) < 0.15
        assert tracker.progress == pytest.approx(min(length, 50.0), abs=0.3)
        if length > 49:
            break
    assert tracker.move(np.array((40.0, 0.0))) > 2.0, "between the ways it is off the course"
    section = tracker.stretch()
    np.testing.assert_allclose(section.alternative, section.path * (1, -1), atol=1e-9)
