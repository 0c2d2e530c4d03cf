"""Ways that can still be taken where a course parts in two: each has a plan of its own, and the cheaper one acts.

Samples around one plan do not find another way: those between the two leave both, and cost more than either.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float

from offpiste.planning.course import Course

PARTED: Final = 1.0
"""Distance from which two ways are planned along apart [m]."""

ASTRAY: Final = 4.0
"""A way that is farther from the vehicle than the nearer one by more than this is not looked at any more [m]."""


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
