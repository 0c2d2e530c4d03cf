"""Backing out: a vehicle that is driven and does not move reverses, and passes the place beside it, or gives up.

A plan covers five seconds, and a model that is wrong about a place is wrong about it again. So that a vehicle is stuck
is not left to the model: it is seen from the poses.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from offpiste.errors import PlanningError
from offpiste.planning.costs.layers import Hazards
from offpiste.planning.course import Course

FORWARD, REVERSE = 1.0, -1.0
LEFT, RIGHT = 1.0, -1.0

Hazard = Callable[[Float[np.ndarray, "P 2"]], Float[np.ndarray, " P"]]
"""Hazard [1/s] of the ground at places x, y [m]."""


@dataclass(frozen=True)
class BackingOutSettings:
    """When a vehicle counts as stuck, how it backs out, and when that is given up.

    Attributes:
        after: time without moving while it is driven [s].
        moved: distance that counts as moving [m].
        distance: that it backs out [m].
        longest: time for it [s].
        speed: wanted in reverse [m/s].
        obstacles: share of their cost that counts in reverse, at that speed: among bushes, which a LiDAR does not tell
            from rocks, every way leads through some.
        attempts: to back out of one place; 0: the gear is never changed, and nothing is given up.
        apart: places that are closer together count as one [m].
        aside: distance at which such a place is passed [m].
        reach: the course is left, and joined again, so far from such a place [m].

    Raises:
        PlanningError: a number is not positive.
    """

    after: float = 3.0
    moved: float = 0.5
    distance: float = 5.0
    longest: float = 6.0
    speed: float = 2.0
    obstacles: float = 0.05
    attempts: int = 2
    apart: float = 6.0
    aside: float = 2.5
    reach: float = 8.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0 and not (name == "attempts" and value == 0):
                raise PlanningError(f"backing out with {name} of {value:g}", how="give a number above 0")


@dataclass(frozen=True)
class StuckPlace:
    """Where the vehicle was stuck.

    Attributes:
        place: x, y, the last time [m].
        side: on which it is to be passed: 1 left, -1 right.
        times: how often.
    """

    place: Float[np.ndarray, " 2"]
    side: float
    times: int = 1


class BackingOut:
    """Gear and course of the next plan, from where the vehicle was.

    Attributes:
        gear: 1 forward, -1 while it backs out.
        gave_up: whether all attempts at this place have failed; until something else moves the vehicle.
        places: where it was stuck, oldest first.
    """

    def __init__(self, settings: BackingOutSettings) -> None:
        self._settings = settings
        self.gear, self.gave_up = FORWARD, False
        self.places: list[StuckPlace] = []
        self._since, self._start = -np.inf, np.full(3, np.nan)

    def update(self, now: float, pose: Float[np.ndarray, " 3"], *, driven: bool) -> bool:
        """Take notice of where the vehicle is; returns whether it is found stuck at this moment.

        Args:
            now: time [s].
            pose: x, y [m], yaw [rad].
            driven: whether plans are followed: a vehicle that is stopped is not stuck.
        """
        settings, since = self._settings, self._since
        away = float(np.linalg.norm(pose[:2] - self._start[:2]))
        if now < since or not since > -np.inf:
            self.places.clear()  # poses may be in another frame
            self._begin(now, pose)
        elif self.gave_up:
            if away > settings.moved:
                self.gave_up = False
                self._begin(now, pose)
        elif self.gear == REVERSE:
            if away > settings.distance or now - since > settings.longest:
                self._begin(now, pose)
        elif not driven or away > settings.moved:
            self._begin(now, pose)
        elif settings.attempts and now - since > settings.after:
            before = self._before(pose[:2])
            self.gave_up = before is not None and before.times >= settings.attempts
            self._begin(now, pose, FORWARD if self.gave_up else REVERSE)
            return not self.gave_up
        return False

    def _begin(self, now: float, pose: Float[np.ndarray, " 3"], gear: float = FORWARD) -> None:
        self.gear, self._since, self._start = gear, now, np.array(pose, float)

    def _before(self, place: Float[np.ndarray, " 2"]) -> StuckPlace | None:
        """The place that counts as this one."""
        near = (one for one in self.places if np.linalg.norm(place - one.place) < self._settings.apart)
        return next(near, None)

    def choose_side(self, place: Float[np.ndarray, " 2"], course: Course, hazard: Hazard) -> None:
        """Remember a place where it is stuck, to be passed where the ground is better; the next time on the other side.

        Args:
            course: that it was following.
        """
        before = self._before(place)
        found = [StuckPlace(np.array(place, float), side) for side in (LEFT, RIGHT)]
        left, right = (float(sum(hazard(self._passing(way, one)).sum() for way in course.ways)) for one in found)
        if before is None:
            self.places.append(StuckPlace(np.array(place, float), LEFT if left <= right else RIGHT))
        else:
            again = StuckPlace(np.array(place, float), -before.side, before.times + 1)
            self.places = [again if one is before else one for one in self.places]

    def hazards(self, hazards: Hazards) -> Hazards:
        """Hazards as they count in the next plan."""
        if self.gear == FORWARD:
            return hazards
        return replace(hazards, obstacle=self._settings.obstacles * hazards.obstacle)

    def course(self, course: Course) -> Course:
        """The course of the next plan: straight back in reverse, else the one given, beside the places."""
        if self.gear == REVERSE:
            return self._straight_back()
        for place in self.places:
            ways = [self._passing(way, place) for way in course.ways]
            course = replace(course, path=ways[0], alternative=None if len(ways) == 1 else ways[1])
        return course

    def _straight_back(self) -> Course:
        """Backwards where the vehicle came from; whichever way the course leads, it may stand across it."""
        x, y, yaw = self._start
        along = self._settings.distance * np.array((-3.0, 1.0))[:, None] * np.array((np.cos(yaw), np.sin(yaw)))
        return Course(np.array((x, y)) + along, np.full(2, -self._settings.speed))

    def _passing(self, path: Float[np.ndarray, "P 2"], stuck: StuckPlace) -> Float[np.ndarray, "P 2"]:
        """A way, displaced sideways near a place where it comes close to it."""
        settings = self._settings
        away = np.linalg.norm(path - stuck.place, axis=1)
        nearest = int(np.argmin(away))
        if away[nearest] > settings.aside:
            return path
        step = np.gradient(path, axis=0)
        along = step / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9)
        arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))))
        phase = np.clip((arc - arc[nearest]) / settings.reach, -1, 1)
        # Beside the place, wherever the course led past it.
        left = np.stack((-along[nearest, 1], along[nearest, 0]))
        offset = stuck.side * settings.aside + float((stuck.place - path[nearest]) @ left)
        return path + offset * np.cos(0.5 * np.pi * phase)[:, None] ** 2 * left
