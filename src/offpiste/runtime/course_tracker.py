"""Position of the vehicle along its course, and the section of the course around it.

A course may cross itself: the position is searched only a little ahead of the last one, and only the section ahead
enters the cost map. Where it parts into two ways, the vehicle is on the nearer one.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from offpiste.planning.course import Course

SPACING = 0.25
"""Spacing of the candidate points along the path [m]."""


@dataclass(frozen=True)
class TrackerRange:
    """Distances along the course from the vehicle's position on it [m].

    Attributes:
        back, ahead: extent of the section that enters the cost map.
        backed_out: instead of `back`, for a vehicle that backed out: its legs lead far behind its position.
        search: largest advance of the position in one step.
        driven: what is so far behind still counts as the course that the vehicle is on.
        as_near: where the position was lost, places that differ by less in their distance are as near.
    """

    back: float = 6.0
    ahead: float = 60.0
    backed_out: float = 20.0
    search: float = 12.0
    driven: float = 40.0
    as_near: float = 1.0


class CourseTracker:
    """Tracks the vehicle's position along a course; it never moves backwards, unless it was lost.

    Args:
        limits: of the search and of the section.
    """

    def __init__(self, course: Course, limits: TrackerRange | None = None) -> None:
        dense, self._limits = course.densified(SPACING), limits or TrackerRange()
        self._course = _prolonged(dense, self._limits.ahead)
        step = np.linalg.norm(np.diff(self._course.path, axis=0), axis=1)
        self._arc = np.concatenate(([0.0], np.cumsum(step)))
        self._end = min(int(np.searchsorted(self._arc, course.end)), len(dense.path) - 1)
        self._next, self._lost = 0, False

    @property
    def length(self) -> float:
        """Length of the course to its end [m]."""
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
        """Highest target speed of the course [m/s]."""
        return float(self._course.speed.max())

    def move(self, xy: Float[np.ndarray, " 2"]) -> float:
        """Advance to the point of the course nearest to the vehicle at `xy` [m]; returns its distance from it [m].

        The distance is that from the course on either side of the position: a vehicle that has backed out is behind it.
        """
        if self._lost:
            return self._found(xy)
        first = int(np.searchsorted(self._arc, self.progress - self._limits.driven))
        last = min(int(np.searchsorted(self._arc, self.progress + self._limits.search)), self._end)
        away = self._distance(xy, first, last)
        self._next += int(np.argmin(away[self._next - first :]))
        return float(away.min())

    def _distance(self, xy: Float[np.ndarray, " 2"], first: int, last: int) -> Float[np.ndarray, " n"]:
        """Distance of the candidate points from a place, to the nearer way [m]."""
        return np.min([np.linalg.norm(way[first : last + 1] - xy, axis=1) for way in self._course.ways], axis=0)

    def lose(self) -> None:
        """The vehicle may be anywhere: the next move searches all of the course.

        Of places that are as near, as where a course crosses itself, it is at the one nearest to its last position.
        """
        self._lost = True

    def _found(self, xy: Float[np.ndarray, " 2"]) -> float:
        away = self._distance(xy, 0, self._end)
        near = np.flatnonzero(away < away.min() + self._limits.as_near)
        places = np.split(near, np.flatnonzero(np.diff(near) > 1) + 1)
        place = min(places, key=lambda indices: np.abs(indices - self._next).min())
        self._next, self._lost = int(place[np.argmin(away[place])]), False
        return float(away[self._next])

    def resume(self, progress: float) -> None:
        """Continue from a distance along the course [m] that another tracker of it had reached."""
        self._next = min(int(np.searchsorted(self._arc, progress)), self._end)

    def stretch(self, *, at_most: float = np.inf, backed_out: bool = False) -> Course:
        """Section of the course around the vehicle, extended straight beyond the last point of the path.

        Without the extension, plans would end with the path: the vehicle would creep towards the end and not reach it.

        Args:
            at_most: limit of the target speed [m/s].
            backed_out: whether the vehicle may be far behind its position.
        """
        back = self._limits.backed_out if backed_out else self._limits.back
        first = int(np.searchsorted(self._arc, self.progress - back))
        last = int(np.searchsorted(self._arc, self.progress + self._limits.ahead)) + 1
        chosen = slice(max(min(first, len(self._arc) - 2), 0), last)
        path, *alternative = (way[chosen] for way in self._course.ways)
        return Course(path, np.minimum(self._course.speed[chosen], at_most), np.inf, *alternative)


def _prolonged(course: Course, length: float) -> Course:
    """A dense course, extended straight by `length` [m]."""
    steps = SPACING * np.arange(1, round(length / SPACING) + 1)[:, None]
    path, *alternative = (_straight_on(way, steps) for way in course.ways)
    speed = np.concatenate((course.speed, np.full(len(steps), course.speed[-1])))
    return Course(path, speed, np.inf, *alternative)


def _straight_on(way: Float[np.ndarray, "P 2"], steps: Float[np.ndarray, "n 1"]) -> Float[np.ndarray, "P+n 2"]:
    direction = way[-1] - way[-2]
    return np.concatenate((way, way[-1] + steps * direction / max(float(np.linalg.norm(direction)), 1e-9)))
