"""Terrain as a driver sees it, hazards along candidate arcs, and routes along trails and across open ground."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from offpiste.simulation.world.grids import Grid, Line, read_grid
from offpiste.simulation.world.terrain import SPACING
from offpiste.simulation.world.world import World

ARC_STEP, FAR = 0.6, 99.0
"""Spacing of the points along a candidate arc, and clearance without any tree [m]."""
_HALF_TRACK = 0.65
"""Half the approximate track of a side-by-side [m]."""
_STRETCH, _CROSSING, _REJOINING = (40.0, 140.0), (25.0, 90.0), (6.0, 50.0)
"""Ranges of the length of trail followed at a time, and of the distance to the next trail: across open ground, and when
the vehicle has left the route or is stuck [m]."""
_LOST = 8.0
"""Distance from the route beyond which a new route is sought [m]."""
_CANDIDATES = 16
"""Number of compared lines across open ground."""
_STEEP_TRAIL, _TOO_STEEP = 0.13, 0.25
"""Climb at which the route leaves a trail, and slope at which it does not cross open ground (rise over run)."""
_STRIDE, _WINDOW = 6, 60
"""Step in points for measuring bends, and number of points ahead among which the vehicle is located."""
_GETAWAY = 24
"""Number of points from the start whose climb decides whether a stopped vehicle can drive away."""


@dataclass(frozen=True)
class VisibleTerrain:
    """Part of a world that a driver sees: shapes, trees and trails (as in `World`), but no properties of the ground."""

    elevation: Grid
    origin: tuple[float, float]
    resolution: float
    trees: Float[np.ndarray, "n 3"]  # x, y, trunk radius [m]
    trails: tuple[Line, ...]

    @classmethod
    def of(cls, world: World) -> "VisibleTerrain":
        """Return the visible part of a world."""
        trees = np.column_stack((world.trees.foot[:, :2], world.trees.trunk_radius)).astype(np.float64)
        return cls(np.ascontiguousarray(world.elevation), world.origin, world.resolution, trees, world.trails)

    def max_slope(self, line: Float[np.ndarray, "n 2"]) -> float:
        """Return the steepest slope of a straight line (rise over run): climbs over 2 m, half of descents, and lean.

        The lean over a vehicle's width matters as a vehicle that crosses a ditch at a small angle tips into it.
        """
        span = line[-1] - line[0]
        length = max(float(np.hypot(*span)), 1e-6)
        heading = span / length
        places = line[0] + np.arange(0, length + 1, 1.0)[:, None] * heading
        left = np.array((-heading[1], heading[0])) * _HALF_TRACK
        sides = [self.heights(places + side) for side in (left, -left)]
        lean = np.abs(sides[0] - sides[1]) / (2 * _HALF_TRACK)
        heights = (sides[0] + sides[1]) / 2
        slope = (heights[2:] - heights[:-2]) / 2
        return float(max(lean.max(), slope.max(initial=0.0), -slope.min(initial=0.0) / 2))

    def first_climb(self, line: Float[np.ndarray, "n 2"], limit: float) -> int:
        """Return the index of the first point before a climb over `limit` (rise over run) within 2 m; n if none."""
        heights = self.heights(line)
        apart = max(1, round(2 / max(float(np.hypot(*(line[1] - line[0]))), 1e-3))) if len(line) > 1 else 1
        steep = np.flatnonzero(heights[apart:] - heights[:-apart] > 2 * limit)
        return int(steep[0]) if len(steep) else len(line)

    def heights(self, places: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """Return the elevation at places x, y, bilinear [m]."""
        return read_grid(self.elevation, self.origin, self.resolution, places.reshape(-1, 2)).reshape(places.shape[:-1])


@dataclass(frozen=True)
class ArcHazards:
    """Worst hazards along each of A arcs."""

    end: Float[np.ndarray, "A 2"]  # x, y of the arc's end [m]
    climb: Float[np.ndarray, " A"]  # upward and downward slope along the vehicle (rise over run, both positive)
    descent: Float[np.ndarray, " A"]
    lean: Float[np.ndarray, " A"]  # slope across the vehicle, to either side (rise over run)
    # Height of the ground below the belly or ahead of the nose above the plane of the wheels [m]
    protrusion: Float[np.ndarray, " A"]
    vertical_curvature: Float[np.ndarray, " A"]  # curvature of the path in the vertical plane [1/m]
    clearance: Float[np.ndarray, " A"]  # distance from the vehicle's centre to the surface of the nearest trunk [m]
    border_overlap: Float[np.ndarray, " A"]  # reach of the arc into the margin at the border [m]


def hazards_along_arcs(
    terrain: VisibleTerrain,
    curvatures: Float[np.ndarray, " A"],
    pose: tuple[float, float, float],
    length: float,
    size: tuple[float, float, float],
    margin: float,
) -> ArcHazards:
    """Return the hazards along arcs of a length [m] and curvatures [1/m, positive left] from a pose x, y, yaw.

    Args:
        size: wheelbase, track and distance from the vehicle's centre to its nose [m].
        margin: distance to keep from the border [m].
    """
    wheelbase, track, nose = size
    x, y, yaw = pose
    count = max(int(length / ARC_STEP), 4)
    step = length / count
    # Steps along the mean heading, which is exact but for the length of the chord.
    heading = yaw + curvatures[:, None] * (step * (np.arange(count) + 0.5))
    forward = np.stack((np.cos(heading), np.sin(heading)), axis=-1)
    left = np.stack((-forward[..., 1], forward[..., 0]), axis=-1) * (0.5 * track)
    places = np.array((x, y)) + step * np.cumsum(forward, axis=1)
    front, rear = places + 0.5 * wheelbase * forward, places - 0.5 * wheelbase * forward
    fl, fr, rl, rr, below, ahead = terrain.heights(
        np.stack((front + left, front - left, rear + left, rear - left, places, places + nose * forward))
    )
    mean = 0.25 * (fl + fr + rl + rr)
    slope = (fl + fr - rl - rr) / (2.0 * wheelbase)
    # A wheel in a hole tips a vehicle as much as a slope.
    lean = np.maximum(np.abs(fl - fr), np.abs(rl - rr)) / track
    protrusion = np.maximum(below - mean, ahead - mean - nose * slope)
    trees = terrain.trees[np.hypot(terrain.trees[:, 0] - x, terrain.trees[:, 1] - y) < length + 5]
    gap = np.hypot(places[..., :1] - trees[:, 0], places[..., 1:] - trees[:, 1]) - trees[:, 2]
    low = np.array(terrain.origin)
    high = low + (np.array(terrain.elevation.shape[::-1]) - 1) * terrain.resolution
    return ArcHazards(
        end=places[:, -1],
        climb=slope.max(axis=1, initial=0.0),
        descent=-slope.min(axis=1, initial=0.0),
        lean=lean.max(axis=1),
        protrusion=protrusion.max(axis=1, initial=0.0),
        vertical_curvature=np.abs(np.diff(slope)).max(axis=1) / step,
        clearance=gap.min(axis=(1, 2), initial=FAR),
        border_overlap=np.maximum(low + margin - places, places - (high - margin)).max(axis=(1, 2), initial=0.0),
    )


class Route:
    """An endless path, extended while it is driven.

    Args:
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
        """Return the first point of the route ahead at least this far away [m]."""
        away = _distance(self._points[self._next : self._next + _WINDOW], xy)
        nearest = int(np.argmin(away))
        if away[nearest] > _LOST:
            self.rejoin(xy, self._points[self._next + nearest] - xy)
        else:
            # The nearest point counts as driven, even if the vehicle cut a corner.
            self._next += nearest
        while True:
            far = np.flatnonzero(_distance(self._points[self._next :], xy) >= distance)
            if len(far):
                return np.asarray(self._points[self._next + far[0]])
            self._extend()

    def rejoin(self, xy: Float[np.ndarray, " 2"], heading: Float[np.ndarray, " 2"]) -> None:
        """Replace the route by the least steep line from a place to any trail, preferably along a heading."""
        kept = self._points, self._next
        self._points, self._next = xy[None], 0
        if self._cross(heading, _REJOINING, np.inf):
            self._follow(*self._at)
        else:
            self._points, self._next = kept

    def bend_speed(self, lateral: float, braking: float) -> float:
        """Return the highest speed for the bends ahead [m/s] with given lateral acceleration and braking [m/s^2]."""
        while len(self._points) - self._next <= _WINDOW:
            self._extend()
        steps = np.diff(self._points[self._next : self._next + _WINDOW + 1 : _STRIDE], axis=0)
        length = np.hypot(steps[:, 0], steps[:, 1])
        (ax, ay), (bx, by) = steps[:-1].T, steps[1:].T
        turn = np.abs(np.arctan2(ax * by - ay * bx, ax * bx + ay * by))
        # v^2 = lateral / curvature in the bend, plus braking before it
        squares = lateral * np.maximum(length[1:], 1e-3) / (turn + 1e-3) + 2.0 * braking * np.cumsum(length[:-1])
        return float(np.sqrt(squares.min()))

    def _extend(self) -> None:
        self._points, self._next = self._points[self._next :], 0
        if self._rng.random() < self._off_trail or self._blocked:
            crossed = self._cross(self._points[-1] - self._points[-2], _CROSSING, _TOO_STEEP)
            self._blocked = self._blocked and not crossed
        self._follow(*self._at)

    def _cross(self, heading: Float[np.ndarray, " 2"], reach: tuple[float, float], limit: float) -> bool:
        """Extend the route straight to another stretch of trail by the easiest of some lines; return whether it exists.

        Args:
            reach: range of the distance to that stretch [m].
            limit: largest accepted difficulty: slope (rise over run), plus 0.15 for turning back.
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
        # The first point is already the end of the route.
        skipped = 1 if len(self._points) else 0
        index_along = (index + direction * np.arange(skipped, count + 1)) % len(trail)
        steep = self._terrain.first_climb(trail[index_along], _STEEP_TRAIL)
        # Leave the trail before a steep place unless there was no other line.
        self._blocked = _GETAWAY < steep < len(index_along) and not self._blocked
        if self._blocked:
            index_along = index_along[: steep - _GETAWAY // 2]
        self._points = np.concatenate((self._points, trail[index_along]))
        self._at = number, int(index_along[-1])


def _distance(points: Float[np.ndarray, "n 2"], xy: Float[np.ndarray, " 2"]) -> Float[np.ndarray, " n"]:
    return np.asarray(np.hypot(points[:, 0] - xy[0], points[:, 1] - xy[1]))
