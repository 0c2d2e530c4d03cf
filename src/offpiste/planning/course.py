"""Course to follow: its layers on a grid of cells, its ways, and the position of the vehicle along it."""

import math
from ctypes import Structure, c_double, c_int, c_void_p
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32
from scipy.spatial import cKDTree

from offpiste.core.errors import PlanningError
from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.native.library import library
from offpiste.native.tensors import address, call

BLOCK = 4
"""Side of a block [cells]; far from the path, the cells of a block share their nearest point of the path."""

NEAR = 6
"""Distance from the path beyond which blocks share a point [sides of a block].

The error of the distance is 0.17 cells, or less than a diagonal of the block where another bend is as near."""

STRIDE = 8
"""Stride of the coarse search [points]."""


def along_path(
    path: Float[np.ndarray, "P 2"],
    values: Float32[np.ndarray, "P V"],
    x: Float[np.ndarray, " nx"],
    y: Float[np.ndarray, " ny"],
) -> Float32[np.ndarray, "ny nx 1+V"]:
    """Return the distance of cells to the nearest point of a path [m] and that point's values; exact near the path.

    Args:
        path: at least two points; fastest if evenly spaced.
        values: values of the points.
        x, y: coordinates of the columns and rows of cells, evenly spaced [m].
    """
    result = np.empty((len(y), len(x), 1 + values.shape[1]), np.float32)
    if library() is None:
        centres = np.stack(np.meshgrid(x, y), axis=-1)
        result[..., 0], nearest = cKDTree(path).query(centres)
        result[..., 1:] = values[nearest]
        return result
    points, columns, rows = (np.ascontiguousarray(part, np.float64) for part in (path, x, y))
    numbers = np.ascontiguousarray(values, np.float32)
    given = _Path(
        *map(address, (points, numbers, columns, rows)), *numbers.shape, len(x), len(y), BLOCK, NEAR, STRIDE,
        slack=STRIDE * float(np.linalg.norm(np.diff(path, axis=0), axis=1).max()),
        resolution=max((float(axis[1] - axis[0]) for axis in (x, y) if len(axis) > 1), default=0.0),
    )  # fmt: skip
    call("fill_course", -(-len(y) // BLOCK), given, result)
    return result


class _Path(Structure):
    _fields_ = (
        *((name, c_void_p) for name in ("points", "values", "x", "y")),
        *((name, c_int) for name in ("count", "width", "columns", "rows", "block", "near", "stride")),
        ("slack", c_double),
        ("resolution", c_double),
    )


SHORTEST: Final = 0.01
"""Minimum length of a path [m]."""

FASTEST: Final = 30.0
"""Maximum target speed accepted from users [m/s]."""

PARTED: Final = 1.0
"""Distance between two ways beyond which they are planned separately [m]."""

ASTRAY: Final = 4.0
"""Extra distance from the vehicle, compared with the nearer way, beyond which a way is ignored [m]."""


@dataclass(frozen=True)
class Course:
    """A path with target speeds; it may part into two alternative ways.

    Attributes:
        path: x, y of points along it [m].
        speed: target speed at each point [m/s].
        end: driven length of the path [m]; the rest only shows plans how it continues.
        alternative: points of a second way [m], equal to those of the path where the ways coincide; None for one way.
            Lengths refer to the path.

    Raises:
        PlanningError: the path is shorter than `SHORTEST`, or numbers of points differ, or values are not finite.
    """

    path: Float[np.ndarray, "P 2"]
    speed: Float[np.ndarray, " P"]
    end: float = math.inf
    alternative: Float[np.ndarray, "P 2"] | None = None

    def __post_init__(self) -> None:
        if not arc_length(self.path)[-1] > SHORTEST:
            what = f"the path of {len(self.path)} points is not finite or shorter than {SHORTEST} m"
            raise PlanningError(what, how="give finite points of a longer path, or a `Goal`")
        if len(self.speed) != len(self.path) or not np.isfinite(self.speed).all():
            what = f"{len(self.speed)} speeds for {len(self.path)} points, or a non-finite speed"
            raise PlanningError(what, how="give one finite speed for each point of the path")
        if self.alternative is not None and len(self.alternative) != len(self.path):
            what = f"the alternative has {len(self.alternative)} points, the path {len(self.path)}"
            raise PlanningError(what, how="give as many points for both, equal where the ways coincide")
        if self.alternative is not None and not np.isfinite(self.alternative).all():
            raise PlanningError("the alternative has a non-finite point", how="give finite points")

    @property
    def ways(self) -> tuple[Float[np.ndarray, "P 2"], ...]:
        """The path and, if present, the alternative."""
        return (self.path,) if self.alternative is None else (self.path, self.alternative)

    @property
    def driven(self) -> Float[np.ndarray, "_ 2"]:
        """Points of the path up to the end."""
        return self.path[self.before_end]

    @property
    def before_end(self) -> Bool[np.ndarray, " P"]:
        """Mask of the points up to the end."""
        return arc_length(self.path) <= self.end

    def densified(self, spacing: float) -> "Course":
        """Interpolate the course linearly, with points every `spacing` [m]."""
        length = arc_length(self.path)
        at = np.linspace(0, length[-1], max(int(np.ceil(length[-1] / spacing)) + 1, 2))
        ways = [np.stack([np.interp(at, length, column) for column in way.T], axis=-1) for way in self.ways]
        return Course(ways[0], np.interp(at, length, self.speed), self.end, *ways[1:])

    def layers(self, ground: TerrainLayers) -> Float32[np.ndarray, "ny nx 4"]:
        """Return the distance of cells to the nearer way, and direction and speed at its nearest point."""
        dense = self.densified(spacing=ground.resolution / 2)  # distances are accurate to a quarter of a cell
        x, y = ground.centres[0, :, 0], ground.centres[:, 0, 1]
        along = []
        for way in dense.ways:
            step = np.gradient(way, axis=0)
            direction = step / np.maximum(np.linalg.norm(step, axis=-1, keepdims=True), 1e-9)
            values = np.concatenate((direction, dense.speed[:, None]), axis=-1, dtype=np.float32)
            along.append(along_path(way, values, x, y))
        return along[0] if len(along) == 1 else np.where(along[1][..., :1] < along[0][..., :1], along[1], along[0])


@dataclass(frozen=True)
class Goal:
    """A place to drive to in a straight line and stop at.

    Attributes:
        place: x, y in the world frame [m].
        speed: target speed far from the place [m/s].
        braking: deceleration near it [m/s^2]: v^2 = 2 braking distance.
    """

    place: Float[np.ndarray, " 2"]
    speed: float
    braking: float = 2.0

    def layers(self, ground: TerrainLayers) -> Float[np.ndarray, "ny nx 4"]:
        """Return layers as `Course.layers`: distance 0, direction to the goal, and speed."""
        there = self.place - ground.centres
        distance = np.linalg.norm(there, axis=-1, keepdims=True)
        wanted = np.minimum(self.speed, np.sqrt(2 * self.braking * distance))
        return np.concatenate((np.zeros_like(distance), there / np.maximum(distance, 1e-9), wanted), axis=-1)


def arc_length(path: Float[np.ndarray, "P 2"]) -> Float[np.ndarray, " P"]:
    """Return the distance of points along a path from its first point [m]."""
    return np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=-1))))


