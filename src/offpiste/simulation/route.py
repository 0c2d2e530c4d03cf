"""Where a drive wants to go: along trails, and straight across open ground from one stretch of trail to another."""

import numpy as np
from jaxtyping import Float

from offpiste.simulation.world import World

_STRETCH = (60.0, 180.0)
"""How long a trail is followed at a time [m]."""

_CROSSING = (25.0, 90.0)
"""How far away the next stretch of trail may begin [m]."""


class Route:
    """An endless path that is made as it is driven.

    Args:
        rng: of the choices.
        off_trail: probability of leaving a trail across open ground instead of going on along it.
    """

    def __init__(self, world: World, rng: np.random.Generator, *, off_trail: float) -> None:
        self._trails, self._rng, self._off_trail = world.trails, rng, off_trail
        self._points = np.empty((0, 2))
        self._next = 0
        number = int(rng.integers(len(self._trails)))
        self._follow(number, int(rng.integers(len(self._trails[number]))))

    def start(self) -> tuple[float, float, float]:
        """x, y [m] and yaw [rad] at the beginning."""
        first, then = self._points[0], self._points[4]
        return float(first[0]), float(first[1]), float(np.arctan2(*(then - first)[::-1]))

    def ahead(self, xy: Float[np.ndarray, " 2"], distance: float) -> Float[np.ndarray, " 2"]:
        """The first point of the route at least so far away, beyond what was driven already [m]."""
        while True:
            left = self._points[self._next :]
            # What is near was driven, also where the vehicle cut a corner.
            reach = np.hypot(*(left[:60] - xy).T)
            self._next += int(np.argmin(reach)) if len(reach) else 0
            left = self._points[self._next :]
            far = np.flatnonzero(np.hypot(*(left - xy).T) >= distance)
            if len(far):
                return np.asarray(left[far[0]])
            self._extend()

    def _extend(self) -> None:
        self._points, self._next = self._points[self._next :], 0
        number, index = self._at
        if self._rng.random() < self._off_trail:
            here, other = self._points[-1], int(self._rng.integers(len(self._trails)))
            away = np.hypot(*(self._trails[other] - here).T)
            there = np.flatnonzero((away > _CROSSING[0]) & (away < _CROSSING[1]))
            if len(there):
                number, index = other, int(self._rng.choice(there))
                goal = self._trails[number][index]
                count = max(2, int(np.hypot(*(goal - here))))
                self._points = np.concatenate((self._points, np.linspace(here, goal, count)[1:]))
        self._follow(number, index)

    def _follow(self, number: int, index: int) -> None:
        """Go along a trail from one of its points, in the direction that turns the less."""
        trail = self._trails[number]
        count = int(self._rng.uniform(*_STRETCH) / np.hypot(*(trail[1] - trail[0])))
        direction = 1
        if len(self._points) > 1:
            coming = self._points[-1] - self._points[-2]
            along = trail[(index + 3) % len(trail)] - trail[index - 3]
            direction = 1 if coming @ along >= 0 else -1
        elif self._rng.random() < 0.5:
            direction = -1
        index_along = (index + direction * np.arange(count)) % len(trail)
        self._points = np.concatenate((self._points, trail[index_along]))
        self._at = number, int(index_along[-1])
