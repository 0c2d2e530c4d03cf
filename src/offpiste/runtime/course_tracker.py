"""How far along its course the vehicle is, and the stretch that matters now.

A course may cross itself: the place on it is looked for only near the last one, and only the stretch ahead is drawn.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from offpiste.planning.course import Course

SPACING = 0.25
"""Of the points that the vehicle's place is looked for among [m]."""


@dataclass(frozen=True)
class TrackerRange:
    """How much of the course is looked at, from the vehicle's place on it [m].

    Attributes:
        back, ahead: what is drawn.
        search: the place may move on by so much at once.
    """

    back: float = 6.0
    ahead: float = 60.0
    search: float = 12.0


class CourseTracker:
    """Keeps the vehicle's place on a course."""

    def __init__(self, course: Course, limits: TrackerRange | None = None) -> None:
        dense, self._limits = course.densified(SPACING), limits or TrackerRange()
        self._course = _prolonged(dense, self._limits.ahead)
        step = np.linalg.norm(np.diff(self._course.path, axis=0), axis=1)
        self._arc = np.concatenate(([0.0], np.cumsum(step)))
        self._end = min(int(np.searchsorted(self._arc, course.end)), len(dense.path) - 1)
        self._next = 0

    @property
    def length(self) -> float:
        """Of the course, to its end [m]."""
        return float(self._arc[self._end])

    @property
    def progress(self) -> float:
        """Of the vehicle along it [m]."""
        return float(self._arc[self._next])

    @property
    def target(self) -> float:
        """Speed wanted here [m/s]."""
        return float(self._course.speed[self._next])

    def move(self, xy: Float[np.ndarray, " 2"]) -> float:
        """The vehicle has come to a place; returns its distance from the course there [m]."""
        last = min(int(np.searchsorted(self._arc, self.progress + self._limits.search)), self._end)
        away = np.linalg.norm(self._course.path[self._next : last + 1] - xy, axis=1)
        nearest = int(np.argmin(away))
        self._next += nearest
        return float(away[nearest])

    def stretch(self, *, at_most: float = np.inf) -> Course:
        """What lies a little behind and ahead; beyond the last point of its path the course goes straight on.

        If it ended there, plans would lead no further: the vehicle would creep up to the end, and not get there.

        Args:
            at_most: speed that is not exceeded [m/s].
        """
        first = int(np.searchsorted(self._arc, self.progress - self._limits.back))
        last = int(np.searchsorted(self._arc, self.progress + self._limits.ahead)) + 1
        chosen = slice(max(min(first, len(self._arc) - 2), 0), last)
        return Course(self._course.path[chosen], np.minimum(self._course.speed[chosen], at_most))


def _prolonged(course: Course, length: float) -> Course:
    """A dense course that goes straight on for some metres."""
    direction = course.path[-1] - course.path[-2]
    steps = SPACING * np.arange(1, round(length / SPACING) + 1)[:, None]
    beyond = course.path[-1] + steps * direction / max(float(np.linalg.norm(direction)), 1e-9)
    path = np.concatenate((course.path, beyond))
    return Course(path, np.concatenate((course.speed, np.full(len(beyond), course.speed[-1]))))
