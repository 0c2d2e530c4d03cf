"""Backing out: a vehicle that is driven and does not move reverses, and passes the place beside it, or gives up.

A plan covers five seconds, and a model that is wrong about a place is wrong about it again. So that a vehicle is stuck
is not left to the model: it is seen from the poses. Nor do five seconds show what turning round is worth: a vehicle
that has spun and stands against its course turns in legs, backwards and forwards, as a driver does.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import PlanningError
from offpiste.planning.costs.layers import Hazards
from offpiste.planning.course import Course
from offpiste.runtime.estimator import JUMP

FORWARD, REVERSE = 1.0, -1.0
LEFT, RIGHT = 1.0, -1.0

GAP = 0.5
"""Longest time between two looks at the vehicle that counts for a manoeuvre [s]."""

PLAUSIBLE_SPEED = 30.0
"""A pose that is farther from the one before than `JUMP` [m], and the way at this speed [m/s], is in another frame."""

Hazard = Callable[[Float[np.ndarray, "P 2"]], Float[np.ndarray, " P"]]
"""Hazard [1/s] of the ground at places x, y [m]."""


@dataclass(frozen=True)
class BackingOutSettings:
    """When a vehicle counts as stuck, how it backs out, and when that is given up.

    Attributes:
        after: time without moving while it is driven [s].
        moved: distance that counts as moving [m].
        distance: that it backs out, and drives in each leg of a turn [m].
        longest: time for it [s].
        speed: wanted meanwhile [m/s]; more than is reached in that distance, so that no plan puts driving off.
        obstacles: share of the cost of low obstacles that counts meanwhile, and until the vehicle is back on its
            course: among bushes, which a LiDAR does not tell from rocks, every way leads through some.
        tall: obstacles of that height count in full, as trees [m].
        slow: speed limit on the way back to the course [m/s].
        back: distance from the course at which it is back, once it is along it [m].
        against: angle to the course from which the vehicle turns round [rad].
        along: angle to the course at which it has turned [rad].
        radius: of the arcs on which it turns [m].
        legs: of a turn at most.
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
    speed: float = 4.0
    obstacles: float = 0.05
    tall: float = Hazards.tall
    slow: float = 3.0
    back: float = 2.0
    against: float = 1.75
    along: float = 1.0
    radius: float = 7.0
    legs: int = 6
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
        leg: number of the leg of a manoeuvre, from 1 on; 0: the course is followed.
        away: whether the vehicle was stuck and is not back on its course yet.
        gave_up: whether all attempts at this place have failed; until something else moves the vehicle.
        places: where it was stuck, oldest first.
    """

    def __init__(self, settings: BackingOutSettings) -> None:
        self._settings = settings
        self.gear, self.leg, self.away, self.gave_up = FORWARD, 0, False, False
        self.places: list[StuckPlace] = []
        self._since, self._start, self._turn = -np.inf, np.full(3, np.nan), 0.0
        self._last_time, self._last_pose = -np.inf, np.full(3, np.nan)

    def update(self, now: float, pose: Float[np.ndarray, " 3"], course: Course, *, driven: bool) -> bool:
        """Take notice of where the vehicle is; returns whether it is found stuck at this moment.

        Args:
            now: time [s].
            pose: x, y [m], yaw [rad].
            course: around the vehicle.
            driven: whether plans are followed: a vehicle that is stopped is not stuck.
        """
        settings, since = self._settings, self._since
        moved = float(np.linalg.norm(pose[:2] - self._start[:2]))
        distance, angle = _seen_from(course, pose)
        if not self.leg:
            self.away &= distance > settings.back or abs(angle) > settings.along
        elif np.isfinite(self._last_time):  # time in which it is stopped, or nothing is known, is no time for it
            self._since += max(now - self._last_time - (GAP if driven else 0.0), 0.0)
        step = float(np.linalg.norm(pose[:2] - self._last_pose[:2]))
        continues = now >= self._last_time and step <= JUMP + PLAUSIBLE_SPEED * (now - self._last_time)
        self._last_time, self._last_pose = now, np.array(pose, float)
        if not continues:
            self.places.clear()  # poses may be in another frame
            self.away = self.gave_up = False
            self._follow(now, pose)
        elif self.gave_up:
            if moved > settings.moved:
                self.gave_up = False
                self._follow(now, pose)
        elif self.leg:
            self._manoeuvre(now, pose, moved, angle)
        elif not driven or moved > settings.moved:
            self._follow(now, pose)
        elif settings.attempts and now - since > settings.after:
            before = self._before(pose[:2])
            self.gave_up = before is not None and before.times >= settings.attempts
            if self.gave_up:
                self._follow(now, pose)
            else:
                self._begin_leg(now, pose, 1, angle)
            return not self.gave_up
        return False

    def forget(self) -> None:
        """Begin anew with the next pose, which is in another frame or by another clock."""
        self._last_time = np.inf

    def _follow(self, now: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Follow the course from here on."""
        self.gear, self.leg, self._since, self._start = FORWARD, 0, now, np.array(pose, float)

    def _begin_leg(self, now: float, pose: Float[np.ndarray, " 3"], leg: int, angle: float) -> None:
        """Odd legs lead backwards, and all turn towards the course if the vehicle stands against it; else straight.

        Args:
            angle: of the heading to the course, above 0 to the left [rad].
        """
        self._follow(now, pose)
        self.gear, self.leg, self.away = (REVERSE if leg % 2 else FORWARD), leg, True
        turning = abs(angle) > (self._settings.against if leg == 1 else self._settings.along)
        self._turn = -float(np.sign(angle)) if turning else 0.0

    def _manoeuvre(self, now: float, pose: Float[np.ndarray, " 3"], moved: float, angle: float) -> None:
        """End a leg that has led far enough, and begin another where the vehicle is still turned away.

        Args:
            moved: distance from where the leg began [m].
            angle: of the heading to the course, above 0 to the left [rad].
        """
        settings, turning = self._settings, self._turn != 0
        if turning and abs(angle) < settings.along:
            self._follow(now, pose)
        elif moved > settings.distance or now - self._since > settings.longest:
            if turning and self.leg < settings.legs:
                self._begin_leg(now, pose, self.leg + 1, angle)
            else:
                self._follow(now, pose)

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
        if not self.away:
            return hazards
        return replace(hazards, low=self._settings.obstacles * hazards.low, tall=self._settings.tall)

    def course(self, course: Course) -> Course:
        """The course of the next plan: that of a leg, or the one given, beside the places."""
        if self.leg:
            return self._of_leg(min(self._settings.speed, float(course.speed.max())))
        for place in self.places:
            ways = [self._passing(way, place) for way in course.ways]
            course = replace(course, path=ways[0], alternative=None if len(ways) == 1 else ways[1])
        return replace(course, speed=np.minimum(course.speed, self._settings.slow)) if self.away else course

    def _of_leg(self, speed: float) -> Course:
        """From where the vehicle stood, straight back or on an arc, in the order of its headings.

        Args:
            speed: wanted on it, above 0 in either gear [m/s].
        """
        settings, (x, y, yaw) = self._settings, self._start
        arc = self.gear * np.linspace(-settings.distance, 7 * settings.distance, 65)
        turned = np.where(self.gear * arc > 0, self.gear * arc, 0.0) * self._turn / settings.radius
        step = np.diff(arc)[:, None] * np.stack((np.cos(yaw + turned[1:]), np.sin(yaw + turned[1:])), axis=1)
        path = np.concatenate((np.zeros((1, 2)), np.cumsum(step, axis=0)))
        path += np.array((x, y)) - path[8]  # where the arc length is 0
        return Course(path[:: int(self.gear)], np.full(len(path), self.gear * speed))

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


def _seen_from(course: Course, pose: Float[np.ndarray, " 3"]) -> tuple[float, float]:
    """Distance from the course [m], and angle of the heading to it where it is nearest, above 0 to the left [rad]."""
    way = min(course.ways, key=lambda path: float(np.linalg.norm(path - pose[:2], axis=1).min()))
    away = np.linalg.norm(way - pose[:2], axis=1)
    nearest = min(int(np.argmin(away)), len(way) - 2)
    ahead = way[nearest + 1] - way[nearest]
    return float(away.min()), float((pose[2] - np.arctan2(ahead[1], ahead[0]) + np.pi) % (2 * np.pi) - np.pi)
