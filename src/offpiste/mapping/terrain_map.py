"""The ground as a 2D map of cells on a world-aligned grid.

The map as a planner and the models read it: layers over the cells of a world-aligned grid.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float


@dataclass(frozen=True)
class TerrainMap:
    """Elevation and features of ground cells; NaN where nothing is known.

    Attributes:
        origin: x, y of the centre of cell [0, 0] in the world frame [m].
        resolution: size of a cell [m].
        elevation: row j lies at y = origin[1] + j resolution, column i at x = origin[0] + i resolution [m].
        features: of each cell; all NaN where missing.
        rise: towards +x and towards +y at cell centres, where they are known better than from the elevation of
            neighbours [m per m].
    """

    origin: Float[np.ndarray, " 2"]
    resolution: float
    elevation: Float[np.ndarray, "ny nx"]
    features: Float[np.ndarray, "ny nx F"]
    rise: Float[np.ndarray, "ny nx 2"] | None = None

    def cropped(self, low: Float[np.ndarray, " 2"], high: Float[np.ndarray, " 2"]) -> "TerrainMap":
        """The cells whose centres lie in a box of the world frame, and one around them."""
        ny, nx = self.elevation.shape
        first = np.clip(np.floor((low - self.origin) / self.resolution).astype(int), 0, [nx - 1, ny - 1])
        last = np.clip(np.ceil((high - self.origin) / self.resolution).astype(int), 0, [nx - 1, ny - 1])
        rows, columns = slice(first[1], last[1] + 1), slice(first[0], last[0] + 1)
        origin = self.origin + first * self.resolution
        rise = None if self.rise is None else self.rise[rows, columns]
        return TerrainMap(origin, self.resolution, self.elevation[rows, columns], self.features[rows, columns], rise)


@dataclass(frozen=True)
class TerrainLayers:
    """Layers of the ground around the vehicle; row j lies at y = origin[1] + j resolution, column i alike in x.

    Attributes:
        origin: x, y of the centre of cell [0, 0] in the world frame [m].
        resolution: size of a cell [m].
        elevation: of the ground at the cell's centre [m]; NaN where not `known`.
        normal: unit normal of the ground, upwards, in the world frame; NaN where it cannot be told.
        slope: rise over run, 1 on 45 degrees; NaN without a normal.
        roughness: root mean square distance of the ground from its planes, measured along z [m]; NaN without a normal.
        obstacle_height: from the ground to the highest thing on it that a vehicle would hit: what begins above the
            vehicle's height is driven under [m]; NaN where not `known`.
        features: NaN where not `valid`.
        distance: from which the features were seen [m]; NaN where not `valid`.
        known: whether there is ground: observed, or filled from a cell nearby.
        observed: whether the cell itself was hit.
        valid: whether there are features.
    """

    origin: Float[np.ndarray, " 2"]
    resolution: float
    elevation: Float[np.ndarray, "ny nx"]
    normal: Float[np.ndarray, "ny nx 3"]
    slope: Float[np.ndarray, "ny nx"]
    roughness: Float[np.ndarray, "ny nx"]
    obstacle_height: Float[np.ndarray, "ny nx"]
    features: Float[np.ndarray, "ny nx F"]
    distance: Float[np.ndarray, "ny nx"]
    known: Bool[np.ndarray, "ny nx"]
    observed: Bool[np.ndarray, "ny nx"]
    valid: Bool[np.ndarray, "ny nx"]

    @property
    def unknown(self) -> Bool[np.ndarray, "ny nx"]:
        """Cells of which nothing is known, for planners that keep off them."""
        return ~self.known

    @property
    def centres(self) -> Float[np.ndarray, "ny nx 2"]:
        """x, y of the cells' centres in the world frame [m]."""
        ny, nx = self.known.shape
        x = self.origin[0] + self.resolution * np.arange(nx)
        y = self.origin[1] + self.resolution * np.arange(ny)
        return np.stack(np.meshgrid(x, y), axis=-1)

    def terrain_map(self) -> TerrainMap:
        """What lookups need; shares memory with the layers where it can."""
        with np.errstate(invalid="ignore"):
            rise = -self.normal[..., :2] / self.normal[..., 2:]
        return TerrainMap(self.origin, self.resolution, self.elevation, self.features, rise)


def empty_layers(cells: int, channels: int) -> TerrainLayers:
    """Layers [cells, cells] of which nothing is known."""
    shape = (cells, cells)

    def unknown(*more: int, dtype: type = np.float32) -> np.ndarray:
        return np.full(shape + more, np.nan, dtype)

    return TerrainLayers(
        origin=np.zeros(2),
        resolution=1.0,
        elevation=unknown(dtype=np.float64),
        normal=unknown(3),
        slope=unknown(),
        roughness=unknown(),
        obstacle_height=unknown(),
        features=unknown(channels),
        distance=unknown(),
        known=np.zeros(shape, bool),
        observed=np.zeros(shape, bool),
        valid=np.zeros(shape, bool),
    )
