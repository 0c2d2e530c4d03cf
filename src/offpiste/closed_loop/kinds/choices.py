"""Choices: the trail parts into two ways round an island, one of them through mud."""

from collections.abc import Iterator

import numpy as np

from offpiste.closed_loop.courses import KINDS, Candidate, ChosenCourse, CourseKind, CourseSettings
from offpiste.closed_loop.stretches import (
    RUN_OUT,
    STEP,
    drivable,
    start_of,
    surprise_along,
    traction_along,
)
from offpiste.planning.course import Course
from offpiste.simulation.driver.lookahead import VisibleTerrain
from offpiste.simulation.world.forks import unevenness
from offpiste.simulation.world.world import Fork, World

RUN_IN = 40.0
"""Length of course before the ways part [m]: the vehicle has reached its speed there, and sees both."""

BEHIND = 30.0
"""Length of course behind the place where they meet [m]."""


def _candidates(world: World, seed: int, settings: CourseSettings) -> Iterator[Candidate]:
    """Both directions through each fork, scored by how alike its ways are."""
    terrain = VisibleTerrain.of(world)
    for fork in world.forks:
        for backwards in (False, True):
            course = _course(world, fork, settings.speed, backwards=backwards)
            driven = [way[course.before_end] for way in course.ways]
            enough_traction = min(traction_along(world, way).min() for way in driven) >= settings.traction
            if enough_traction and all(drivable(world, terrain, way, settings) for way in course.ways):
                surprise = float(np.mean([surprise_along(world, way, settings.speed) for way in driven]))
                chosen = ChosenCourse(course, start_of(course.path), surprise, 1 - fork.muddy)
                yield Candidate(-unevenness(*driven), chosen)


def _course(world: World, fork: Fork, speed: float, *, backwards: bool) -> Course:
    """Course through a fork; its path is the left way by the direction of the trail."""
    loop, count = world.trails[fork.loop], len(fork.left)
    ways = [loop, np.concatenate((fork.right, loop[count:]))]
    if backwards:
        ways = [np.roll(way[::-1], count, axis=0) for way in ways]
    # Distances along the middle between the ways, twice around: the same index is beside the same place on either.
    step = np.linalg.norm(np.diff(np.tile((ways[0] + ways[1]) / 2, (2, 1)), axis=0), axis=1)
    arc = np.concatenate(([0.0], np.cumsum(step)))
    parted = arc[len(loop)]
    at = np.arange(parted - RUN_IN, parted + arc[count - 1] + BEHIND + RUN_OUT, STEP)
    path, other = (np.stack([np.interp(at, arc, axis) for axis in np.tile(way, (2, 1)).T], axis=1) for way in ways)
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    return Course(path, np.full(len(path), speed), length - RUN_OUT, other)


KINDS.register("choices")(CourseKind(_candidates, {"forks": True}))
