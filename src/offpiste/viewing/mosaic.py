"""All ground that a map around a moving vehicle has shown, for pictures from above."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Int

from offpiste.mapping.layers import TerrainLayers

UNKNOWN, FILLED, OBSERVED, FEATURED = range(4)
"""What is known of a cell: nothing; filled from a cell nearby; hit; seen by a camera."""

MOST_CELLS: Final = 3_000_000
"""Of a mosaic, which takes every second, third, ... cell of the map where the drive is long."""


@dataclass(frozen=True)
class Ground:
    """Cells from above; row j lies at y = origin[1] + j resolution, column i alike in x.

    Attributes:
        origin: x, y of the centre of cell [0, 0] [m].
        elevation: NaN where unknown [m].
        components: the first three features; NaN where there are none.
        obstacle: height of what stands on the ground [m]; NaN where unknown.
        slope: rise over run; NaN where unknown.
        known: `UNKNOWN` to `FEATURED`.
    """

    origin: Float[np.ndarray, " 2"]
    resolution: float
    elevation: Float[np.ndarray, "ny nx"]
    components: Float[np.ndarray, "ny nx 3"]
    obstacle: Float[np.ndarray, "ny nx"]
    slope: Float[np.ndarray, "ny nx"]
    known: Int[np.ndarray, "ny nx"]

    def cropped(self, low: Float[np.ndarray, " 2"], high: Float[np.ndarray, " 2"]) -> "Ground":
        """The cells whose centres lie in a box of the world frame."""
        ny, nx = self.known.shape
        first = np.clip(np.ceil((low - self.origin) / self.resolution).astype(int), 0, [nx, ny])
        stop = np.clip(np.floor((high - self.origin) / self.resolution).astype(int) + 1, first, [nx, ny])
        box = slice(first[1], stop[1]), slice(first[0], stop[0])
        layers = (self.elevation, self.components, self.obstacle, self.slope, self.known)
        return Ground(self.origin + first * self.resolution, self.resolution, *(layer[box] for layer in layers))

    def trimmed(self) -> "Ground":
        """Without unknown rows and columns around."""
        rows, columns = np.nonzero(self.known)
        if not len(rows):
            return self
        low = self.origin + np.array([columns.min(), rows.min()]) * self.resolution
        high = self.origin + np.array([columns.max(), rows.max()]) * self.resolution
        half = self.resolution / 2
        return self.cropped(low - half, high + half)


class Mosaic:
    """Every cell as the map held it last; memory bounded by `MOST_CELLS`.

    Args:
        low, high: corners of a box that holds all maps [m].
        resolution: size of the maps' cells [m].
        most: cells that it may have.
    """

    def __init__(
        self,
        low: Float[np.ndarray, " 2"],
        high: Float[np.ndarray, " 2"],
        resolution: float,
        *,
        most: int = MOST_CELLS,
    ) -> None:
        cells = (high - low) / resolution
        self.step = max(1, int(np.ceil(np.sqrt(cells.prod() / most))))
        self._resolution = resolution
        self._first = np.floor(low / resolution / self.step).astype(int)
        nx, ny = np.ceil(high / resolution / self.step).astype(int) + 1 - self._first
        self._elevation = np.full((ny, nx), np.nan, np.float32)
        self._components = np.full((ny, nx, 3), np.nan, np.float16)
        self._obstacle = np.full((ny, nx), np.nan, np.float16)
        self._slope = np.full((ny, nx), np.nan, np.float16)
        self._known = np.zeros((ny, nx), np.int8)

    def add(self, layers: TerrainLayers) -> None:
        """Take over what a map knows now; what it does not know any more stays."""
        low = np.floor(layers.origin / layers.resolution).astype(int)  # cell i covers [i, i + 1) cells
        skip = -low % self.step
        every = slice(skip[1], None, self.step), slice(skip[0], None, self.step)
        at = (low + skip) // self.step - self._first
        known = layers.known[every]
        rows, columns = np.nonzero(known)
        inside = (rows + at[1] >= 0) & (rows + at[1] < len(self._known))
        inside &= (columns + at[0] >= 0) & (columns + at[0] < self._known.shape[1])
        rows, columns = rows[inside], columns[inside]
        here = rows + at[1], columns + at[0]
        self._elevation[here] = layers.elevation[every][rows, columns]
        self._obstacle[here] = layers.obstacle_height[every][rows, columns]
        self._slope[here] = np.clip(layers.slope[every][rows, columns], 0, 100)
        given = min(3, layers.features.shape[2])
        self._components[here] = np.where(given, np.float16(0), np.float16(np.nan))
        self._components[here[0], here[1], :given] = layers.features[every][rows, columns, :given]
        observed = layers.observed[every][rows, columns]
        valid = layers.valid[every][rows, columns]
        self._known[here] = np.where(valid, FEATURED, np.where(observed, OBSERVED, FILLED))

    def ground(self) -> Ground:
        """What it has; shares memory with the mosaic."""
        size = self._resolution * self.step
        origin = self._first * size + self._resolution / 2
        return Ground(origin, size, self._elevation, self._components, self._obstacle, self._slope, self._known)
