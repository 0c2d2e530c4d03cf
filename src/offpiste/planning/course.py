"""The course to follow, and the nearest point of its path for every cell of a grid."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32

from offpiste.core.errors import PlanningError
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.native.compilation import PLANNING, spread_kernel

BLOCK = 4
"""Side of a block [cells]; far from the path, the cells of a block share their nearest point."""

NEAR = 6
"""Distance from the path beyond which blocks share a point [sides of a block]. The error of the distance there is
0.17 cells, or less than a diagonal of the block where another bend is as near."""

STRIDE = 8
"""Spacing of the points that are compared first [points]."""


def along_path(
    path: Float[np.ndarray, "P 2"],
    values: Float32[np.ndarray, "P V"],
    x: Float[np.ndarray, " nx"],
    y: Float[np.ndarray, " ny"],
) -> Float32[np.ndarray, "ny nx 1+V"]:
    """Distance of cells to the nearest point of a path [m], and that point's values; exact near the path.

    Args:
        path: two points at least; fastest where they are evenly spaced.
        values: columns of values at the points.
        x, y: coordinates of the columns and rows of cells, evenly spaced [m].
    """
    result = np.empty((len(y), len(x), 1 + values.shape[1]), np.float32)
    slack = STRIDE * float(np.linalg.norm(np.diff(path, axis=0), axis=1).max())
    resolution = float(x[1] - x[0]) if len(x) > 1 else 0.0
    spread_kernel(-(-len(y) // BLOCK), _fill, np.ascontiguousarray(path), values, slack, x, y, resolution, result)
    return result


@PLANNING.inlined
def _nearest(px: float, py: float, path: np.ndarray, begin: int, end: int, stride: int) -> tuple[int, float]:
    """Index and squared distance of the nearest of every `stride`-th point."""
    best, least = begin, np.inf
    for k in range(begin, end, stride):
        dx, dy = path[k, 0] - px, path[k, 1] - py
        squared = dx * dx + dy * dy
        if squared < least:
            best, least = k, squared
    return best, least


@PLANNING.inlined
def _within(px: float, py: float, path: np.ndarray, reach: float) -> tuple[int, int]:
    """Range of points that covers all strides beginning within `reach` [m]."""
    begin, end = len(path), 0
    for k in range(0, len(path), STRIDE):
        dx, dy = path[k, 0] - px, path[k, 1] - py
        if dx * dx + dy * dy <= reach * reach:
            begin, end = min(begin, k), k + STRIDE
    return begin, min(end, len(path))


@PLANNING.entry
def _fill(
    first: int,
    last: int,
    path: np.ndarray,
    values: np.ndarray,
    slack: float,
    x: np.ndarray,
    y: np.ndarray,
    resolution: float,
    result: np.ndarray,
) -> None:
    """Fill the rows of blocks `first` ... `last - 1`.

    Args:
        slack: largest distance of a point from where its stride begins [m].
    """
    half = (BLOCK - 1) / 2 * resolution
    for row in range(first, last):
        for column in range(0, len(x), BLOCK):
            px, py = x[column] + half, y[row * BLOCK] + half
            distance = np.sqrt(_nearest(px, py, path, 0, len(path), STRIDE)[1])
            near = distance < NEAR * BLOCK * resolution
            # A cell lies up to sqrt(2) half from the middle, and its nearest point up to as far again.
            begin, end = _within(px, py, path, distance + slack + (3 * half if near else 0.0))
            best, _ = _nearest(px, py, path, begin, end, 1)
            for j in range(row * BLOCK, min((row + 1) * BLOCK, len(y))):
                for i in range(column, min(column + BLOCK, len(x))):
                    if near:
                        best, squared = _nearest(x[i], y[j], path, begin, end, 1)
                    else:
                        squared = (path[best, 0] - x[i]) ** 2 + (path[best, 1] - y[j]) ** 2
                    result[j, i, 0] = np.sqrt(squared)
                    for v in range(values.shape[1]):
                        result[j, i, 1 + v] = values[best, v]


SHORTEST: Final = 0.01
"""Length of the shortest valid path [m]."""

FASTEST: Final = 30.0
"""Largest wanted speed [m/s] that users may ask for."""

PARTED: Final = 1.0
"""Distance from which two ways are planned along apart [m]."""

ASTRAY: Final = 4.0
"""A way that is farther from the vehicle than the nearer one by more than this is not looked at any more [m]."""


@dataclass(frozen=True)
class Course:
    """A path to drive along, with target speeds; it may part into two ways, of which either may be taken.

    Attributes:
        path: x, y of points along it [m].
        speed: target speed at each point [m/s].
        end: length of the path that is driven [m]; the rest shows plans how it continues.
        alternative: x, y of the points of a second way, those of the path where there is one way [m]; None: there is
            none. Lengths are those of the path.

    Raises:
        PlanningError: the path is shorter than `SHORTEST` or not finite, or has another number of points than what
            goes with it; or a speed is not finite.
    """

    path: Float[np.ndarray, "P 2"]
    speed: Float[np.ndarray, " P"]
    end: float = math.inf
    alternative: Float[np.ndarray, "P 2"] | None = None

    def __post_init__(self) -> None:
        if not np.linalg.norm(np.diff(self.path, axis=0), axis=-1).sum() > SHORTEST:
            how = "give finite points of a longer path, or a `Goal`"
            raise PlanningError(f"a path of {len(self.path)} points, not finite or shorter than {SHORTEST} m", how=how)
        if len(self.speed) != len(self.path) or not np.isfinite(self.speed).all():
            what = f"{len(self.speed)} speeds for {len(self.path)} points, or one that is not finite"
            raise PlanningError(what, how="give one finite speed for each point of the path")
        if self.alternative is not None and len(self.alternative) != len(self.path):
            what = f"a second way of {len(self.alternative)} points beside a path of {len(self.path)}"
            raise PlanningError(what, how="give as many points for both, those of the path where there is one way")

    @property
    def ways(self) -> tuple[Float[np.ndarray, "P 2"], ...]:
        """The path and, if there is one, the alternative."""
        return (self.path,) if self.alternative is None else (self.path, self.alternative)

    @property
    def driven(self) -> Float[np.ndarray, "_ 2"]:
        """Points of the path up to the end."""
        return self.path[self.before_end]

    @property
    def before_end(self) -> Bool[np.ndarray, " P"]:
        """Which points lie before the end."""
        step = np.linalg.norm(np.diff(self.path, axis=0), axis=-1)
        return np.concatenate(([0.0], np.cumsum(step))) <= self.end

    def densified(self, spacing: float) -> "Course":
        """Same course with a point every `spacing` [m], interpolated linearly."""
        length = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(self.path, axis=0), axis=-1))))
        at = np.linspace(0, length[-1], max(int(np.ceil(length[-1] / spacing)) + 1, 2))
        ways = [np.stack([np.interp(at, length, column) for column in way.T], axis=-1) for way in self.ways]
        return Course(ways[0], np.interp(at, length, self.speed), self.end, *ways[1:])

    def layers(self, ground: TerrainLayers) -> Float32[np.ndarray, "ny nx 4"]:
        """Distance to the nearer way, and its direction and speed at the point nearest to each cell."""
        dense = self.densified(spacing=ground.resolution / 2)  # the distance is right to a quarter of a cell
        along = [_layers_along(way, dense.speed, ground) for way in dense.ways]
        return along[0] if len(along) == 1 else np.where(along[1][..., :1] < along[0][..., :1], along[1], along[0])


class Way(NamedTuple):
    """One way of a course: 0 for its path, 1 for the alternative."""

    number: int
    course: Course


def ways_from(course: Course, place: Float[np.ndarray, " 2"]) -> Sequence[Way]:
    """The ways that a vehicle can still take, each as a course of its own; one where they have not parted.

    Args:
        course: the section of it around the vehicle.
        place: x, y of the vehicle [m].
    """
    alone = [Way(number, replace(course, path=path, alternative=None)) for number, path in enumerate(course.ways)]
    if len(alone) == 1 or not np.linalg.norm(course.ways[0] - course.ways[1], axis=1).max() > PARTED:
        return alone[:1]
    away = [float(np.linalg.norm(path - place, axis=1).min()) for path in course.ways]
    return [way for way, distance in zip(alone, away, strict=True) if distance <= min(away) + ASTRAY]


def _layers_along(
    path: Float[np.ndarray, "P 2"], speed: Float[np.ndarray, " P"], ground: TerrainLayers
) -> Float32[np.ndarray, "ny nx 4"]:
    step = np.gradient(path, axis=0)
    direction = step / np.maximum(np.linalg.norm(step, axis=-1, keepdims=True), 1e-9)
    values = np.concatenate((direction, speed[:, None]), axis=-1, dtype=np.float32)
    return along_path(path, values, ground.centres[0, :, 0], ground.centres[:, 0, 1])


@dataclass(frozen=True)
class Goal:
    """A place to drive to in a straight line, slowing down to stop there.

    Attributes:
        place: x, y in the world frame [m].
        speed: target speed far from it [m/s].
        braking: deceleration near it [m/s^2]: v^2 = 2 braking distance.
    """

    place: Float[np.ndarray, " 2"]
    speed: float
    braking: float = 2.0

    def layers(self, ground: TerrainLayers) -> Float[np.ndarray, "ny nx 4"]:
        """Layers as of `Course.layers`: distance 0 everywhere, direction to the goal, and speed."""
        there = self.place - ground.centres
        distance = np.linalg.norm(there, axis=-1)
        direction = there / np.maximum(distance, 1e-9)[..., None]
        wanted = np.minimum(self.speed, np.sqrt(2 * self.braking * distance))
        return np.concatenate((np.zeros_like(distance)[..., None], direction, wanted[..., None]), axis=-1)
