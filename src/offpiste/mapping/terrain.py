"""The ground as a 2D map of cells on a world-aligned grid."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


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


def wheel_places(
    xy: Float[np.ndarray, "N 2"], yaw: Float[np.ndarray, " N"], wheels: Float[np.ndarray, "4 2"]
) -> Float[np.ndarray, "N 4 2"]:
    """Horizontal places of the wheels in the world frame [m], for a vehicle that stands level.

    Args:
        xy, yaw: of the pose point.
        wheels: in the body frame, from the pose point.
    """
    cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    x, y = wheels.T
    return np.stack((xy[:, :1] + cos * x - sin * y, xy[:, 1:] + sin * x + cos * y), axis=-1)
