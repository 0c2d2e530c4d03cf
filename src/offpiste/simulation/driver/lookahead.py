"""Terrain as a driver sees it, and its hazards along the arcs that the vehicle may take.

Only shapes and trees: no property of the ground, so that commands reveal nothing about grip.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from offpiste.compilation import PHYSICS
from offpiste.simulation.world.surface import height, read_grid
from offpiste.simulation.world.world import World

ARC_STEP = 0.6
"""Spacing of the candidate points along an arc [m]."""

_HALF_TRACK = 0.65
"""Half the track of a side-by-side, about [m]."""

FAR = 99.0
"""Clearance where there is no tree [m]."""


@dataclass(frozen=True)
class VisibleTerrain:
    """Heights, trees and trails of a world.

    Attributes:
        elevation, origin, resolution, trails: as in `World`.
        trees: x, y, trunk radius [m].
    """

    elevation: Float[np.ndarray, "ny nx"]
    origin: tuple[float, float]
    resolution: float
    trees: Float[np.ndarray, "n 3"]
    trails: tuple[Float[np.ndarray, "_ 2"], ...]

    @classmethod
    def of(cls, world: World) -> "VisibleTerrain":
        """The visible part of a world."""
        trees = np.column_stack((world.trees.foot[:, :2], world.trees.trunk_radius)).astype(np.float64)
        return cls(np.ascontiguousarray(world.elevation), world.origin, world.resolution, trees, world.trails)

    def max_slope(self, line: Float[np.ndarray, "n 2"]) -> float:
        """Steepest slope on a straight line (rise over run): climbs over 2 m count in full, descents half.

        The slope across the line, over the width of a vehicle, counts in full too: a vehicle that crosses a ditch at a
        small angle tips into it.
        """
        span = line[-1] - line[0]
        length = max(float(np.hypot(*span)), 1e-6)
        heading = span / length
        places = line[0] + np.arange(0, length + 1, 1.0)[:, None] * heading
        left = np.array((-heading[1], heading[0])) * _HALF_TRACK
        sides = [read_grid(self.elevation, self.origin, self.resolution, places + side) for side in (left, -left)]
        lean = np.abs(sides[0] - sides[1]) / (2 * _HALF_TRACK)
        heights = (sides[0] + sides[1]) / 2
        slope = (heights[2:] - heights[:-2]) / 2
        return float(max(lean.max(), slope.max(initial=0.0), -slope.min(initial=0.0) / 2))

    def first_climb(self, line: Float[np.ndarray, "n 2"], limit: float) -> int:
        """Index of the first point from which the next 2 m climb more than `limit` (rise over run), n if none does."""
        heights = read_grid(self.elevation, self.origin, self.resolution, line)
        apart = max(1, round(2 / max(float(np.hypot(*(line[1] - line[0]))), 1e-3))) if len(line) > 1 else 1
        steep = np.flatnonzero(heights[apart:] - heights[:-apart] > 2 * limit)
        return int(steep[0]) if len(steep) else len(line)


@dataclass(frozen=True)
class ArcHazards:
    """Hazards along each of A arcs, at their worst.

    Attributes:
        end: x, y of the arc's end [m].
        climb, descent: slope along the vehicle, up and down (rise over run, both positive).
        lean: slope across the vehicle, to either side (rise over run).
        protrusion: height of the ground below the belly or ahead of the nose above the wheels' plane [m].
        vertical_curvature: curvature of the path in the vertical plane [1/m].
        clearance: distance from the vehicle's middle to the surface of the nearest trunk [m].
        border_overlap: how far the arc reaches into the margin at the border [m].
    """

    end: Float[np.ndarray, "A 2"]
    climb: Float[np.ndarray, " A"]
    descent: Float[np.ndarray, " A"]
    lean: Float[np.ndarray, " A"]
    protrusion: Float[np.ndarray, " A"]
    vertical_curvature: Float[np.ndarray, " A"]
    clearance: Float[np.ndarray, " A"]
    border_overlap: Float[np.ndarray, " A"]


def hazards_along_arcs(
    terrain: VisibleTerrain,
    curvatures: Float[np.ndarray, " A"],
    *,
    x: float,
    y: float,
    yaw: float,
    length: float,
    size: tuple[float, float, float],
    margin: float,
) -> ArcHazards:
    """Hazards along arcs that begin at one pose.

    Args:
        curvatures: curvature of each arc, + to the left [1/m].
        x, y, yaw: pose of the vehicle [m, rad].
        length: length of the arcs [m].
        size: the vehicle's wheelbase, track and distance from its middle to its nose [m].
        margin: distance to keep from the border [m].
    """
    out = np.empty((9, len(curvatures)))
    near = np.hypot(terrain.trees[:, 0] - x, terrain.trees[:, 1] - y) < length + 5
    _scan_arcs(
        terrain.elevation, *terrain.origin, terrain.resolution, terrain.trees[near],
        curvatures, x, y, yaw, length, *size, margin, out,
    )  # fmt: skip
    return ArcHazards(out[:2].T, *out[2:])


@PHYSICS.entry
def _scan_arcs(  # type: ignore[no-untyped-def]
    elevation, x0, y0, resolution, trees, curvatures, x, y, yaw, length, wheelbase, track, nose, margin, out
):
    high_x = x0 + (elevation.shape[1] - 1) * resolution - margin
    high_y = y0 + (elevation.shape[0] - 1) * resolution - margin
    count = max(int(length / ARC_STEP), 4)
    step = length / count
    for a in range(len(curvatures)):
        climb, descent, lean, protrusion, curvature, clearance, overlap = 0.0, 0.0, 0.0, 0.0, 0.0, FAR, 0.0
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
            protrusion = max(protrusion, max(below - mean, ahead - mean - nose * slope))
            if number > 0:
                curvature = max(curvature, abs(slope - slope_before) / step)
            slope_before = slope
            overlap = max(overlap, max(max(x0 + margin - px, px - high_x), max(y0 + margin - py, py - high_y)))
            for t in range(len(trees)):
                gap = np.sqrt((trees[t, 0] - px) ** 2 + (trees[t, 1] - py) ** 2) - trees[t, 2]
                clearance = min(clearance, gap)
        out[0, a], out[1, a] = px, py
        out[2, a], out[3, a], out[4, a], out[5, a] = climb, descent, lean, protrusion
        out[6, a], out[7, a], out[8, a] = curvature, clearance, overlap
