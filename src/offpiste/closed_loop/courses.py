"""Courses on the proving ground, by kind."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any, Final, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from offpiste.core.conventions import GRAVITY
from offpiste.core.errors import CourseError
from offpiste.core.registry import Registry
from offpiste.logs.ground_truth import GROUND_PROPERTIES
from offpiste.planning.course import Course, arc_length
from offpiste.simulation.driver.route import VisibleTerrain
from offpiste.simulation.simulate import Start
from offpiste.simulation.world.build import make_world
from offpiste.simulation.world.forks import unevenness
from offpiste.simulation.world.grids import Line, read_grid, turns_of
from offpiste.simulation.world.world import Fork, World, WorldSettings

STEP, SMOOTH = 1.0, 1.5
"""Spacing of the points of a course, and standard deviation of the smoothing of friction and curvature [m]."""
APART = 20.0
"""Minimum gap between end and beginning of a path on a closed trail [m]."""
RUN_OUT = 60.0
"""Length of the path beyond the end of a course, so that plans do not brake for a tree straight ahead [m]."""
SHORTEST_SHARE = 0.7
"""Minimum share of the course in its path, on short trails."""
RUN_IN, BEHIND = 40.0, 30.0
"""Lengths of a choice before the ways part and after they meet [m]."""
RELIEF = 2.0
"""Factor on the height of hills in worlds for passages."""
PASSAGE_TRACTION = 0.05
"""Minimum traction on a passage, which allows an acceleration of 0.5 m/s^2."""
PASSAGE_LENGTH, PASSAGE_CANDIDATES = 120.0, 400
"""Maximum length of a passage [m], as longer stretches are rarely passable, and number of candidates."""


@dataclass(frozen=True)
class CourseSettings:
    """Requirements on a course."""

    kind: str = "bends"  # kind of course (`KINDS`)
    speed: float = 7.0  # target speed [m/s]; the sharpest bends allow it only on ground of high friction
    length: float = 180.0  # maximum length [m]
    clearance: float = 1.7  # minimum distance from a trunk [m]
    steepest: float = 0.3  # maximum slope along or across (rise over run)
    radius: float = 5.0  # minimum radius of a bend [m]
    traction: float = 0.02  # minimum traction (`traction_along`); with less, a stopped vehicle is stuck
    candidates: int = 100  # number of candidate stretches of trail


@dataclass(frozen=True)
class ChosenCourse:
    """A course and the vehicle's start."""

    course: Course
    start: Start
    surprise: float  # error of the allowed speed without knowledge of the ground (`surprise_along`) [m/s]
    firm: int | None = None  # index of the firm way (`Course.ways`); None if there is one way


Candidate = tuple[float, ChosenCourse]
"""A score and a course; the course with the highest score is chosen."""


class CourseKind(NamedTuple):
    """A kind of course: candidates in a world, by a seed; settings of worlds with such courses."""

    candidates: Callable[[World, int, CourseSettings], Iterator[Candidate]]
    world: dict[str, Any]


KINDS: Final[Registry[CourseKind]] = Registry("kind of course")


def course_world(settings: WorldSettings, kind: str) -> World:
    """Return a world for a kind of course."""
    return make_world(replace(settings, **KINDS[kind].world))


def choose_course(world: World, seed: int, settings: CourseSettings | None = None) -> ChosenCourse:
    """Return the best course of a kind in a world of `course_world`; deterministic for a seed.

    Raises:
        CourseError: no candidate can be driven.
    """
    settings = settings or CourseSettings()
    candidates = list(KINDS[settings.kind].candidates(world, seed, settings))
    if not candidates:
        what = f"no stretch of trail is suitable for a course ({settings.kind})"
        place = f"world '{world.settings.preset}', seed {world.settings.seed}"
        raise CourseError(what, where=place, how="take another seed")
    return max(candidates, key=itemgetter(0))[1]


def _bends(world: World, seed: int, settings: CourseSettings) -> Iterator[Candidate]:
    """Yield bends at the limit of grip: stretches of trail, scored by their surprise."""
    for chosen in _trail_courses(world, seed, settings):
        yield chosen.surprise, chosen


def _passages(world: World, seed: int, settings: CourseSettings) -> Iterator[Candidate]:
    """Yield soft and steep passages over high hills: stretches of trail, scored by their mean resistance."""
    wanted = replace(
        settings,
        traction=max(settings.traction, PASSAGE_TRACTION),
        length=min(settings.length, PASSAGE_LENGTH),
        candidates=max(settings.candidates, PASSAGE_CANDIDATES),
    )
    for chosen in _trail_courses(world, seed, wanted):
        resistance = gaussian_filter1d(_resistance_along(world, chosen.course.driven), SMOOTH / STEP, mode="nearest")
        yield float(np.maximum(resistance, 0.0).mean()), chosen


def _choices(world: World, seed: int, settings: CourseSettings) -> Iterator[Candidate]:
    """Yield both directions through each fork, one way of which is muddy, scored by the similarity of the ways."""
    terrain = VisibleTerrain.of(world)
    for fork in world.forks:
        for backwards in (False, True):
            course = _course_of_fork(world, fork, settings.speed, backwards=backwards)
            driven = [way[course.before_end] for way in course.ways]
            enough_traction = min(traction_along(world, way).min() for way in driven) >= settings.traction
            if enough_traction and all(_drivable(terrain, way, settings) for way in course.ways):
                surprise = float(np.mean([surprise_along(world, way, settings.speed) for way in driven]))
                chosen = ChosenCourse(course, _start_of(course.path), surprise, 1 - fork.muddy)
                yield -unevenness(*driven), chosen