class Way(NamedTuple):
    """One way of a course: 0 for the path, 1 for the alternative."""

    number: int
    course: Course


def ways_from(course: Course, place: Float[np.ndarray, " 2"]) -> list[Way]:
    """Return the ways that a vehicle at `place` [m] can still take, as separate courses; one way before they part."""
    alone = [Way(number, replace(course, path=path, alternative=None)) for number, path in enumerate(course.ways)]
    if len(alone) == 1 or not np.linalg.norm(course.ways[0] - course.ways[1], axis=1).max() > PARTED:
        return alone[:1]
    away = [float(np.linalg.norm(path - place, axis=1).min()) for path in course.ways]
    return [way for way, distance in zip(alone, away, strict=True) if distance <= min(away) + ASTRAY]


SPACING: Final = 0.25
"""Spacing of the candidate points of `CourseTracker` [m]."""

BACK, AHEAD = 6.0, 60.0
"""Extent of the section that enters the cost map, behind and ahead of the vehicle [m]."""

BACKED_OUT: Final = 20.0
"""Extent behind the position of a vehicle that backed out [m]; its legs lead far behind."""

SEARCH: Final = 12.0
"""Maximum advance in one step [m]."""

DRIVEN: Final = 40.0
"""Length of course behind the position from which the distance is still measured [m]."""

