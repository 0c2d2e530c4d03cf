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
    """Criteria and manoeuvres for stuck vehicles."""

    after: float = 3.0  # time without motion of a driven vehicle until it counts as stuck [s]
    moved: float = 0.5  # minimum distance that counts as motion [m]
    distance: float = 5.0  # length of a leg [m]
    longest: float = 6.0  # maximum duration of a leg [s]
    speed: float = 4.0  # target speed of a leg; higher than is reached, so that no plan postpones driving [m/s]
    obstacles: float = 0.05  # factor on the cost of low obstacles, perhaps bushes, until it is back on its course
    tall: float = Hazards.tall  # height from which obstacles count in full [m]
    slow: float = 3.0  # speed limit on the way back to the course [m/s]
    back: float = 2.0  # distance from the course below which an aligned vehicle is back on it [m]
    against: float = 1.75  # heading error above which the vehicle turns round [rad]
    along: float = 1.0  # heading error below which it is aligned [rad]
    radius: float = 7.0  # radius of the arcs of a turn [m]
    legs: int = 6  # maximum number of legs
    attempts: int = 2  # maximum number of attempts at one place; 0 disables backing out
    apart: float = 6.0  # distance below which places count as the same [m]
    aside: float = 2.5  # distance at which a stuck place is passed [m]
    reach: float = 8.0  # distance from a stuck place at which the course is left and rejoined [m]

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0 and not (name == "attempts" and value == 0):
                raise PlanningError(f"invalid backing_out.{name} = {value:g}", how="give a positive number")


@dataclass
class StuckPlace:
    """A place where the vehicle was stuck."""

    place: Float[np.ndarray, " 2"]  # last x, y [m]
    side: float  # side on which it is passed: 1 left, -1 right
    times: int = 1  # how often the vehicle was stuck there


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
        settings, pose, elapsed = self._settings, np.array(pose, float), now - self._last_time
        step = float(np.linalg.norm(pose[:2] - self._last_pose[:2]))
        self._last_time, self._last_pose = now, pose
        if not (elapsed >= 0 and step <= JUMP + PLAUSIBLE_SPEED * elapsed):  # poses may be in another frame
            self.places.clear()
            self.away = self.gave_up = False
            self._follow(now, pose)
            return False
        moved = float(np.linalg.norm(pose[:2] - self._start[:2]))
        distance, angle = _errors(course, pose)
        if self.leg:
            self._since += max(elapsed - (GAP if driven else 0.0), 0.0)  # time without driving does not count
            self._manoeuvre(now, pose, moved, angle)
            return False
        self.away &= distance > settings.back or abs(angle) > settings.along
        if moved > settings.moved or not (driven or self.gave_up):
            self.gave_up = False
            self._follow(now, pose)
        elif settings.attempts and not self.gave_up and now - self._since > settings.after:
            before = self._before(pose[:2])
            self.gave_up = before is not None and before.times >= settings.attempts
            if not self.gave_up:
                self._begin_leg(now, pose, 1, angle)
                return True
            self._follow(now, pose)
        return False

    def forget(self) -> None:
        """Restart at the next pose, which has another frame or clock."""
        self._last_time = np.inf

    def _follow(self, now: float, pose: Float[np.ndarray, " 3"]) -> None:
        """Follow the course from this pose on."""
        self.gear, self.leg, self._since, self._start = FORWARD, 0, now, pose

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
        aligned = turning and abs(angle) < settings.along
        ended = moved > settings.distance or now - self._since > settings.longest
        if ended and not aligned and turning and self.leg < settings.legs:
            self._begin_leg(now, pose, self.leg + 1, angle)
        elif ended or aligned:
            self._follow(now, pose)

    def _before(self, place: Float[np.ndarray, " 2"]) -> StuckPlace | None:
        """Return the known stuck place nearby."""
        near = (one for one in self.places if np.linalg.norm(place - one.place) < self._settings.apart)
        return next(near, None)

    def choose_side(self, place: Float[np.ndarray, " 2"], course: Course, hazard: Hazard) -> None:
        """Remember where the vehicle got stuck, to pass on the side with less hazard, and on the other next time."""
        place, before = np.array(place, float), self._before(place)
        if before is not None:
            before.place, before.side, before.times = place, -before.side, before.times + 1
            return
        left, right = StuckPlace(place, LEFT), StuckPlace(place, RIGHT)
        along_left, along_right = (
            float(sum(hazard(self._passing(way, one)).sum() for way in course.ways)) for one in (left, right)
        )
        self.places.append(left if along_left <= along_right else right)

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
            path, *alternative = (self._passing(way, place) for way in course.ways)
            course = Course(path, course.speed, course.end, *alternative)
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
        along = np.gradient(path, axis=0)[nearest]
        left = np.array((-along[1], along[0])) / max(float(np.linalg.norm(along)), 1e-9)
        arc = arc_length(path)
        phase = np.clip((arc - arc[nearest]) / settings.reach, -1, 1)
        offset = stuck.side * settings.aside + float((stuck.place - path[nearest]) @ left)
        return path + offset * np.cos(0.5 * np.pi * phase)[:, None] ** 2 * left


def _errors(course: Course, pose: Float[np.ndarray, " 3"]) -> tuple[float, float]:
    """Return distance [m] and heading error [rad] (positive to the left) at the nearest point of the course."""
    way = min(course.ways, key=lambda path: float(np.linalg.norm(path - pose[:2], axis=1).min()))
    away = np.linalg.norm(way - pose[:2], axis=1)
    nearest = min(int(np.argmin(away)), len(way) - 2)
    ahead = way[nearest + 1] - way[nearest]
    return float(away.min()), float((pose[2] - np.arctan2(ahead[1], ahead[0]) + np.pi) % (2 * np.pi) - np.pi)
