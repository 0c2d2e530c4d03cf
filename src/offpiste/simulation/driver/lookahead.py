"""What a driver sees of the country, and how a vehicle would stand on it along the arcs that it may take.

Only shapes and trees: no property of the ground, so that commands tell nothing about grip.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from offpiste.compilation import PHYSICS
from offpiste.simulation.world.surface import height, read_grid
from offpiste.simulation.world.world import World

ARC_STEP = 0.6
"""Distance of the places along an arc that are looked at [m]."""

_HALF_TRACK = 0.65
"""Of a side-by-side, about [m]."""

FAR = 99.0
"""Clearance where there is no tree [m]."""


@dataclass(frozen=True)
class Country:
    """The lie of the land, the trees and the trails.

    Attributes:
        elevation, origin, resolution, trails: as of `World`.
        trees: x, y, trunk radius [m].
    """

    elevation: Float[np.ndarray, "ny nx"]
    origin: tuple[float, float]
    resolution: float
    trees: Float[np.ndarray, "n 3"]
    trails: tuple[Float[np.ndarray, "_ 2"], ...]

    @classmethod
    def of(cls, world: World) -> "Country":
        """What can be seen of a world."""
        trees = np.column_stack((world.trees.foot[:, :2], world.trees.trunk_radius)).astype(np.float64)
        return cls(np.ascontiguousarray(world.elevation), world.origin, world.resolution, trees, world.trails)

    def steepest(self, line: Float[np.ndarray, "n 2"]) -> float:
        """Slope along a straight line at its worst (rise over run): climbs over 2 m count whole, descents half.

        So does the slope across, over the width of a vehicle: who crosses a ditch at a small angle tips into it.
        """
        reading = line[-1] - line[0]
        length = max(float(np.hypot(*reading)), 1e-6)
        heading = reading / length
        places = line[0] + np.arange(0, length + 1, 1.0)[:, None] * heading
        left = np.array((-heading[1], heading[0])) * _HALF_TRACK
        sides = [read_grid(self.elevation, self.origin, self.resolution, places + side) for side in (left, -left)]
        lean = np.abs(sides[0] - sides[1]) / (2 * _HALF_TRACK)
        heights = (sides[0] + sides[1]) / 2
        slope = (heights[2:] - heights[:-2]) / 2
        return float(max(lean.max(), slope.max(initial=0.0), -slope.min(initial=0.0) / 2))

    def first_climb(self, line: Float[np.ndarray, "n 2"], limit: float) -> int:
        """Index of the first of some points, 2 m before which it begins to climb more than `limit`; n if none does."""
        heights = read_grid(self.elevation, self.origin, self.resolution, line)
        apart = max(1, round(2 / max(float(np.hypot(*(line[1] - line[0]))), 1e-3))) if len(line) > 1 else 1
        steep = np.flatnonzero(heights[apart:] - heights[:-apart] > 2 * limit)
        return int(steep[0]) if len(steep) else len(line)


@dataclass(frozen=True)
class Prospect:
    """What lies along each of some arcs, at its worst.

    Attributes:
        end: x, y of its end [m].
        climb, descent: slope along the vehicle, up and down (rise over run, both positive).
        lean: slope across the vehicle, to either side.
        high_point: how far the ground below the belly or before the nose stands out of the wheels' plane [m].
        bend: curvature of the way up and down [1/m].
        clearance: from the vehicle's middle to the nearest trunk's surface [m].
        outside: how far it comes too near to the border [m].
    """

    end: Float[np.ndarray, "A 2"]
    climb: Float[np.ndarray, " A"]
    descent: Float[np.ndarray, " A"]
    lean: Float[np.ndarray, " A"]
    high_point: Float[np.ndarray, " A"]
    bend: Float[np.ndarray, " A"]
    clearance: Float[np.ndarray, " A"]
    outside: Float[np.ndarray, " A"]


def sample_terrain(
    country: Country,
    curvatures: Float[np.ndarray, " A"],
    *,
    x: float,
    y: float,
    yaw: float,
    length: float,
    size: tuple[float, float, float],
    margin: float,
) -> Prospect:
    """Look along arcs from one place.

    Args:
        curvatures: + to the left [1/m].
        x, y, yaw: where the vehicle stands [m, rad].
        length: of the arcs [m].
        size: the vehicle's wheelbase, track and distance from its middle to its nose [m].
        margin: distance from the border to be kept [m].
    """
    out = np.empty((9, len(curvatures)))
    near = np.hypot(country.trees[:, 0] - x, country.trees[:, 1] - y) < length + 5
    _survey(
        country.elevation, *country.origin, country.resolution, country.trees[near],
        curvatures, x, y, yaw, length, *size, margin, out,
    )  # fmt: skip
    return Prospect(out[:2].T, *out[2:])


@PHYSICS.entry
def _survey(elevation, x0, y0, resolution, trees, curvatures, x, y, yaw, length, wheelbase, track, nose, margin, out):  # type: ignore[no-untyped-def]
    high_x = x0 + (elevation.shape[1] - 1) * resolution - margin
    high_y = y0 + (elevation.shape[0] - 1) * resolution - margin
    count = max(int(length / ARC_STEP), 4)
    step = length / count
    for a in range(len(curvatures)):
        climb, descent, lean, high_point, bend, clearance, outside = 0.0, 0.0, 0.0, 0.0, 0.0, FAR, 0.0
        px, py, heading, slope_before = x, y, yaw, 0.0
        for number in range(count):
            # From the middle of each step's turn: exact for an arc up to the length of its chord.
            heading += 0.5 * curvatures[a] * step
            c, s = np.cos(heading), np.sin(heading)
            px, py = px + step * c, py + step * s
            heading += 0.5 * curvatures[a] * step
            forward_x, forward_y = 0.5 * wheelbase * c, 0.5 * wheelbase * s
            left_x, left_y = -0.5 * track * s, 0.5 * track * c
            fl = height(elevation, x0, y0, resolution, px + forward_x + left_x, py + forward_y + left_y)
            fr = height(elevation, x0, y0, resolution, px + forward_x - left_x, py + forward_y - left_y)
            rl = height(elevation, x0, y0, resolution, px - forward_x + left_x, py - forward_y + left_y)
            rr = height(elevation, x0, y0, resolution, px - forward_x - left_x, py - forward_y - left_y)
            below = height(elevation, x0, y0, resolution, px, py)
            ahead = height(elevation, x0, y0, resolution, px + nose * c, py + nose * s)
            mean = 0.25 * (fl + fr + rl + rr)
            slope = (fl + fr - rl - rr) / (2.0 * wheelbase)
            climb, descent = max(climb, slope), max(descent, -slope)
            # One wheel in a hole tips a vehicle as much as a slope does.
            lean = max(lean, max(abs(fl - fr), abs(rl - rr)) / track)
            high_point = max(high_point, max(below - mean, ahead - mean - nose * slope))
            if number > 0:
                bend = max(bend, abs(slope - slope_before) / step)
            slope_before = slope
            outside = max(outside, max(max(x0 + margin - px, px - high_x), max(y0 + margin - py, py - high_y)))
            for t in range(len(trees)):
                gap = np.sqrt((trees[t, 0] - px) ** 2 + (trees[t, 1] - py) ** 2) - trees[t, 2]
                clearance = min(clearance, gap)
        out[0, a], out[1, a] = px, py
        out[2, a], out[3, a], out[4, a], out[5, a] = climb, descent, lean, high_point
        out[6, a], out[7, a], out[8, a] = bend, clearance, outside
