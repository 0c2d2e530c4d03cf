"""Flattening of voxels into 2D layers: lowest valid voxel of each column, gaps filled from the nearest cell, planes.

"The visual terrain features in the 3D voxel data are compressed to a 2D map output by taking the lowest valid data
point within each vertical stack of voxels [...] missing data is filled in with data from the nearest neighboring cell
in a 0.4 m radius" (paper, "Mapping of Visual Features"). Ground under a bush is the lowest hit below it; a branch over
a column without any other hit is recognised by its neighbours (`FlattenSettings.overhang_radius`).

Rows and columns in buffers count from the map's lowest cell. Offsets are in cells, heights in metres over the floor of
a reference level, so that float32 suffices anywhere.
"""

from collections import namedtuple
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from offpiste.core.errors import MapError
from offpiste.mapping.ground import BLOCK, drop_overhangs, put_spans, read_columns, see_columns
from offpiste.mapping.infill import fill_gaps, find_grounds, fit_planes_at, make_gathered, read_cells, write_layers
from offpiste.mapping.normals import SUMS, fit_planes, smooth_residuals
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
        if not 0 <= self.fill_radius <= 5 or not 0 <= self.overhang_radius <= 5:
            raise MapError("radii are 0 to 5 m", where="map settings", how="correct fill_radius or overhang_radius")


Layers = namedtuple("Layers", [layer.name for layer in LAYERS])  # type: ignore[misc]
"""Arrays of `TerrainLayers`, for loops."""

Surface = namedtuple("Surface", "level x y z obstacle feature_height features since")
"""Ground of each column, kept between calls and indexed like the voxels: level of the lowest voxel from the world's
zero; its hit, x, y from its centre and z from its floor, NaN in an empty column [voxels]; height of the highest thing
within reach over it [m]; height of the lowest voxel with features over it, NaN without any [m]; distance and features
of that voxel [n, n, 1 + F]; number of the last evaluated map change per block of columns [n, n / BLOCK]."""


