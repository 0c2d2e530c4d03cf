"""Detection of ghosts: LiDAR returns below the ground, from light that was reflected by a shiny surface.

A reflected echo is placed along the straight ray but too far away, so for rays that point downwards it lies below the
ground. Up to a hundred such points can stay at one place for many scans, and each of them digs a pit into the map, as
the lowest voxel of a column counts as ground.

No light passes through the ground. A ray that reaches the bottom of a ditch or the foot of a cliff passes above the
rim; the ray of a ghost passes below ground that other rays of the same scan hit on the near side. Ground seen under
branches or through bushes is passed by such rays as well, but unlike a ghost it lies no lower than other ground nearby.

The ground around the sensor is divided into sectors, and these into rings that widen with distance, like the rings of
a spinning LiDAR on level ground. The cell after the last one collects invalid points.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import minimum_filter

from offpiste.core.errors import MapError
from offpiste.native.library import compiled

HALF_OF_RINGS: Final = 20.0
"""Distance within which half of the rings lie [m]: rings are 0.3 m wide at the sensor, 1.3 m there and 5 m at 60 m."""


@dataclass(frozen=True)
class GhostSettings:
    """Conditions for a return to count as a ghost."""

    # minimum depth of the ray below the ground of two nearer cells, and of the ghost below all ground around it [m]
    depth: float = 0.5
    sectors: int = 128  # numbers of cells around the sensor; the ground of a cell is its lowest return
    rings: int = 64
    window: int = 4  # neighbourhood of a return, in sectors and in rings

    def __post_init__(self) -> None:
        if not 0 < self.depth < float("inf"):
            raise MapError(f"invalid ghosts.depth = {self.depth}", where="map settings", how="give a positive number")
        if not 4 <= self.sectors <= 4096 or not 4 <= self.rings <= 1024 or not 0 <= self.window < self.sectors // 2:
            how = "give 4 to 4096 sectors, 4 to 1024 rings, and a window of less than half the sectors"
            raise MapError(f"invalid ghosts: {self.sectors} sectors, {self.rings} rings", where="map settings", how=how)


class GhostFinder:
    """Detector of ghosts in scans."""

    def __init__(self, settings: GhostSettings | None = None) -> None:
        self.settings = settings or GhostSettings()

    def find(
        self, points_world: Float[np.ndarray, "N 3"], sensor_world: Float[np.ndarray, " 3"]
    ) -> Bool[np.ndarray, " N"]:
        """Return the mask of ghosts in a scan; non-finite points are no ghosts.

        Args:
            points_world: points of one revolution or less [m].
            sensor_world: one sensor position for all points, as its motion during a scan hardly changes ray slopes [m].
        """
        settings, n = self.settings, len(points_world)
        grid, cells, depth = (settings.sectors, settings.rings), settings.sectors * settings.rings, settings.depth
        points, sensor = np.ascontiguousarray(points_world, np.float64), np.ascontiguousarray(sensor_world, np.float64)
        if points.shape != (n, 3) or sensor.shape != (3,):
            raise ValueError(f"points and sensor have shapes {points.shape} and {sensor.shape}")
        cell, height, distance = np.empty(n, np.int32), np.empty(n, np.float32), np.empty(n, np.float32)
        low, away = np.full(cells + 1, np.inf, np.float32), np.ones(cells + 1, np.float32)
        place_returns(points, n, sensor, *grid, HALF_OF_RINGS, cell, height, distance, low, away)
        horizon = np.append(_horizons(low[:-1].reshape(grid), away[:-1].reshape(grid), depth), np.float32(-np.inf))
        with np.errstate(invalid="ignore"):
            ghosts = np.asarray(height < np.take(horizon, cell) * distance)
        found = np.flatnonzero(ghosts)
        if len(found):
            low[cell[found]], low[-1] = np.inf, 0
            others = np.flatnonzero((np.take(low, cell) == np.inf) & ~ghosts)
            np.minimum.at(low, cell[others], height[others])
            window = 2 * settings.window + 1
            ground = minimum_filter(low[:-1].reshape(grid), window, mode=("wrap", "nearest")).ravel()
            ghosts[found] = ground[cell[found]] > height[found] + np.float32(depth)
        return ghosts


def _horizons(
    low: Float[np.ndarray, "sectors rings"], away: Float[np.ndarray, "sectors rings"], depth: float
) -> Float[np.ndarray, "sectors rings"]:
    """Return the lowest possible slope [m/m] of rays to each cell: `depth` below the ground of two nearer cells."""
    slope, nearer = (low - np.float32(depth)) / away, np.full((2, *low.shape), -np.inf, np.float32)
    slope[np.isinf(low)] = -np.inf
    highest, second = nearer
    np.maximum.accumulate(slope[:, :-1], axis=1, out=highest[:, 1:])
    np.maximum.accumulate(np.minimum(highest, slope)[:, :-1], axis=1, out=second[:, 1:])
    return second


@compiled("f8", int, "f8", int, int, float, "i4", "f4", "f4", "f4", "f4")
def place_returns(
    points: Float[np.ndarray, "N 3"],
    count: int,
    sensor: Float[np.ndarray, " 3"],
    sectors: int,
    rings: int,
    half: float,
    cell: Int[np.ndarray, " N"],
    height: Float[np.ndarray, " N"],
    distance: Float[np.ndarray, " N"],
    low: Float[np.ndarray, " C"],
    away: Float[np.ndarray, " C"],
) -> None:
    """Write cell, height over the sensor [m] and horizontal distance [m] of each point, and lower those of each cell.

    Sectors are uniform in y / (|x| + |y|), which avoids the arctangent: 0.7 to 1.4 times their mean angle. Half of the
    rings lie within the distance `half` [m]. Of equally low points the first counts.
    """
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        x, y, z = (points - sensor).astype(np.float32).T
        total, r = np.abs(x) + np.abs(y), np.sqrt(x * x + y * y)
        good = (total > np.float32(0.01)) & (r < np.float32(1e4)) & (np.abs(z) < np.float32(1e4))
        around = np.where(x >= 0, 1 + y / total, 3 - y / total) * np.float32(sectors / 4)
        out = np.float32(rings) * (r / (r + np.float32(half)))
    sector, ring = (np.where(good, each, 0).astype(int) for each in (around, out))
    cell[:] = np.where(good, np.minimum(sector, sectors - 1) * rings + np.minimum(ring, rings - 1), sectors * rings)
    height[:], distance[:] = z, r
    lower = np.flatnonzero(z < low[cell])[::-1]
    np.minimum.at(low, cell[lower], z[lower])
    lower = lower[z[lower] == low[cell[lower]]]
    away[cell[lower]] = r[lower]
