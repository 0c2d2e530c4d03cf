"""Kinds of courses in synthetic worlds with a known best course."""

from dataclasses import replace

import numpy as np
import pytest

from offpiste.closed_loop.courses import (
    PASSAGE_TRACTION,
    RELIEF,
    RUN_OUT,
    CourseSettings,
    choose_course,
    course_world,
    traction_along,
)
from offpiste.core.errors import OffpisteError
from offpiste.simulation.world.forks import ASIDE, WEAVE
from offpiste.simulation.world.world import WorldSettings
from simulation.drives import flat_world

PLACE = WorldSettings("mojave", seed=5, resolution=0.5)


def circle(x, radius=50.0):
    angle = np.linspace(0, 2 * np.pi, 628, endpoint=False)
    return radius * np.stack((np.cos(angle), np.sin(angle)), axis=1) + (x, 0.0)


def made_up(sinkage):
    """A plain with a circle of trail on either side: on ordinary ground where x > 0, and soft where x < 0."""
    world = flat_world(properties=(0.5, 6.0, 0.05, 0.0), size=(240.0, 240.0))
    world.properties[:, :120, 3] = sinkage
    return replace(world, trails=(circle(-60.0), circle(60.0)))


def test_a_passage_leads_through_the_softest_ground_that_can_be_driven():
    settings = CourseSettings("passages")
    soft = choose_course(made_up(sinkage=0.5 - 0.05 - PASSAGE_TRACTION - 0.01), 1, settings).course
    assert soft.path[:, 0].max() < 0
    impassable = choose_course(made_up(sinkage=0.5 - 0.05 - PASSAGE_TRACTION + 0.01), 1, settings).course
    assert impassable.path[:, 0].min() > 0


def test_passages_lie_in_hills_twice_as_high_and_are_the_same_for_a_seed():
    world = course_world(PLACE, "passages")
    assert world.settings == replace(PLACE, relief=RELIEF)
    first, second = (choose_course(world, 5, CourseSettings("passages")).course for _ in range(2))
    np.testing.assert_array_equal(first.path, second.path)
    assert traction_along(world, first.driven).min() >= PASSAGE_TRACTION


def test_a_choice_has_two_ways_of_one_length_and_knows_the_firm_one():
    world = course_world(PLACE, "choices")
    chosen = choose_course(world, 5, CourseSettings("choices"))
    course = chosen.course
    np.testing.assert_array_equal(course.path, choose_course(world, 5, CourseSettings("choices")).course.path)
    first, second = (way[course.before_end] for way in course.ways)
    lengths = [np.linalg.norm(np.diff(way, axis=0), axis=1).sum() for way in (first, second)]
    assert lengths[0] == pytest.approx(lengths[1], abs=3.0)
    apart = np.linalg.norm(course.path - course.alternative, axis=1)
    assert apart.max() == pytest.approx(2 * (ASIDE + WEAVE), abs=0.2)
    assert apart[:38].max() < 0.01, "before the fork"
    assert apart[-round(RUN_OUT) - 25 :].max() < 0.01, "behind it"
    least = [traction_along(world, way).min() for way in (first, second)]
    assert least[chosen.firm] > least[1 - chosen.firm] >= CourseSettings().traction
    trails = np.concatenate(world.trails)
    for way in course.ways:
        assert np.linalg.norm(way[:, None] - trails[None], axis=-1).min(axis=1).max() < 0.5
        assert np.linalg.norm(np.diff(way, axis=0), axis=1) == pytest.approx(1.0, abs=0.35)
    heading = np.array((np.cos(chosen.start.yaw), np.sin(chosen.start.yaw)))
    assert (course.path[3] - course.path[0]) @ heading > 2.9


def test_a_world_without_forks_and_an_unknown_kind_are_one_line():
    with pytest.raises(
        OffpisteError, match=r"'uniform', seed 0: no stretch of trail is suitable for a course \(choices\)"
    ):
        choose_course(made_up(0.0), 1, CourseSettings("choices"))
    with pytest.raises(OffpisteError, match=r"'choice'.*choices"):
        course_world(PLACE, "choice")
