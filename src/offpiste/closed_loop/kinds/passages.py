"""Soft and steep passages: trails over hills twice as high, where the ground resists most but can be driven."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from offpiste.closed_loop.courses import KINDS, Candidate, ChosenCourse, CourseKind, CourseSettings
from offpiste.closed_loop.stretches import resistance_along, trail_courses
from offpiste.simulation.world.world import World

RELIEF = 2.0
"""Factor of the height of the worlds' hills."""

MARGIN = 0.05
"""Smallest traction (`stretches.traction_along`): the vehicle can drive away anywhere at 0.5 m/s^2 by full throttle."""

LENGTH = 120.0
"""Longest course [m]; longer stretches are rarely passable throughout."""

CANDIDATES = 400
"""Number of stretches that are compared."""


def _candidates(world: World, seed: int, settings: CourseSettings) -> Iterator[Candidate]:
    """Stretches of trail, scored by the mean of the resistance that is to be overcome."""
    wanted = replace(
        settings,
        traction=max(settings.traction, MARGIN),
        length=min(settings.length, LENGTH),
        candidates=max(settings.candidates, CANDIDATES),
    )
    for course, start, surprise in trail_courses(world, seed, wanted):
        resistance = np.maximum(resistance_along(world, course.driven), 0.0).mean()
        yield Candidate(float(resistance), ChosenCourse(course, start, surprise))


KINDS.register("passages")(CourseKind(_candidates, {"relief": RELIEF}))
