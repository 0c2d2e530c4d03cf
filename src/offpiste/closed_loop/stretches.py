"""Stretches of a world's trails as courses: whether they can be driven, their grip and their resistance."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import cKDTree

from offpiste.core.conventions import GRAVITY
from offpiste.logs.ground_truth import GROUND_PROPERTIES
from offpiste.planning.course import Course
from offpiste.simulation.driver.lookahead import VisibleTerrain
from offpiste.simulation.simulate import Start
from offpiste.simulation.world.surface import read_grid
from offpiste.simulation.world.world import World

STEP = 1.0
"""Spacing of the points of a course [m]."""

SMOOTH = 1.5
"""Standard deviation of the smoothing of friction and curvature, about a vehicle's length [m]."""

APART = 20.0
"""Shortest gap between the end of a path and its beginning on a closed trail [m]."""

RUN_OUT = 60.0
"""Length of path beyond the end of a course [m]; straight ahead there may be a tree, and plans would brake."""

SHORTEST_SHARE = 0.7
"""Smallest share of a path that is course, where the trail is short."""


@dataclass(frozen=True)
class CourseSettings:
    """Requirements on a course.

    Attributes:
        kind: of course (`courses.KINDS`).
        speed: target speed [m/s]; the sharpest bends allow it only on ground of high friction.
        length: longest course [m].
        clearance: smallest distance from a trunk [m].
        steepest: largest slope along or across (rise over run).
        radius: smallest radius of a bend [m].
        traction: smallest traction (`traction_along`); below it, a vehicle at a standstill is stuck.
        candidates: number of stretches of trail that are compared; the best by its kind is chosen.
    """

    kind: str = "bends"
    speed: float = 7.0
    length: float = 180.0
    clearance: float = 1.7
    steepest: float = 0.3
    radius: float = 5.0
    traction: float = 0.02
    candidates: int = 100


def trail_courses(world: World, seed: int, settings: CourseSettings) -> Iterator[tuple[Course, Start, float]]:
    """Random stretches of the world's trails that can be driven, with the start and the surprise of each."""
    terrain = VisibleTerrain.of(world)
    for number in range(settings.candidates):
        path = _stretch(world.trails, np.random.default_rng([seed, 0xC0, number]), settings.length + RUN_OUT)
        length = (len(path) - 1) * STEP  # a closed trail may be shorter than wanted
        end = min(settings.length, max(length - RUN_OUT, SHORTEST_SHARE * length))
        course = Course(path, np.full(len(path), settings.speed), end)
        enough_traction = traction_along(world, course.driven).min() >= settings.traction
        if enough_traction and drivable(world, terrain, path, settings):
            yield course, start_of(path), surprise_along(world, course.driven, settings.speed)


def start_of(path: Float[np.ndarray, "P 2"]) -> Start:
    """The vehicle at a standstill at the beginning of a path, heading along it."""
    heading = np.arctan2(*(path[2] - path[0])[::-1])
    return Start(float(path[0, 0]), float(path[0, 1]), float(heading), 0.0)


def surprise_along(world: World, path: Float[np.ndarray, "P 2"], speed: float) -> float:
    """Mean difference between the speed that friction allows and the speed by the world's mean friction [m/s].

    Args:
        speed: target speed, which caps both [m/s].
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
    """Force left to drive away with, over the weight: friction less rolling resistance, sinkage drag and climb."""
    left = _property_along(world, path, "friction") - _resistance_along(world, path)
    return gaussian_filter1d(left, SMOOTH / STEP, mode="nearest")


def resistance_along(world: World, path: Float[np.ndarray, "P 2"]) -> Float[np.ndarray, " P"]:
    """Force that holds a vehicle back, over the weight: rolling resistance, sinkage drag and climb."""
    return gaussian_filter1d(_resistance_along(world, path), SMOOTH / STEP, mode="nearest")


def _resistance_along(world: World, path: Float[np.ndarray, "P 2"]) -> Float[np.ndarray, " P"]:
    height = read_grid(world.elevation, world.origin, world.resolution, path)
    climb = np.gradient(height) / np.linalg.norm(np.gradient(path, axis=0), axis=1)
    return sum((_property_along(world, path, name) for name in ("rolling_resistance", "sinkage_drag")), climb)


def _property_along(world: World, path: Float[np.ndarray, "P 2"], name: str) -> Float[np.ndarray, " P"]:
    column = GROUND_PROPERTIES.index(name)
    return read_grid(world.properties[..., column], world.origin, world.resolution, path)


def _turn(path: Float[np.ndarray, "P 2"]) -> Float[np.ndarray, " P-2"]:
    """Change of heading from each piece of a path to the next [rad]."""
    reading = np.diff(path, axis=0)
    return np.diff(np.unwrap(np.arctan2(reading[:, 1], reading[:, 0])))


def _stretch(
    trails: tuple[Float[np.ndarray, "_ 2"], ...], rng: np.random.Generator, length: float
) -> Float[np.ndarray, "P 2"]:
    """Stretch of a random closed trail, in either direction; a shorter trail is used up to its last metres."""
    trail = trails[int(rng.integers(len(trails)))]
    turned = np.roll(trail, -int(rng.integers(len(trail))), axis=0)[:: int(rng.choice((-1, 1)))]
    arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(turned, axis=0), axis=1))))
    at = np.arange(0.0, min(arc[-1] - APART, length), STEP)
    return np.stack([np.interp(at, arc, axis) for axis in turned.T], axis=1)


def drivable(world: World, terrain: VisibleTerrain, path: Float[np.ndarray, "P 2"], settings: CourseSettings) -> bool:
    """Whether a path keeps clear of trunks, steep slopes and sharp bends."""
    if len(terrain.trees):
        away, nearest = cKDTree(terrain.trees[:, :2]).query(path)
        if (away - terrain.trees[nearest, 2]).min() < settings.clearance:
            return False
    if max(terrain.max_slope(path[i : i + 3 : 2]) for i in range(len(path) - 2)) > settings.steepest:
        return False
    return bool(np.abs(_turn(path)).max() / STEP < 1 / settings.radius)
