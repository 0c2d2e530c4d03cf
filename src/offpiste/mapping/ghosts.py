"""Ghosts: returns below the ground, of light that took a detour over something shiny.

A LiDAR places an echo along the straight ray. Light that came by a detour seems to come from further away, and where
the ray points downwards, from below the ground: a mirror image that may stay at one place for many scans, of a hundred
points at a time. The lowest voxel of a column counts as ground, so that each of them digs a pit into the map.

No light passes through the ground. A ray that reaches the bottom of a ditch or the foot of a cliff passes above the
rim; the ray of a ghost passes below ground that other rays of the same scan hit on the near side. Ground that is
seen under branches or through bushes is passed by such rays, too, and kept: unlike a ghost it lies no lower than other
ground around it.

The ground around the sensor is divided into sectors, and these into rings that widen with distance, about as the rings
of a spinning LiDAR do on level ground. The cell after the last one takes points that are nowhere.
The same in plain NumPy is in tests/mapping.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from offpiste.core.errors import MapError
from offpiste.native.compilation import MAPPING, spread_blocks

HALF_OF_RINGS: Final = 20.0
"""Distance within which half of the rings lie [m]: they are 0.3 m wide at the sensor, 1.3 m there and 5 m at 60 m."""


@dataclass(frozen=True)
class GhostSettings:
    """When a return counts as a ghost.

    Attributes:
        depth: rays of ghosts pass at least so far below the ground of two cells on their way, and ghosts lie so far
            below all ground around them [m].
        sectors, rings: cells around the sensor; the ground of a cell is the lowest return in it.
        window: ground up to so many sectors and rings away lies around a return.
    """

    depth: float = 0.5
    sectors: int = 128
    rings: int = 64
    window: int = 4

    def __post_init__(self) -> None:
        if not 0 < self.depth < float("inf"):
            raise MapError(f"ghosts: depth is {self.depth}", where="map settings", how="give a positive number")
        if not 4 <= self.sectors <= 4096 or not 4 <= self.rings <= 1024 or not 0 <= self.window < self.sectors // 2:
            how = "give 4 to 4096 sectors, 4 to 1024 rings, and a window of less than half the sectors"
            raise MapError(f"ghosts: {self.sectors} sectors, {self.rings} rings", where="map settings", how=how)


class GhostFinder:
    """Finds the ghosts in scans, one after another; it keeps its buffers.

    Args:
        threads: that find the cells of points; the result does not depend on it.
    """

    def __init__(self, settings: GhostSettings | None = None, threads: int = 1) -> None:
        self.settings = settings or GhostSettings()
        self._threads = threads
        cells = self.settings.sectors * self.settings.rings + 1
        self._low, self._horizon = np.zeros(cells, np.float32), np.zeros(cells, np.float32)
        self._lowest = np.zeros(cells, np.int32)
        self._size_buffers(0)

    def find(
        self, points_world: Float[np.ndarray, "N 3"], sensor_world: Float[np.ndarray, " 3"]
    ) -> Bool[np.ndarray, " N"]:
        """Which points of one scan are ghosts.

        Args:
            points_world: of one revolution or less [m]; what is not finite is no ghost.
            sensor_world: where the scan was taken from: one place for all of them, as the sensor's way during a scan
                changes slopes of rays by little [m].
        """
        settings, n = self.settings, len(points_world)
        if n > len(self._cell):
            self._size_buffers(n + n // 4)
        cell, height, distance = self._cell[:n], self._height[:n], self._distance[:n]
        depth, rings, ghosts = np.float32(settings.depth), settings.rings, np.zeros(n, np.bool_)
        points, sensor = np.ascontiguousarray(points_world, np.float64), np.ascontiguousarray(sensor_world, np.float64)
        grid = settings.sectors, rings, np.float32(HALF_OF_RINGS)
        spread_blocks(self._threads, n, place_returns, points, sensor, *grid, cell, height, distance)
        self._low.fill(np.inf)
        find_lowest(cell, height, ghosts, self._low, self._lowest)
        find_horizons(self._low, self._lowest, distance, depth, rings, self._horizon)
        if mark_pierced(cell, height, distance, self._horizon, self._low, ghosts):
            find_lowest(cell, height, ghosts, self._low, self._lowest)
            unmark_supported(cell, height, self._low, depth, rings, settings.window, ghosts)
        return ghosts

    def _size_buffers(self, points: int) -> None:
        self._cell = np.zeros(points, np.int32)
        self._height, self._distance = np.zeros(points, np.float32), np.zeros(points, np.float32)


@MAPPING.entry
def place_returns(first, last, points, sensor, sectors, rings, half, cell, height, distance):  # type: ignore[no-untyped-def]
    """Put the cell, the height over the sensor [m] and the horizontal distance from it [m] of points `first` to `last`.

    Sectors are even in y / (|x| + |y|), which takes no arcus tangent: 0.7 to 1.4 times their mean angle.

    Args:
        points, sensor: [N, 3], [3] (float64) [m].
        half: half of all rings lie within this distance [m].
    """
    per_sector, count = np.float32(sectors / 4), np.float32(rings)
    # Written without branches, so that the compiler takes several points at a time.
    for i in range(first, last):
        x, y = np.float32(points[i, 0] - sensor[0]), np.float32(points[i, 1] - sensor[1])
        z, away = np.float32(points[i, 2] - sensor[2]), abs(x) + abs(y)
        r = np.sqrt(x * x + y * y)
        good = (away > np.float32(0.01)) & (r < np.float32(1e4)) & (abs(z) < np.float32(1e4))
        share = y / away
        around = np.float32(1) + share if x >= 0 else np.float32(3) - share
        sector = np.int32((around if good else np.float32(0)) * per_sector)
        ring = np.int32(count * ((r if good else np.float32(0)) / (r + half if good else half)))
        sector, ring = min(sector, np.int32(sectors - 1)), min(ring, np.int32(rings - 1))
        cell[i] = sector * np.int32(rings) + ring if good else np.int32(sectors * rings)
        height[i] = z
        distance[i] = r


@MAPPING.entry
def find_lowest(cell, height, left_out, low, lowest):  # type: ignore[no-untyped-def]
    """Lower the least height in each cell, and put whose it is; some points are left out."""
    for i in range(len(cell)):
        c = cell[i]
        if height[i] < low[c] and not left_out[i]:
            low[c], lowest[c] = height[i], i


@MAPPING.entry
def find_horizons(low, lowest, distance, depth, rings, horizon):  # type: ignore[no-untyped-def]
    """Put the slope [m per m] of rays that pass, on their way to a cell, `depth` below the ground of two cells.

    The ground of a cell is its lowest point. No ray can be steeper.
    """
    for first in range(0, len(low) - 1, rings):
        highest = second = np.float32(-np.inf)
        for c in range(first, first + rings):
            horizon[c] = second
            if low[c] < np.inf:
                slope = (low[c] - depth) / distance[lowest[c]]
                second = max(second, min(highest, slope))
                highest = max(highest, slope)
    horizon[len(low) - 1] = np.float32(-np.inf)


@MAPPING.entry
def mark_pierced(cell, height, distance, horizon, low, pierced):  # type: ignore[no-untyped-def]
    """Mark points whose rays pass below the ground, and forget the ground of their cells; returns their number."""
    count = 0
    for i in range(len(cell)):
        if height[i] < horizon[cell[i]] * distance[i]:
            pierced[i], low[cell[i]] = True, np.float32(np.inf)
            count += 1
    return count


@MAPPING.entry
def unmark_supported(cell, height, low, depth, rings, window, pierced):  # type: ignore[no-untyped-def]
    """Unmark points with ground not more than `depth` above them in some cell up to `window` sectors and rings away."""
    cells = len(low) - 1
    for i in range(len(cell)):
        if not pierced[i]:
            continue
        ring = cell[i] % rings
        nearest, furthest = max(ring - window, 0), min(ring + window, rings - 1)
        for beside in range(-window, window + 1):
            start = (cell[i] - ring + beside * rings) % cells
            for c in range(start + nearest, start + furthest + 1):
                if low[c] <= height[i] + depth:
                    pierced[i] = False