AS_NEAR: Final = 1.0
"""Difference of distances below which candidate positions of a lost vehicle count as equally near [m]."""


class CourseTracker:
    """Position of a vehicle along a course; it never moves backwards unless it was lost.

    A course may cross itself: the position is searched only a little ahead of the last one, and only the section ahead
    enters the cost map.
    """

    def __init__(self, course: Course) -> None:
        dense = course.densified(SPACING)
        # Extended straight ahead: plans would end with the path otherwise, and the vehicle would creep towards it.
        beyond = SPACING * np.arange(1, round(AHEAD / SPACING) + 1)
        path, *alternative = (_straight_on(way, beyond) for way in dense.ways)
        speed = np.append(dense.speed, np.full(len(beyond), dense.speed[-1]))
        self._course = Course(path, speed, math.inf, *alternative)
        self._arc = arc_length(path)
        self._end = min(self._index(course.end), len(dense.path) - 1)
        self._next, self._lost = 0, False

    def _index(self, length: float) -> int:
        """Return the number of points before a length along the course [m]."""
        return int(np.searchsorted(self._arc, length))

    @property
    def length(self) -> float:
        """Length of the course up to its end [m]."""
        return float(self._arc[self._end])

    @property
    def progress(self) -> float:
        """Distance driven along the course [m]."""
        return float(self._arc[self._next])

    @property
    def target(self) -> float:
        """Target speed at the vehicle's position [m/s]."""
        return float(self._course.speed[self._next])

    @property
    def fastest(self) -> float:
        """Maximum target speed of the course [m/s]."""
        return float(self._course.speed.max())

    def move(self, xy: Float[np.ndarray, " 2"]) -> float:
        """Advance to the point nearest to the vehicle at `xy` [m], and return the distance from the course [m].

        The distance is measured on both sides of the position, since a vehicle that backed out is behind it.
        """
        first, last = 0, self._end
        if not self._lost:
            first, last = self._index(self.progress - DRIVEN), min(self._index(self.progress + SEARCH), self._end)
        away = np.min([np.linalg.norm(way[first : last + 1] - xy, axis=1) for way in self._course.ways], axis=0)
        if not self._lost:
            self._next += int(np.argmin(away[self._next - first :]))
            return float(away.min())
        near = np.flatnonzero(away < away.min() + AS_NEAR)
        places = np.split(near, np.flatnonzero(np.diff(near) > 1) + 1)
        place = min(places, key=lambda indices: np.abs(indices - self._next).min())
        self._next, self._lost = int(place[np.argmin(away[place])]), False
        return float(away[self._next])

    def lose(self) -> None:
        """Search the whole course in the next move.

        Of equally near positions, as where a course crosses itself, the one nearest to the last position is chosen.
        """
        self._lost = True

    def resume(self, progress: float) -> None:
        """Continue at a distance along the course [m]."""
        self._next = min(self._index(progress), self._end)

    def stretch(self, *, at_most: float = np.inf, backed_out: bool = False) -> Course:
        """Return the section around the vehicle, extended straight beyond the last point.

        Args:
            at_most: limit of the target speed [m/s].
            backed_out: whether the vehicle may be far behind its position.
        """
        first = self._index(self.progress - (BACKED_OUT if backed_out else BACK))
        chosen = slice(max(min(first, len(self._arc) - 2), 0), self._index(self.progress + AHEAD) + 1)
        path, *alternative = (way[chosen] for way in self._course.ways)
        return Course(path, np.minimum(self._course.speed[chosen], at_most), np.inf, *alternative)


def _straight_on(way: Float[np.ndarray, "P 2"], beyond: Float[np.ndarray, " n"]) -> Float[np.ndarray, "P+n 2"]:
    """Extend a way straight ahead to distances beyond its last point [m]."""
    step = way[-1] - way[-2]
    return np.concatenate((way, way[-1] + beyond[:, None] * step / max(float(np.linalg.norm(step)), 1e-9)))
