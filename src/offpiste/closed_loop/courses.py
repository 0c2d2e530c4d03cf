"""Courses through a world: along its trails, through bends whose ground holds otherwise than one would expect."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from offpiste.conventions import GRAVITY
from offpiste.errors import OffpisteError
from offpiste.logs.ground_truth import GROUND_PROPERTIES
from offpiste.planning.course import Course
from offpiste.simulation.driver.lookahead import VisibleTerrain
from offpiste.simulation.simulate import Start
from offpiste.simulation.world.surface import read_grid
from offpiste.simulation.world.world import World

STEP = 1.0
"""Of the points of a course [m]."""

SMOOTH = 1.5
"""Deviation that friction and bends are smoothed with: a vehicle's length [m]."""

APART = 20.0
"""A path ends at least so far before it would meet its beginning [m]."""

RUN_OUT = 60.0
"""The path goes on so far beyond the end of a course: straight on there may be a tree, and plans would brake [m]."""

LEAST = 0.7
"""Of a short path, so much is course."""


@dataclass(frozen=True)
class CourseSettings:
    """What a course is like.

    Attributes:
        speed: wanted all along [m/s]: the sharpest bends allow it only on the ground that holds best.
        length: at most [m].
        clearance: from the nearest trunk [m].
        steepest: slope along or across (rise over run).
        radius: of the sharpest bend [m].
        traction: that is left everywhere (`traction_along`); on less, who once stands does not drive off again.
        candidates: stretches that are compared; the one with the greatest `surprise` is taken.
    """

    speed: float = 7.0
    length: float = 180.0
    clearance: float = 1.7
    steepest: float = 0.3
    radius: float = 5.0
    traction: float = 0.02
    candidates: int = 100


@dataclass(frozen=True)
class ChosenCourse:
    """A course and where it begins.

    Attributes:
        surprise: what not knowing the ground is about in speed [m/s] (`surprise_along`).
    """

    course: Course
    start: Start
    surprise: float


def choose_course(world: World, seed: int, settings: CourseSettings | None = None) -> ChosenCourse:
    """The best of some stretches of the world's trails; the same seed lays the same course.

    Raises:
        OffpisteError: none of them can be driven.
    """
    settings, terrain = settings or CourseSettings(), VisibleTerrain.of(world)
    found: list[ChosenCourse] = []
    for number in range(settings.candidates):
        path = _stretch(world.trails, np.random.default_rng([seed, 0xC0, number]), settings.length + RUN_OUT)
        length = (len(path) - 1) * STEP  # a closed trail may be shorter than what was asked for
        end = min(settings.length, max(length - RUN_OUT, LEAST * length))
        course = Course(path, np.full(len(path), settings.speed), end)
        holds = traction_along(world, course.driven).min() >= settings.traction
        if holds and _drivable(world, terrain, path, settings):
            heading = np.arctan2(*(path[2] - path[0])[::-1])
            start = Start(float(path[0, 0]), float(path[0, 1]), float(heading), 0.0)
            found.append(ChosenCourse(course, start, surprise_along(world, course.driven, settings.speed)))
    if not found:
        place = f"world '{world.settings.preset}', seed {world.settings.seed}"
        raise OffpisteError("no course can be laid along its trails", where=place, how="take another seed")
    return max(found, key=lambda laid: laid.surprise)


def surprise_along(world: World, path: Float[np.ndarray, "P 2"], speed: float) -> float:
    """How far the speed that the ground allows is from what the world's mean friction would allow, on average [m/s].

    Args:
        speed: wanted: more than that is not of use [m/s].
    """
    column = GROUND_PROPERTIES.index("friction")
    friction = world.properties[..., column]
    under = gaussian_filter1d(read_grid(friction, world.origin, world.resolution, path), SMOOTH / STEP, mode="nearest")
    bend = np.abs(gaussian_filter1d(_turn(path), SMOOTH / STEP, mode="nearest")) / STEP
    bend = np.concatenate((bend[:1], bend, bend[-1:]))
    allowed, expected = (
        np.minimum(speed, np.sqrt(mu * GRAVITY / np.maximum(bend, 1e-6))) for mu in (under, friction.mean())
    )
    return float(np.abs(allowed - expected).mean())


def traction_along(world: World, path: Float[np.ndarray, "P 2"]) -> Float[np.ndarray, " P"]:
    """What friction leaves to drive off with, over the weight: less rolling, spinning in soft ground, and the climb."""
    under = {
        name: read_grid(world.properties[..., column], world.origin, world.resolution, path)
        for column, name in enumerate(GROUND_PROPERTIES)
    }
    height = read_grid(world.elevation, world.origin, world.resolution, path)
    climb = np.gradient(height) / np.linalg.norm(np.gradient(path, axis=0), axis=1)
    left = under["friction"] - under["rolling_resistance"] - under["sinkage_drag"] - climb
    return gaussian_filter1d(left, SMOOTH / STEP, mode="nearest")


def _turn(path: Float[np.ndarray, "P 2"]) -> Float[np.ndarray, " P-2"]:
    """From each piece of a path to the next [rad]."""
    reading = np.diff(path, axis=0)
    return np.diff(np.unwrap(np.arctan2(reading[:, 1], reading[:, 0])))


def _stretch(
    trails: tuple[Float[np.ndarray, "_ 2"], ...], rng: np.random.Generator, length: float
) -> Float[np.ndarray, "P 2"]:
    """Some of a closed trail, either way round; a shorter trail is driven but for its last metres."""
    trail = trails[int(rng.integers(len(trails)))]
    turned = np.roll(trail, -int(rng.integers(len(trail))), axis=0)[:: int(rng.choice((-1, 1)))]
    arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(turned, axis=0), axis=1))))
    at = np.arange(0.0, min(arc[-1] - APART, length), STEP)
    return np.stack([np.interp(at, arc, axis) for axis in turned.T], axis=1)


def _drivable(world: World, terrain: VisibleTerrain, path: Float[np.ndarray, "P 2"], settings: CourseSettings) -> bool:
    if len(terrain.trees):
        away, nearest = cKDTree(terrain.trees[:, :2]).query(path)
        if (away - terrain.trees[nearest, 2]).min() < settings.clearance:
            return False
    if max(terrain.max_slope(path[i : i + 3 : 2]) for i in range(len(path) - 2)) > settings.steepest:
        return False
    return bool(np.abs(_turn(path)).max() / STEP < 1 / settings.radius)
