"""The driver's route: along trails, and straight across open ground from one stretch of trail to another."""

import numpy as np
from jaxtyping import Float

from offpiste.compilation import PHYSICS
from offpiste.simulation.driver.lookahead import VisibleTerrain
from offpiste.simulation.world.terrain import SPACING

_STRETCH = (40.0, 140.0)
"""Shortest and longest stretch of a trail that is followed at a time [m]."""

_CROSSING = (25.0, 90.0)
"""Least and greatest distance to the next stretch of trail [m]."""

_REJOINING = (6.0, 50.0)
"""Least and greatest distance to the next trail of a vehicle that has left its route or is stuck [m]."""

_LOST = 8.0
"""Distance from its route beyond which the vehicle looks for another one [m]."""

_CANDIDATES = 16
"""Number of lines across open ground that are compared."""

_STEEP_TRAIL = 0.13
"""Climb (rise over run) of a trail beyond which the route leaves it."""

_TOO_STEEP = 0.25
"""Slope (rise over run) of open ground beyond which it is not crossed."""

_STRIDE = 6
"""Points between two at which bends are measured."""

_GETAWAY = 24
"""Points from the start whose climb decides whether a vehicle at a standstill drives away."""

_WINDOW = 60
"""Points of the route among which the vehicle is searched for: it never skips further ahead at once."""


class Route:
    """An endless path that is extended as it is driven.

    Args:
        rng: random numbers of all choices.
        off_trail: probability of leaving a trail across open ground instead of continuing along it.
    """

    def __init__(self, terrain: VisibleTerrain, rng: np.random.Generator, *, off_trail: float) -> None:
        self._terrain, self._trails = terrain, terrain.trails
        self._rng, self._off_trail = rng, off_trail
        self._points = np.empty((0, 2))
        self._next, self._blocked = 0, False
        number = int(rng.integers(len(self._trails)))
        self._follow(number, int(rng.integers(len(self._trails[number]))))

    def start(self) -> tuple[float, float, float, float]:
        """Start of the route: x, y [m], yaw [rad], and the steepest slope (rise over run) of the first metres."""
        first, then = self._points[0], self._points[4]
        climb = self._terrain.max_slope(self._points[:_GETAWAY])
        return float(first[0]), float(first[1]), float(np.arctan2(*(then - first)[::-1])), climb

    def ahead(self, xy: Float[np.ndarray, " 2"], distance: float) -> Float[np.ndarray, " 2"]:
        """First point of the route at least this far away, beyond what was driven already [m]."""
        away = _distance(self._points[self._next : self._next + _WINDOW], xy)
        nearest = int(np.argmin(away))
        if away[nearest] > _LOST:
            self.rejoin(xy, self._points[self._next + nearest] - xy)
        else:
            # The nearest point counts as driven, also where the vehicle cut a corner.
            self._next += nearest
        while True:
            far = np.flatnonzero(_distance(self._points[self._next :], xy) >= distance)
            if len(far):
                return np.asarray(self._points[self._next + far[0]])
            self._extend()

    def rejoin(self, xy: Float[np.ndarray, " 2"], heading: Float[np.ndarray, " 2"]) -> None:
        """Drop the route, and continue from a place on the least steep line to any trail, rather ahead than back.

        Args:
            heading: direction of the vehicle, of any length.
        """
        kept = self._points, self._next
        self._points, self._next = xy[None], 0
        if self._cross(heading, _REJOINING, np.inf):
            self._follow(*self._at)
        else:
            self._points, self._next = kept

    def bend_speed(self, lateral: float, braking: float) -> float:
        """Highest speed at which the bends ahead can be taken [m/s].

        Args:
            lateral, braking: accelerations that are assumed [m/s^2].
        """
        while len(self._points) - self._next <= _WINDOW:
            self._extend()
        return float(_bend_speed(self._points[self._next : self._next + _WINDOW + 1 : _STRIDE], lateral, braking))

    def _extend(self) -> None:
        self._points, self._next = self._points[self._next :], 0
        if self._rng.random() < self._off_trail or self._blocked:
            crossed = self._cross(self._points[-1] - self._points[-2], _CROSSING, _TOO_STEEP)
            self._blocked = self._blocked and not crossed
        self._follow(*self._at)

    def _cross(self, heading: Float[np.ndarray, " 2"], reach: tuple[float, float], limit: float) -> bool:
        """Go straight to another stretch of trail on the least difficult of some lines, if there is one.

        Args:
            reach: least and greatest distance to that stretch [m].
            limit: greatest difficulty that is accepted: slope (rise over run), plus 0.15 for turning back.
        """
        here = self._points[-1]
        best, least = None, limit
        for _ in range(_CANDIDATES):
            number = int(self._rng.integers(len(self._trails)))
            away = _distance(self._trails[number], here)
            there = np.flatnonzero((away > reach[0]) & (away < reach[1]))
            if not len(there):
                continue
            index = int(self._rng.choice(there))
            span = self._trails[number][index] - here
            line = here + np.linspace(0, 1, 1 + int(np.ceil(away[index] / SPACING)))[:, None] * span
            ahead = float(heading @ span) / max(float(np.hypot(*heading) * away[index]), 1e-6)
            difficulty = self._terrain.max_slope(line) + 0.075 * (1 - ahead)
            if difficulty < least:
                best, least = (number, index, line), difficulty
        if best is not None:
            self._at = best[:2]
            self._points = np.concatenate((self._points, best[2][1:]))
        return best is not None

    def _follow(self, number: int, index: int) -> None:
        """Follow a trail from one of its points, in the direction that turns less."""
        trail = self._trails[number]
        count = int(self._rng.uniform(*_STRETCH) / np.hypot(*(trail[1] - trail[0])))
        direction = 1
        if len(self._points) > 1:
            coming = self._points[-1] - self._points[-2]
            along = trail[(index + 3) % len(trail)] - trail[index - 3]
            direction = 1 if coming @ along >= 0 else -1
        elif self._rng.random() < 0.5:
            direction = -1
        # The first point is where the route ends already.
        skipped = 1 if len(self._points) else 0
        index_along = (index + direction * np.arange(skipped, count + 1)) % len(trail)
        steep = self._terrain.first_climb(trail[index_along], _STEEP_TRAIL)
        # The route leaves the trail before a steep place, unless there was no other line.
        self._blocked = _GETAWAY < steep < len(index_along) and not self._blocked
        if self._blocked:
            index_along = index_along[: steep - _GETAWAY // 2]
        self._points = np.concatenate((self._points, trail[index_along]))
        self._at = number, int(index_along[-1])


def _distance(points: Float[np.ndarray, "n 2"], xy: Float[np.ndarray, " 2"]) -> Float[np.ndarray, " n"]:
    return np.asarray(np.hypot(points[:, 0] - xy[0], points[:, 1] - xy[1]))


@PHYSICS.entry
def _bend_speed(points, lateral, braking):  # type: ignore[no-untyped-def]
    lowest, distance = np.inf, 0.0
    for i in range(1, len(points) - 1):
        ax, ay = points[i, 0] - points[i - 1, 0], points[i, 1] - points[i - 1, 1]
        bx, by = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
        length, after = np.sqrt(ax * ax + ay * ay), np.sqrt(bx * bx + by * by)
        turn = abs(np.arctan2(ax * by - ay * bx, ax * bx + ay * by))
        distance += length
        # v^2 = lateral / curvature in the bend, and braking before it
        lowest = min(lowest, lateral * max(after, 1e-3) / (turn + 1e-3) + 2.0 * braking * distance)
    return np.sqrt(lowest)