KINDS.register("bends")(CourseKind(_bends, {}))
KINDS.register("choices")(CourseKind(_choices, {"forks": True}))
KINDS.register("passages")(CourseKind(_passages, {"relief": RELIEF}))


def _trail_courses(world: World, seed: int, settings: CourseSettings) -> Iterator[ChosenCourse]:
    """Yield random drivable stretches of the world's trails."""
    terrain = VisibleTerrain.of(world)
    for number in range(settings.candidates):
        path = _stretch(world.trails, np.random.default_rng([seed, 0xC0, number]), settings.length + RUN_OUT)
        length = (len(path) - 1) * STEP  # a closed trail may be shorter than wanted
        end = min(settings.length, max(length - RUN_OUT, SHORTEST_SHARE * length))
        course = Course(path, np.full(len(path), settings.speed), end)
        enough_traction = traction_along(world, course.driven).min() >= settings.traction
        if enough_traction and _drivable(terrain, path, settings):
            yield ChosenCourse(course, _start_of(path), surprise_along(world, course.driven, settings.speed))


def _course_of_fork(world: World, fork: Fork, speed: float, *, backwards: bool) -> Course:
    """Return the course through a fork; its path is the left way in the direction of the trail."""
    loop, count = world.trails[fork.loop], len(fork.left)
    ways = [loop, np.concatenate((fork.right, loop[count:]))]
    if backwards:
        ways = [np.roll(way[::-1], count, axis=0) for way in ways]
    # Distances along the mean of both ways, twice around: equal indices lie side by side.
    arc = arc_length(np.tile((ways[0] + ways[1]) / 2, (2, 1)))
    parted = arc[len(loop)]
    at = np.arange(parted - RUN_IN, parted + arc[count - 1] + BEHIND + RUN_OUT, STEP)
    path, other = (np.stack([np.interp(at, arc, axis) for axis in np.tile(way, (2, 1)).T], axis=1) for way in ways)
    return Course(path, np.full(len(path), speed), float(arc_length(path)[-1]) - RUN_OUT, other)


def _stretch(trails: tuple[Line, ...], rng: np.random.Generator, length: float) -> Float[np.ndarray, "P 2"]:
    """Return a stretch of a random closed trail in either direction, at most the whole trail less `APART`."""
    trail = trails[int(rng.integers(len(trails)))]
    turned = np.roll(trail, -int(rng.integers(len(trail))), axis=0)[:: int(rng.choice((-1, 1)))]
    arc = arc_length(turned)
    at = np.arange(0.0, min(arc[-1] - APART, length), STEP)
    return np.stack([np.interp(at, arc, axis) for axis in turned.T], axis=1)


def _start_of(path: Float[np.ndarray, "P 2"]) -> Start:
    """Return the start at a standstill at the beginning of a path, heading along it."""
    heading = np.arctan2(*(path[2] - path[0])[::-1])
    return Start(float(path[0, 0]), float(path[0, 1]), float(heading), 0.0)


def _drivable(terrain: VisibleTerrain, path: Float[np.ndarray, "P 2"], settings: CourseSettings) -> bool:
    """Return whether a path avoids trunks, steep slopes and sharp bends."""
    if len(terrain.trees):
        away, nearest = cKDTree(terrain.trees[:, :2]).query(path)
        if (away - terrain.trees[nearest, 2]).min() < settings.clearance:
            return False
    if max(terrain.max_slope(path[i : i + 3 : 2]) for i in range(len(path) - 2)) > settings.steepest:
        return False
    return bool(np.abs(turns_of(path)).max() / STEP < 1 / settings.radius)


def surprise_along(world: World, path: Float[np.ndarray, "P 2"], speed: float) -> float:
    """Return the mean difference of the speeds allowed by local and by mean friction, both capped [m/s]."""
    friction = world.properties[..., GROUND_PROPERTIES.index("friction")]
    under = gaussian_filter1d(read_grid(friction, world.origin, world.resolution, path), SMOOTH / STEP, mode="nearest")
    bend = np.abs(gaussian_filter1d(turns_of(path), SMOOTH / STEP, mode="nearest")) / STEP
    bend = np.concatenate((bend[:1], bend, bend[-1:]))
    allowed, expected = (
        np.minimum(speed, np.sqrt(mu * GRAVITY / np.maximum(bend, 1e-6))) for mu in (under, friction.mean())
    )
    return float(np.abs(allowed - expected).mean())


def traction_along(world: World, path: Float[np.ndarray, "P 2"]) -> Float[np.ndarray, " P"]:
    """Return the available force over the weight: friction less rolling resistance, sinkage drag and climb."""
    left = _property_along(world, path, "friction") - _resistance_along(world, path)
    return gaussian_filter1d(left, SMOOTH / STEP, mode="nearest")


def _resistance_along(world: World, path: Float[np.ndarray, "P 2"]) -> Float[np.ndarray, " P"]:
    """Return the resisting force over the weight: rolling resistance, sinkage drag and climb."""
    height = read_grid(world.elevation, world.origin, world.resolution, path)
    climb = np.gradient(height) / np.linalg.norm(np.gradient(path, axis=0), axis=1)
    return sum((_property_along(world, path, name) for name in ("rolling_resistance", "sinkage_drag")), climb)


def _property_along(world: World, path: Float[np.ndarray, "P 2"], name: str) -> Float[np.ndarray, " P"]:
    return read_grid(world.properties[..., GROUND_PROPERTIES.index(name)], world.origin, world.resolution, path)
