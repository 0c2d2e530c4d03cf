"""Position of the vehicle along its course, and the section around it."""

import numpy as np
import pytest

from offpiste.planning.course import Course
from offpiste.runtime.course_tracker import CourseTracker, TrackerRange


def eight():
    """A figure of eight that crosses itself at the origin."""
    t = np.linspace(0, 2 * np.pi, 400)
    return Course(np.stack((40 * np.sin(t), 20 * np.sin(2 * t)), axis=1), np.linspace(4.0, 8.0, 400))


def test_where_a_course_crosses_itself_the_vehicle_stays_on_its_branch():
    course = eight()
    tracker, before = CourseTracker(course), 0.0
    for place in course.path:
        assert tracker.move(place) < 0.15
        assert 0 <= tracker.progress - before < 3.0
        before = tracker.progress
    assert tracker.progress == pytest.approx(tracker.length, abs=0.3)
    assert tracker.target == pytest.approx(8.0, abs=0.05)


def test_a_vehicle_that_was_lost_is_found_anywhere():
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
    assert tracker.progress == pytest.approx(before, abs=0.5), "at the crossing, of three branches on its own"
    tracker.move(course.path[0])
    assert tracker.progress == pytest.approx(before, abs=0.5), "it does not go back again"


def test_distance_beside_a_straight_course():
    tracker = CourseTracker(Course(np.array([[0.0, 0.0], [100.0, 0.0]]), np.full(2, 5.0)))
    assert tracker.move(np.array((3.1, -1.5))) == pytest.approx(1.5, abs=0.02)
    assert tracker.progress == pytest.approx(3.1, abs=0.13)
    # It never goes back, and never skips further than its search.
    tracker.move(np.array((1.0, 0.0)))
    assert tracker.progress == pytest.approx(3.1, abs=0.13)
    tracker.move(np.array((90.0, 0.0)))
    assert tracker.progress == pytest.approx(3.1 + 12.0, abs=0.5)


def test_behind_its_position_the_vehicle_is_on_its_course():
    tracker = CourseTracker(Course(np.array([[0.0, 0.0], [100.0, 0.0]]), np.full(2, 5.0)))
    for x in range(0, 61, 10):
        tracker.move(np.array((float(x), 0.0)))
    assert tracker.move(np.array((55.0, 0.0))) == pytest.approx(0.0, abs=1e-6)
    assert tracker.move(np.array((21.0, 1.5))) == pytest.approx(1.5, abs=0.02)
    assert tracker.move(np.array((10.0, 0.0))) == pytest.approx(10.0, abs=0.3), "more than 40 m behind"
    assert tracker.progress == pytest.approx(60.0)
    assert tracker.stretch().path[0, 0] == pytest.approx(54.0)
    assert tracker.stretch(backed_out=True).path[0, 0] == pytest.approx(40.0)


def test_the_stretch_is_the_section_around_the_vehicle():
    tracker = CourseTracker(
        Course(np.array([[0.0, 0.0], [100.0, 0.0]]), np.full(2, 5.0)), TrackerRange(back=5.0, ahead=20.0)
    )
    for x in range(0, 51, 10):
        tracker.move(np.array((float(x), 0.0)))
    stretch = tracker.stretch(at_most=3.0)
    assert stretch.path[0, 0] == pytest.approx(45.0, abs=0.3)
    assert stretch.path[-1, 0] == pytest.approx(70.0, abs=0.3)
    assert set(stretch.speed) == {3.0}
    for x in range(50, 101, 10):
        tracker.move(np.array((float(x), 0.0)))
    assert len(CourseTracker(Course(np.array([[0.0, 0.0], [0.2, 0.0]]), np.full(2, 5.0))).stretch().path) >= 2


def test_beyond_its_path_a_course_is_extended_straight():
    path = np.array([[0.0, 0.0], [50.0, 0.0], [50.0, 30.0]])
    tracker = CourseTracker(Course(path, np.array([5.0, 5.0, 3.0])), TrackerRange(back=5.0, ahead=20.0))
    for place in (*np.linspace(path[0], path[1], 9), *np.linspace(path[1], path[2], 9)):
        tracker.move(place)
    stretch = tracker.stretch()
    np.testing.assert_allclose(stretch.path[-1], (50.0, 50.0), atol=0.3)
    assert stretch.speed[-1] == pytest.approx(3.0)
    # But it is driven at its own end.
    tracker.move(np.array((50.0, 45.0)))
    assert tracker.progress == tracker.length == pytest.approx(80.0)


def test_beyond_its_end_a_course_follows_its_path():
    path = np.array([[0.0, 0.0], [50.0, 0.0], [50.0, 30.0]])
    course = Course(path, np.full(3, 5.0), end=40.0)
    tracker = CourseTracker(course, TrackerRange(back=5.0, ahead=20.0))
    for x in range(0, 51, 10):
        tracker.move(np.array((float(x), 0.0)))
    assert tracker.progress == tracker.length == pytest.approx(40.0)
    assert tracker.stretch().path[-1] == pytest.approx((50.0, 10.0), abs=0.3), "round the corner, not straight on"
    np.testing.assert_array_equal(course.driven, path[:1])
    np.testing.assert_array_equal(Course(path, np.full(3, 5.0)).driven, path)


@pytest.mark.parametrize("side", [1, -1])
def test_on_either_of_two_ways_the_vehicle_is_on_its_course(side):
    x = np.linspace(0.0, 60.0, 121)
    upper, lower = (np.stack((x, s * 8 * np.sin(np.pi * x / 60) ** 2), axis=1) for s in (1, -1))
    tracker = CourseTracker(Course(upper, np.full(121, 5.0), 50.0, lower), TrackerRange(back=5.0, ahead=20.0))
    driven = upper if side == 1 else lower
    arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(upper, axis=0), axis=1))))
    for place, length in zip(driven, arc, strict=True):
        assert tracker.move(place) < 0.15
        assert tracker.progress == pytest.approx(min(length, 50.0), abs=0.3)
        if length > 49:
            break
    assert tracker.move(np.array((40.0, 0.0))) > 2.0, "between the ways it is off the course"
    section = tracker.stretch()
    assert len(section.alternative) == len(section.path)
    np.testing.assert_allclose(section.alternative, section.path * (1, -1), atol=1e-9)
