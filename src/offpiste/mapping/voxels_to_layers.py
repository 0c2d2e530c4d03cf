"""Flattening of voxels into 2D layers: lowest valid voxel of each column, gaps filled from the nearest cell, planes.

"The visual terrain features in the 3D voxel data are compressed to a 2D map output by taking the lowest valid data
point within each vertical stack of voxels [...] missing data is filled in with data from the nearest neighboring cell
in a 0.4 m radius" (paper, "Mapping of Visual Features"). Ground under a bush is the lowest hit below it; a branch over
a column without any other hit is recognised by its neighbours (`FlattenSettings.overhang_radius`).

Rows and columns in grids count from the map's lowest cell. Offsets are in cells, heights in metres over the floor of a
reference level, so that float32 suffices anywhere.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int

from offpiste.core.errors import MapError
from offpiste.mapping.ground import drop_overhangs, find_spans, make_grids, make_surface, read_columns, see_columns
from offpiste.mapping.infill import read_cells, write_layers
from offpiste.mapping.normals import fit_planes, smooth_residuals
from offpiste.mapping.terrain_map import LAYERS, TerrainLayers, empty_layers, nothing_known
from offpiste.mapping.voxel_map import VoxelMap, check_positive
from offpiste.native.threads import spread_blocks


@dataclass(frozen=True)
class FlattenSettings:
    """Settings of the conversion from voxels to map layers."""

    feature_height: float = 0.5  # maximum height of a feature above the ground [m]
    fill_radius: float = 0.4  # maximum distance between cell centres for filling a gap (paper: 0.4 m) [m]
    vehicle_height: float = 2.0  # clearance above which things are driven under; a side-by-side is 1.9 m high [m]
    # a column whose lowest voxel lies more than `vehicle_height` above the lowest one in the square of +-this around it
    # is a branch without visible ground [m]. Slopes of up to 54 degrees are never affected.
    overhang_radius: float = 1.0
    plane_radius: float = 0.4  # half the side of the window for normals and roughness [m]

    def __post_init__(self) -> None:
        check_positive(self, "feature_height", "vehicle_height", "plane_radius")
        if not all(0 <= radius <= 5 for radius in (self.fill_radius, self.overhang_radius, self.plane_radius)):
            how = "correct fill_radius, overhang_radius or plane_radius"
            raise MapError("radii are 0 to 5 m", where="map settings", how=how)


class MapCells(NamedTuple):
    """Values of `TerrainLayers` at K cells; NaN where unknown."""

    elevation: np.ndarray
    normal: np.ndarray
    features: np.ndarray
    distance: np.ndarray
    known: np.ndarray
    valid: np.ndarray


def neighbour_offsets(radius: float) -> Int[np.ndarray, "K 2"]:
    """Return row and column offsets of cells whose centres lie within a radius [cells], nearest first.

    Equal distances are sorted by y, then by x.
    """
    most = int(radius + 1e-6)
    dy, dx = (offset.ravel() for offset in np.mgrid[-most : most + 1, -most : most + 1])
    squared = dy * dy + dx * dx
    near = squared <= radius * radius + 1e-6
    order = np.lexsort((dx[near], dy[near], squared[near]))
    return np.column_stack((dy[near], dx[near]))[order].astype(np.int64)


class Flattener:
    """Converter of one voxel map into layers that reads only columns changed since the last call.

    Its memory is 27 MB for 600 x 600 cells, and 1.4 MB per feature.
    """

    def __init__(self, voxel_map: VoxelMap, settings: FlattenSettings) -> None:
        self.settings = settings
        self._map = voxel_map
        size, n = voxel_map.settings.size, voxel_map.cells
        self._plane_cells = max(1, round(settings.plane_radius / size))
        self._plane = self._plane_cells, size
        self._overhang_cells = round(settings.overhang_radius / size)
        self._offsets = neighbour_offsets(settings.fill_radius / size)
        fill_cells = int(np.abs(self._offsets).max())
        self._border = max(self._plane_cells, self._overhang_cells, fill_cells)
        self._grids = make_grids(n, self._border)
        self._surface, self._since = make_surface(n, voxel_map.channels), 0
        self._whole = np.tile(np.array([0, n]), (n, 1))
        # A cell depends on the nearest ground, its plane on cells around that, and branches on cells around those.
        self._margin = fill_cells + self._plane_cells + self._overhang_cells

    def layers(self, out: TerrainLayers | None = None) -> TerrainLayers:
        """Return the map's layers; `out`: earlier layers of this map, unmodified, to be overwritten and returned."""
        voxel_map = self._map
        n, threads = voxel_map.cells, voxel_map.settings.threads
        out = out or empty_layers(n, voxel_map.channels)
        arrays = [getattr(out, layer.name) for layer in LAYERS]
        if any(array.shape[:2] != (n, n) for array in arrays) or out.features.shape[2] != voxel_map.channels:
            raise ValueError("these are layers of another map")
        if self._is_stale:
            self._find_ground(self._whole, threads)
            spread_blocks(threads, n, fit_planes, *self._plane, *self._sized_grids)
            self._since = voxel_map.changes
        spread_blocks(threads, n, smooth_residuals, self._plane_cells, *self._sized_grids)
        spread_blocks(threads, n, write_layers, *self._filling, *arrays)
        return replace(out, origin=voxel_map.origin, resolution=voxel_map.settings.size)

    def cells(self, rows: Int[np.ndarray, " K"], columns: Int[np.ndarray, " K"]) -> MapCells:
        """Return the layers' values at some cells, in a fraction of the time of `layers`."""
        n, channels = self._map.cells, self._map.channels
        out = MapCells(*(nothing_known(name, (len(rows),), channels) for name in MapCells._fields))
        rows, columns = np.ascontiguousarray(rows, np.int64), np.ascontiguousarray(columns, np.int64)
        if not len(rows):
            return out
        if rows.shape != columns.shape or min(rows.min(), columns.min()) < 0 or max(rows.max(), columns.max()) >= n:
            raise ValueError(f"cells lie outside the map of {n} x {n}")
        if self._is_stale:
            self._find_ground(find_spans(rows, columns, self._margin, n), 1)
        read_cells(rows, columns, len(rows), *self._plane, *self._filling, *out)
        return out

    @property
    def _is_stale(self) -> bool:
        """Whether the map changed since `layers` found the ground and planes of all columns."""
        return self._since < self._map.changes or not self._map.changes

    @property
    def _reference(self) -> int:
        """Level of the floor that heights in the grids are relative to."""
        return round(self._map.middle / self._map.settings.size)

    @property
    def _start(self) -> tuple[int, int]:
        """Column and row of the map's lowest cell in the voxels."""
        x, y = (self._map.low % self._map.cells).tolist()
        return x, y

    @property
    def _sized_grids(self) -> tuple[np.ndarray, int, int]:
        return self._grids, self._map.cells, self._border

    @property
    def _filling(self) -> tuple[Any, ...]:
        """Arguments of `write_layers` and `read_cells`."""
        floor, offsets = self._reference * self._map.settings.size, self._offsets
        frame = floor, self.settings.feature_height, offsets, len(offsets), *self._sized_grids
        return *frame, self._surface.features, self._map.channels, *self._start

    def _find_ground(self, spans: Int[np.ndarray, "n 2"], threads: int) -> None:
        """Update ground, obstacles and feature heights of the columns in spans; values near their ends may be wrong."""
        voxel_map, settings, surface, voxels = self._map, self.settings, self._surface, self._map.voxels
        size, n, width, overhang = voxel_map.settings.size, voxel_map.cells, voxels.seen.shape[1], self._overhang_cells
        reach, frame = settings.vehicle_height, (*self._start, spans)
        held = voxels.heads, voxels.changed, voxels.slots, *surface, n, voxel_map.channels, width, voxels.seen
        spread_blocks(threads, n, see_columns, *frame, size, reach, *held)
        ground = self._reference, size, overhang, surface.level, surface.hits
        spread_blocks(threads, n, read_columns, *frame, *ground, *self._sized_grids)
        limits = reach, settings.feature_height
        spread_blocks(threads, n, drop_overhangs, spans, overhang, *limits, *self._sized_grids)
