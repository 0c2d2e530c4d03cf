"""Bends at the limit of grip, where friction differs from the world's mean."""

from collections.abc import Iterator

from offpiste.closed_loop.courses import KINDS, Candidate, ChosenCourse, CourseKind, CourseSettings
from offpiste.closed_loop.stretches import trail_courses
from offpiste.simulation.world.world import World


def _candidates(world: World, seed: int, settings: CourseSettings) -> Iterator[Candidate]:
    """Stretches of trail, scored by their surprise."""
    for course, start, surprise in trail_courses(world, seed, settings):
        yield Candidate(surprise, ChosenCourse(course, start, surprise))


KINDS.register("bends")(CourseKind(_candidates))