def make_surface(cells: int, channels: int) -> Surface:
    """Return the surface of an empty map of [cells, cells]."""
    shape = (cells, cells)
    unknown = (np.full(shape, np.nan, np.float32) for _ in range(5))
    features = np.full((*shape, 1 + channels), np.nan, np.float32)
    since = np.zeros((cells, -(-cells // BLOCK)), np.int32)
    return Surface._make((np.zeros(shape, np.int32), *unknown, features, since))


Buffers = namedtuple(
    "Buffers",
    "x y height obstacle feature_height lowest rise_x rise_y centre residual roughness which which_feature "
    "sums moments line",
)
"""Arrays passed between loops [n, n]: hit of the lowest voxel, x, y from the cell's centre, height NaN without ground;
obstacle height; height of the features, NaN without any that count; lowest ground of the cells beside, along the row;
rise of the plane [m/m], ground at the cell's centre, squared residual of the hit and roughness, NaN without a plane;
numbers of the offsets that lead to ground and features, -1 without any. `sums`, `moments`, `line`: rows of sums."""


def make_buffers(cells: int, blocks: int, plane_cells: int) -> Buffers:
    """Return buffers for maps of [cells, cells] that are processed in blocks of rows."""
    grids = (np.zeros((cells, cells), np.float32) for _ in range(11))
    numbers = (np.zeros((cells, cells), np.int32) for _ in range(2))
    rows = (2 * plane_cells + 2, SUMS, cells), (SUMS, cells + 2 * plane_cells), (2, cells)
    return Buffers._make((*grids, *numbers, *(np.zeros((blocks, *row), np.float32) for row in rows)))


CellPlanes = namedtuple("CellPlanes", "rows columns height rise_x rise_y centre")
"""Planes around K cells; height, rise_x, rise_y and centre as in `Buffers`."""


def make_cell_planes(count: int) -> CellPlanes:
    """Return buffers for the planes around some cells."""
    return CellPlanes(*(np.zeros(count, dtype) for dtype in (np.int64, np.int64, *4 * (np.float32,))))


class MapCells(NamedTuple):
    """Values of `TerrainLayers` at K cells; NaN where unknown."""

    known: np.ndarray
    valid: np.ndarray
    elevation: np.ndarray
    distance: np.ndarray
    normal: np.ndarray
    features: np.ndarray


def make_map_cells(count: int, channels: int) -> MapCells:
    """Return buffers for the layers' values at some cells."""
    none = (nothing_known(name, (0,), channels) for name in MapCells._fields)
    return MapCells(*(np.empty((count, *each.shape[1:]), each.dtype) for each in none))


def flatten(voxel_map: VoxelMap, settings: FlattenSettings | None = None) -> TerrainLayers:
    """Return the layers of a map; `Flattener` does so repeatedly without new memory."""
    return Flattener(voxel_map, settings or FlattenSettings()).layers()


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

    Its buffers take 29 MB for 600 x 600 cells, and 1.4 MB per feature.
    """

    def __init__(self, voxel_map: VoxelMap, settings: FlattenSettings) -> None:
        self.settings = settings
        self._map = voxel_map
        size, n, threads = voxel_map.settings.size, voxel_map.cells, voxel_map.settings.threads
        self._plane_cells = max(1, round(settings.plane_radius / size))
        self._overhang_cells = round(settings.overhang_radius / size)
        self._offsets = neighbour_offsets(settings.fill_radius / size)
        self._buffers = make_buffers(n, threads, self._plane_cells)
        self._surface, self._since = make_surface(n, voxel_map.channels), 0
        self._whole = np.tile(np.array([0, n]), (n, 1))
        self._gathered = make_gathered(self._plane_cells)
        self._bare, self._spans = np.zeros_like(self._whole), np.zeros_like(self._whole)
        # A cell depends on the nearest ground, its plane on cells around that, and branches on cells around those.
        self._margin = int(np.abs(self._offsets).max()) + self._plane_cells + self._overhang_cells

    def layers(self, out: TerrainLayers | None = None) -> TerrainLayers:
        """Return the map's layers; `out`: earlier layers of this map, unmodified, to be overwritten and returned."""
        voxel_map, buffers, surface = self._map, self._buffers, self._surface
        size, n, threads = voxel_map.settings.size, voxel_map.cells, voxel_map.settings.threads
        out = out or empty_layers(n, voxel_map.channels)
        arrays = Layers(*(getattr(out, layer.name) for layer in LAYERS))
        limit = np.float32(self.settings.feature_height)

        self._find_whole_ground()
        spread_blocks(threads, threads, smooth_residuals, threads, self._plane_cells, buffers)
        spread_blocks(threads, threads, fill_gaps, threads, self._offsets, limit, buffers)
        spread_blocks(
            threads, threads, write_layers, threads, self._floor, voxel_map.low, self._offsets, surface, buffers, arrays
        )
        return replace(out, origin=voxel_map.origin, resolution=size)

    def cells(self, rows: Int[np.ndarray, " K"], columns: Int[np.ndarray, " K"]) -> MapCells:
        """Return the layers' values at some cells, in a fraction of the time of `layers`."""
        out = make_map_cells(len(rows), self._map.channels)
        limit = np.float32(self.settings.feature_height)
        if self._since < self._map.changes or not self._map.changes:
            put_spans(rows, columns, self._margin, self._bare, self._spans)
            self._find_ground(self._spans, 1)
        planes, offsets, buffers = make_cell_planes(len(rows)), self._offsets, self._buffers
        find_grounds(rows, columns, offsets, buffers, planes)
        fit_planes_at(self._plane_cells, np.float32(self._map.settings.size), buffers, self._gathered, planes)
        read_cells(rows, columns, self._floor, self._map.low, offsets, limit, self._surface, buffers, planes, out)
        return out

    @property
    def _reference(self) -> int:
        """Level of the floor that heights in the buffers are relative to."""
        return round(self._map.middle / self._map.settings.size)

    @property
    def _floor(self) -> float:
        return self._reference * self._map.settings.size

    def _find_whole_ground(self) -> None:
        """Update ground and planes of all columns if the map changed."""
        if self._since < self._map.changes or not self._map.changes:
            threads, step = self._map.settings.threads, np.float32(self._map.settings.size)
            self._find_ground(self._whole, threads)
            spread_blocks(threads, threads, fit_planes, threads, self._plane_cells, step, self._buffers)
            self._since = self._map.changes

    def _find_ground(self, spans: Int[np.ndarray, "n 2"], threads: int) -> None:
        """Update ground, obstacles and feature heights of the columns in spans; values near their ends may be wrong."""
        voxel_map, settings, buffers, surface = self._map, self.settings, self._buffers, self._surface
        size, n = voxel_map.settings.size, voxel_map.cells
        step, reach, low = np.float32(size), np.float32(settings.vehicle_height), voxel_map.low
        limit, overhang = np.float32(settings.feature_height), self._overhang_cells
        spread_blocks(threads, n, see_columns, low, spans, step, reach, voxel_map.voxels, surface)
        spread_blocks(threads, n, read_columns, low, spans, self._reference, step, overhang, surface, buffers)
        spread_blocks(threads, n, drop_overhangs, spans, overhang, reach, limit, buffers)
