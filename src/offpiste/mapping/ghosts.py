"""Detection of ghosts: LiDAR returns below the ground, from light that was reflected by a shiny surface.

A reflected echo is placed along the straight ray but too far away, so for rays that point downwards it lies below the
ground. Up to a hundred such points can stay at one place for many scans, and each of them digs a pit into the map, as
the lowest voxel of a column counts as ground.

No light passes through the ground. A ray that reaches the bottom of a ditch or the foot of a cliff passes above the
rim; the ray of a ghost passes below ground that other rays of the same scan hit on the near side. Ground seen under
branches or through bushes is passed by such rays as well, but unlike a ghost it lies no lower than other ground nearby.

The ground around the sensor is divided into sectors, and these into rings that widen with distance, like the rings of
a spinning LiDAR on level ground. The cell after the last one collects invalid points. A NumPy reference is in
tests/mapping.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float

from offpiste.core.errors import MapError
from offpiste.native.compilation import MAPPING
from offpiste.native.threads import spread_blocks

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
            raise MapError(f"ghosts: depth is {self.depth}", where="map settings", how="give a positive number")
        if not 4 <= self.sectors <= 4096 or not 4 <= self.rings <= 1024 or not 0 <= self.window < self.sectors // 2:
            how = "give 4 to 4096 sectors, 4 to 1024 rings, and a window of less than half the sectors"
            raise MapError(f"ghosts: {self.sectors} sectors, {self.rings} rings", where="map settings", how=how)


class GhostFinder:
    """Detector of ghosts in consecutive scans, with reused buffers; the result does not depend on `threads`."""

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
        """Return the mask of ghosts in a scan; non-finite points are no ghosts.

        Args:
            points_world: points of one revolution or less [m].
            sensor_world: one sensor position for all points, as its motion during a scan hardly changes ray slopes [m].
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
    """Write cell, height over the sensor [m] and horizontal distance [m] of points `first` to `last`.

    Sectors are uniform in y / (|x| + |y|), which avoids the arctangent: 0.7 to 1.4 times their mean angle. Half of the
    rings lie within the distance `half` [m].
    """
    per_sector, count = np.float32(sectors / 4), np.float32(rings)
    # Without branches, so that the compiler vectorises the loop.
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
    """Update the lowest height of each cell and the index of its point, except for points marked in `left_out`."""
    for i in range(len(cell)):
        c = cell[i]
        if height[i] < low[c] and not left_out[i]:
            low[c], lowest[c] = height[i], i


@MAPPING.entry
def find_horizons(low, lowest, distance, depth, rings, horizon):  # type: ignore[no-untyped-def]
    """Write the lowest possible slope [m/m] of rays to a cell: `depth` below the ground of two nearer cells."""
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
    """Mark points whose rays pass below the ground and clear the ground of their cells; return their number."""
    count = 0
    for i in range(len(cell)):
        if height[i] < horizon[cell[i]] * distance[i]:
            pierced[i], low[cell[i]] = True, np.float32(np.inf)
            count += 1
    return count


@MAPPING.entry
def unmark_supported(cell, height, low, depth, rings, window, pierced):  # type: ignore[no-untyped-def]
    """Unmark points with ground at most `depth` above them in a cell up to `window` sectors and rings away."""
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
