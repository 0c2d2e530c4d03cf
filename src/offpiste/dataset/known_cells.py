"""Known cells of maps: lists cropped to the reach of a window, and stacks for lookups."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float16, Float32, Int32
from scipy.spatial.distance import cdist
from torch import Tensor

from offpiste.core.conventions import DT, HORIZON_STEPS
from offpiste.mapping.terrain_map import TerrainMap
from offpiste.mapping.terrain_sampler import CellStack, last_cells

CELL_ARRAYS = ("place", "elevation", "rise", "features")
"""Arrays of a `CellList`; on disk, those of all snapshots are concatenated."""

_STARTING, _BACKWARDS = 4.0, 0.5
"""Mean speed that a starting vehicle may reach, and speed above which it drives backwards [m/s]."""


@dataclass(frozen=True)
class CellList:
    """Known cells of a map.

    Attributes:
        origin: x, y of the centre of cell [0, 0] of the map [m].
        shape: rows and columns of the map.
        place: row * columns + column.
        elevation: [m].
        rise: slope towards +x and +y; NaN where unknown.
        features: NaN where missing.
    """

    origin: Float[np.ndarray, " 2"]
    shape: tuple[int, int]
    place: Int32[np.ndarray, " C"]
    elevation: Float32[np.ndarray, " C"]
    rise: Float16[np.ndarray, "C 2"]
    features: Float16[np.ndarray, "C F"]

    def terrain_map(self, resolution: float) -> TerrainMap:
        """Return the map, NaN in all other cells."""
        ny, nx = self.shape

        def spread(values: np.ndarray) -> np.ndarray:
            full = np.full((ny * nx, *values.shape[1:]), np.nan, values.dtype)
            full[self.place] = values
            return full.reshape(ny, nx, *values.shape[1:])

        rise = spread(self.rise)
        return TerrainMap(self.origin, resolution, spread(self.elevation), spread(self.features), rise)

    def near(self, path: Float[np.ndarray, "P 2"], margin: float, resolution: float) -> "CellList":
        """Return the cells within `margin` of the points of a path, on the smallest grid that holds them.

        Args:
            path: x, y in the world frame [m].
            margin, resolution: [m].
        """
        cell = np.stack(np.divmod(self.place, self.shape[1]), axis=-1)
        kept = cdist(self.origin + resolution * cell[:, ::-1], path).min(axis=1) <= margin
        low = cell[kept].min(axis=0, initial=max(self.shape))
        ny, nx = (cell[kept].max(axis=0, initial=0) - low + 1).clip(min=1).tolist()
        place = ((cell[kept] - low) @ [nx, 1]).astype(np.int32)
        origin = self.origin + resolution * low[::-1]
        return CellList(origin, (ny, nx), place, self.elevation[kept], self.rise[kept], self.features[kept])


def crop(terrain: TerrainMap, state: Float[np.ndarray, " 6"], margin: float) -> CellList:
    """Copy the known cells of a map within reach of a window.

    Args:
        state: at the window's start, with px and py in the world frame.
        margin: of `map_snapshots.SnapshotSettings` [m].
    """
    half = 0.5 * HORIZON_STEPS * DT * max(float(np.hypot(state[3], state[4])), _STARTING)
    ahead = -half if state[3] < -_BACKWARDS else half
    centre = state[:2] + ahead * np.array([np.cos(state[2]), np.sin(state[2])])
    near = terrain.cropped(centre - half - margin, centre + half + margin)
    ny, nx = near.elevation.shape
    y, x = (near.origin[1 - axis] + near.resolution * np.arange(n) for axis, n in enumerate((ny, nx)))
    reached = np.hypot(x[None] - centre[0], y[:, None] - centre[1]) <= half + margin
    row, column = np.nonzero(reached & np.isfinite(near.elevation))
    assert near.rise is not None
    return CellList(
        near.origin,
        (ny, nx),
        (row * nx + column).astype(np.int32),
        near.elevation[row, column].astype(np.float32),
        near.rise[row, column].astype(np.float16),
        near.features[row, column].astype(np.float16),
    )


def stack_cells(cells: Sequence[CellList], resolution: float, *, device: torch.device | str = "cpu") -> CellStack:
    """Stack maps as tensors for lookups."""
    ny, nx = (max(c.shape[axis] for c in cells) for axis in (0, 1))
    place = np.full((len(cells), ny, nx), -1, np.int32)
    first = np.cumsum([0] + [len(c.place) for c in cells])
    for number, known in enumerate(cells):
        place[number, *np.divmod(known.place, known.shape[1])] = first[number] + np.arange(len(known.place))

    def listed(parts: Sequence[np.ndarray]) -> Tensor:
        nothing = np.full((1, parts[0].shape[1]), np.nan, parts[0].dtype)
        return torch.from_numpy(np.concatenate([*parts, nothing])).to(device)

    return CellStack(
        resolution,
        torch.as_tensor(np.stack([c.origin for c in cells]), dtype=torch.float64).to(device),
        last_cells([c.shape for c in cells]).to(device),
        torch.from_numpy(place).to(device),
        listed([c.rise for c in cells]),
        listed([c.features for c in cells]),
    )
