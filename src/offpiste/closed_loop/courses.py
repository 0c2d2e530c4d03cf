"""Courses on the proving ground, by kind (`closed_loop.kinds`): how one is declared, and the choice of the best."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

from offpiste.closed_loop.stretches import CourseSettings
from offpiste.core.errors import CourseError
from offpiste.core.registry import Registry
from offpiste.planning.course import Course
from offpiste.simulation.simulate import Start
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.world import World, WorldSettings

__all__ = ["KINDS", "Candidate", "ChosenCourse", "CourseKind", "CourseSettings", "choose_course", "course_world"]


@dataclass(frozen=True)
class ChosenCourse:
    """A course and the vehicle's start on it.

    Attributes:
        surprise: error of the allowed speed without knowledge of the ground [m/s] (`stretches.surprise_along`).
        firm: index of the firm way (`Course.ways`); None where there is one way.
    """

    course: Course
    start: Start
    surprise: float
    firm: int | None = None


class Candidate(NamedTuple):
    """A course that could be chosen; the one with the greatest score is."""

    score: float
    chosen: ChosenCourse


@dataclass(frozen=True)
class CourseKind:
    """A kind of course.

    Attributes:
        candidates: courses in a world by a seed that meet the settings, with their scores.
        world: settings of worlds that have such courses, where they are not those of any world.
    """

    candidates: Callable[[World, int, CourseSettings], Iterator[Candidate]]
    world: dict[str, Any] = field(default_factory=dict)


KINDS: Final[Registry[CourseKind]] = Registry("kind of course", package="offpiste.closed_loop.kinds")


def course_world(settings: WorldSettings, kind: str) -> World:
    """World for a kind of course.

    Raises:
        OffpisteError: no such kind or preset, or a setting out of range.
    """
    return make_world(replace(settings, **KINDS[kind].world))


def choose_course(world: World, seed: int, settings: CourseSettings | None = None) -> ChosenCourse:
    """Best course of the wanted kind in a world (of `course_world`); the same seed gives the same course.

    Raises:
        CourseError: no candidate can be driven.
        OffpisteError: no such kind.
    """
    settings = settings or CourseSettings()
    candidates = list(KINDS[settings.kind].candidates(world, seed, settings))
    if not candidates:
        place = f"world '{world.settings.preset}', seed {world.settings.seed}"
        raise CourseError(
            f"no stretch of its trails makes a course ({settings.kind})", where=place, how="take another seed"
        )
    return max(candidates, key=lambda candidate: candidate.score).chosen
