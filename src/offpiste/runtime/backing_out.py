"""Backing out: a stuck vehicle reverses and passes the place on one side, or gives up after some attempts.

A model that is wrong about a place remains wrong, so a stuck vehicle is detected from its poses. Plans of five seconds
are too short for turning round: a vehicle that faces against its course turns in legs, backwards and forwards.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from offpiste.core.errors import PlanningError
from offpiste.planning.costs.layers import Hazards
from offpiste.planning.course import Course, arc_length
from offpiste.runtime.estimator import JUMP

FORWARD, REVERSE = 1.0, -1.0
LEFT, RIGHT = 1.0, -1.0

GAP = 0.5
"""Longest interval between updates that counts towards the time limit of a manoeuvre [s]."""

PLAUSIBLE_SPEED = 30.0
"""Speed above which, plus `JUMP` [m], a change of pose means another frame [m/s]."""

Hazard = Callable[[Float[np.ndarray, "P 2"]], Float[np.ndarray, " P"]]
"""Function that returns the hazard [1/s] at places x, y [m]."""


@dataclass(frozen=True)
class BackingOutSettings:
    """Criteria and manoeuvres for stuck vehicles.

    Attributes:
        after: time without motion of a driven vehicle until it counts as stuck [s].
        moved: minimum distance that counts as motion [m].
        distance: length of a leg [m].
        longest: maximum duration of a leg [s].
        speed: target speed of a leg; higher than is reached, so that no plan postpones driving [m/s].
        obstacles: factor on the cost of low obstacles until the vehicle is back on its course: a LiDAR cannot tell
            bushes from rocks.
        tall: height from which obstacles count in full [m].
        slow: speed limit on the way back to the course [m/s].
        back: distance from the course below which an aligned vehicle is back on it [m].
        against: heading error above which the vehicle turns round [rad].
        along: heading error below which it is aligned [rad].
        radius: radius of the arcs of a turn [m].
        legs: maximum number of legs.
        attempts: maximum number of attempts at one place; 0 disables backing out.
        apart: distance below which places count as the same [m].
        aside: distance at which a stuck place is passed [m].
        reach: distance from a stuck place at which the course is left and rejoined [m].

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
                raise PlanningError(f"backing_out.{name} is {value:g}", how="give a positive number")


@dataclass(frozen=True)
class StuckPlace:
    """A place where the vehicle was stuck.

    Attributes:
        place: last x, y [m].
        side: side on which it is passed: 1 left, -1 right.
        times: number of times.
    """

    place: Float[np.ndarray, " 2"]
    side: float
    times: int = 1


class BackingOut:
    """Gear and course of the next plan, from past poses of the vehicle.

    Attributes:
        gear: 1 forward, -1 while it backs out.
        leg: number of the current leg; 0 while the course is followed.
        away: whether the vehicle was stuck and is not yet back on its course.
        gave_up: whether all attempts at this place failed; reset once the vehicle is moved.
        places: stuck places, oldest first.
    """

    def __init__(self, settings: BackingOutSettings) -> None:
        self._settings = settings
        self.gear, self.leg, self.away, self.gave_up = FORWARD, 0, False, False
        self.places: list[StuckPlace] = []
        self._since, self._start, self._turn = -np.inf, np.full(3, np.nan), 0.0
        self._last_time, self._last_pose = -np.inf, np.full(3, np.nan)

    def update(self, now: float, pose: Float[np.ndarray, " 3"], course: Course, *, driven: bool) -> bool:
        """Update from a pose, and return whether the vehicle is newly found stuck.

        Args:
            now: time [s].
            pose: x, y [m], yaw [rad].
            course: section around the vehicle.
            driven: whether plans are followed; a stopped vehicle is not stuck.
        """
        settings, since = self._settings, self._since
        moved = float(np.linalg.norm(pose[:2] - self._start[:2]))
        distance, angle = _errors(course, pose)
        if not self.leg:
            self.away &= distance > settings.back or abs(angle) > settings.along
        elif np.isfinite(self._last_time):  # time without driving does not count
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
        """Restart at the next pose, which has another frame or clock."""
        self._last_time = np.inf

    def _follow(self, now: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Follow the course from this pose on."""
        self.gear, self.leg, self._since, self._start = FORWARD, 0, now, np.array(pose, float)

    def _begin_leg(self, now: float, pose: Float[np.ndarray, " 3"], leg: int, angle: float) -> None:
        """Begin a leg: odd legs reverse, and legs turn if the heading error `angle` [rad] is large."""
        self._follow(now, pose)
        self.gear, self.leg, self.away = (REVERSE if leg % 2 else FORWARD), leg, True
        turning = abs(angle) > (self._settings.against if leg == 1 else self._settings.along)
        self._turn = -float(np.sign(angle)) if turning else 0.0

    def _manoeuvre(self, now: float, pose: Float[np.ndarray, " 3"], moved: float, angle: float) -> None:
        """End a completed leg, and begin another if the vehicle is still misaligned.

        Args:
            moved: distance from the beginning of the leg [m].
            angle: heading error, positive to the left [rad].
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
        """Return the known stuck place nearby."""
        near = (one for one in self.places if np.linalg.norm(place - one.place) < self._settings.apart)
        return next(near, None)

    def choose_side(self, place: Float[np.ndarray, " 2"], course: Course, hazard: Hazard) -> None:
        """Remember a stuck place, to be passed on the side with less hazard, and the next time on the other side.

        Args:
            course: course at that moment.
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
        """Return the hazards for the next plan."""
        if not self.away:
            return hazards
        return replace(hazards, low=self._settings.obstacles * hazards.low, tall=self._settings.tall)

    def course(self, course: Course) -> Course:
        """Return the course of the next plan: that of a leg, or the given one beside the stuck places."""
        if self.leg:
            return self._of_leg(min(self._settings.speed, float(course.speed.max())))
        for place in self.places:
            ways = [self._passing(way, place) for way in course.ways]
            course = replace(course, path=ways[0], alternative=None if len(ways) == 1 else ways[1])
        return replace(course, speed=np.minimum(course.speed, self._settings.slow)) if self.away else course

    def _of_leg(self, speed: float) -> Course:
        """Return a straight line or arc through the start of the leg, ordered by the heading of the vehicle.

        Args:
            speed: target speed, positive in either gear [m/s].
        """
        settings, (x, y, yaw) = self._settings, self._start
        arc = self.gear * np.linspace(-settings.distance, 7 * settings.distance, 65)
        turned = np.where(self.gear * arc > 0, self.gear * arc, 0.0) * self._turn / settings.radius
        step = np.diff(arc)[:, None] * np.stack((np.cos(yaw + turned[1:]), np.sin(yaw + turned[1:])), axis=1)
        path = np.concatenate((np.zeros((1, 2)), np.cumsum(step, axis=0)))
        path += np.array((x, y)) - path[8]  # arc length 0
        return Course(path[:: int(self.gear)], np.full(len(path), self.gear * speed))

    def _passing(self, path: Float[np.ndarray, "P 2"], stuck: StuckPlace) -> Float[np.ndarray, "P 2"]:
        """Displace a way sideways near a stuck place."""
        settings = self._settings
        away = np.linalg.norm(path - stuck.place, axis=1)
        nearest = int(np.argmin(away))
        if away[nearest] > settings.aside:
            return path
        step = np.gradient(path, axis=0)
        along = step / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9)
        arc = arc_length(path)
        phase = np.clip((arc - arc[nearest]) / settings.reach, -1, 1)
        left = np.stack((-along[nearest, 1], along[nearest, 0]))
        offset = stuck.side * settings.aside + float((stuck.place - path[nearest]) @ left)
        return path + offset * np.cos(0.5 * np.pi * phase)[:, None] ** 2 * left


def _errors(course: Course, pose: Float[np.ndarray, " 3"]) -> tuple[float, float]:
    """Return distance [m] and heading error [rad] (positive to the left) at the nearest point of the course."""
    way = min(course.ways, key=lambda path: float(np.linalg.norm(path - pose[:2], axis=1).min()))
    away = np.linalg.norm(way - pose[:2], axis=1)
    nearest = min(int(np.argmin(away)), len(way) - 2)
    ahead = way[nearest + 1] - way[nearest]
    return float(away.min()), float((pose[2] - np.arctan2(ahead[1], ahead[0]) + np.pi) % (2 * np.pi) - np.pi)
