"""From voxels to 2D layers: the lowest valid voxel of each column, gaps filled from the nearest cell, planes.

"The visual terrain features in the 3D voxel data are compressed to a 2D map output by taking the lowest valid data
point within each vertical stack of voxels [...] missing data is filled in with data from the nearest neighboring cell
in a 0.4 m radius" (paper, "Mapping of Visual Features"). Ground under a bush is the lowest hit below it; a branch over
a column without any other hit is recognised by its neighbours (`FlattenSettings.overhang_radius`).

Rows and columns of what the loops hand to each other are those of the layers, from the map's lowest cell. Offsets are
in cells, heights in metres over the floor of a reference level, so that float32 is fine wherever the map is.
"""

from collections import namedtuple
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from offpiste.core.errors import MapError
from offpiste.mapping.ground import BLOCK, drop_overhangs, put_spans, read_columns, see_columns
from offpiste.mapping.infill import (
    fill_gaps,
    find_grounds,
    fit_planes_at,
    make_gathered,
    read_cells,
    write_layers,
)
from offpiste.mapping.normals import SUMS, fit_planes, smooth_residuals
from offpiste.mapping.terrain_map import LAYERS, TerrainLayers, empty_layers, nothing_known
from offpiste.mapping.voxel_map import VoxelMap, check_positive
from offpiste.native.compilation import spread_blocks


@dataclass(frozen=True)
class FlattenSettings:
    """How map layers are made from voxels.

    Attributes:
        feature_height: a feature counts while the place where it was seen lies within this of the ground [m].
        fill_radius: gaps are filled from the nearest valid cell up to this far, centre to centre (paper: 0.4 m).
        vehicle_height: what is higher above the ground than this is driven under [m]; a side-by-side is 1.9 m high.
        overhang_radius: a column whose lowest voxel lies more than `vehicle_height` above the lowest one in the square
            of +-this around it is a branch, its ground unseen [m]. Ground of up to 54 degrees is never taken for one.
        plane_radius: normals and roughness come from the square of +-this around a cell [m].
    """

    feature_height: float = 0.5
    fill_radius: float = 0.4
    vehicle_height: float = 2.0
    overhang_radius: float = 1.0
    plane_radius: float = 0.4

    def __post_init__(self) -> None:
        check_positive(self, "feature_height", "vehicle_height", "plane_radius")
        if not 0 <= self.fill_radius <= 5 or not 0 <= self.overhang_radius <= 5:
            raise MapError("radii are 0 to 5 m", where="map settings", how="correct fill_radius or overhang_radius")


Layers = namedtuple("Layers", [layer.name for layer in LAYERS])  # type: ignore[misc]
"""Arrays of `TerrainLayers`, for loops."""


class Surface(NamedTuple):
    """Ground surface per column, kept between flattenings and indexed like the voxels.

    Attributes:
        level: of the lowest voxel, counted from the world's zero [n, n].
        x, y, z: where it was hit, from its centre, z from its floor; NaN in an empty column [voxels] [n, n].
        obstacle: height of the highest thing in reach over that [m] [n, n].
        feature_height: of the lowest voxel with features over it; infinite if there is none [m] [n, n].
        features: of that voxel, and before them the distance from which they were seen [n, n, 1 + F].
        since: number of the map's change up to which the columns of a block are kept [n, n / BLOCK].
    """

    level: np.ndarray
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    obstacle: np.ndarray
    feature_height: np.ndarray
    features: np.ndarray
    since: np.ndarray


def make_surface(cells: int, channels: int) -> Surface:
    """The surface of an empty map of [cells, cells]."""
    shape = (cells, cells)
    names = ("x", "y", "z", "obstacle", "feature_height")
    return Surface(
        level=np.zeros(shape, np.int32),
        **{name: np.full(shape, np.nan, np.float32) for name in names},
        features=np.full((*shape, 1 + channels), np.nan, np.float32),
        since=np.zeros((cells, -(-cells // BLOCK)), np.int32),
    )


class Buffers(NamedTuple):
    """Arrays that are handed from loop to loop.

    Attributes:
        x, y: where the lowest voxel of a column was hit, from the cell's centre [n, n].
        height: and how high; NaN where there is no ground [n, n].
        obstacle: height of the highest thing in reach over it [n, n].
        feature_height: of the lowest voxel with features; NaN where there is none that counts [n, n].
        which, which_feature: numbers of the offsets that lead to a cell's ground and features, -1 if none [n, n].
        lowest: least height of the cells beside, along the row [n, n].
        rise_x, rise_y: of the plane around a cell [m per m]; NaN where there is none [n, n].
        centre: height of the ground at the cell's centre [n, n].
        residual: squared distance of the hit from that plane; NaN where there is none [m^2] [n, n].
        roughness: [m] [n, n].
        sums, moments: room for the sums of `normals.py` [blocks, 2 plane_cells + 2, SUMS, n] and
            [blocks, SUMS, n + 2 plane_cells].
        line: room for rows [blocks, 2, n].
    """

    x: np.ndarray
    y: np.ndarray
    height: np.ndarray
    obstacle: np.ndarray
    feature_height: np.ndarray
    lowest: np.ndarray
    rise_x: np.ndarray
    rise_y: np.ndarray
    centre: np.ndarray
    residual: np.ndarray
    roughness: np.ndarray
    sums: np.ndarray
    moments: np.ndarray
    line: np.ndarray
    which: np.ndarray
    which_feature: np.ndarray


def make_buffers(cells: int, blocks: int, plane_cells: int) -> Buffers:
    """Buffers for maps of [cells, cells], worked on in blocks of rows."""
    whole = {"which", "which_feature"}
    grids = [name for name in Buffers._fields if name not in ("sums", "moments", "line")]
    return Buffers(
        **{name: np.zeros((cells, cells), np.int32 if name in whole else np.float32) for name in grids},
        sums=np.zeros((blocks, 2 * plane_cells + 2, SUMS, cells), np.float32),
        moments=np.zeros((blocks, SUMS, cells + 2 * plane_cells), np.float32),
        line=np.zeros((blocks, 2, cells), np.float32),
    )


class CellPlanes(NamedTuple):
    """Planes around K cells.

    Attributes:
        rows, columns: of the cells.
        height: of their ground over the floor of the reference level; NaN without any [m].
        rise_x, rise_y, centre: as in `Buffers`.
    """

    rows: np.ndarray
    columns: np.ndarray
    height: np.ndarray
    rise_x: np.ndarray
    rise_y: np.ndarray
    centre: np.ndarray


def make_cell_planes(count: int) -> CellPlanes:
    """Room for the planes around some cells."""
    places = (np.zeros(count, np.int64) for _ in range(2))
    return CellPlanes(*places, *(np.zeros(count, np.float32) for _ in range(4)))


class MapCells(NamedTuple):
    """What the layers say of some cells, in the words of `TerrainLayers`; NaN where unknown.

    Attributes:
        known, valid: [K].
        elevation, distance: [m] [K].
        normal: [K, 3].
        features: [K, F].
    """

    known: np.ndarray
    valid: np.ndarray
    elevation: np.ndarray
    distance: np.ndarray
    normal: np.ndarray
    features: np.ndarray


def make_map_cells(count: int, channels: int) -> MapCells:
    """Room for what the layers say of some cells."""
    none = (nothing_known(name, (0,), channels) for name in MapCells._fields)
    return MapCells(*(np.empty((count, *each.shape[1:]), each.dtype) for each in none))


def flatten(voxel_map: VoxelMap, settings: FlattenSettings | None = None) -> TerrainLayers:
    """The layers of a map; `Flattener` makes them repeatedly without new memory."""
    return Flattener(voxel_map, settings or FlattenSettings()).layers()


def neighbour_offsets(radius: float) -> Int[np.ndarray, "K 2"]:
    """Rows and columns to the cells whose centres lie within a radius, nearest first.

    Of equally near ones the one with the smaller y comes first, then the one with the smaller x.

    Args:
        radius: [cells].
    """
    most = int(radius + 1e-6)
    dy, dx = (offset.ravel() for offset in np.mgrid[-most : most + 1, -most : most + 1])
    squared = dy * dy + dx * dx
    near = squared <= radius * radius + 1e-6
    order = np.lexsort((dx[near], dy[near], squared[near]))
    return np.column_stack((dy[near], dx[near]))[order].astype(np.int64)


class Flattener:
    """Makes layers of one voxel map, reading only columns that changed since the last time.

    It keeps its buffers: on 600 x 600 cells 29 MB, and 1.4 MB for each feature.
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
        # What a cell says follows from the nearest ground, whose plane follows from ground that is no branch.
        self._margin = int(np.abs(self._offsets).max()) + self._plane_cells + self._overhang_cells

    def layers(self, out: TerrainLayers | None = None) -> TerrainLayers:
        """The map's layers.

        Args:
            out: layers of this map that are no longer needed: written over and returned. Whoever changed them by hand
                must not give them back.
        """
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
        """What the layers say of some cells, in a fraction of the time that all of them take."""
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
        """Level of the floor that heights in the buffers count from."""
        return round(self._map.middle / self._map.settings.size)

    @property
    def _floor(self) -> float:
        return self._reference * self._map.settings.size

    def _find_whole_ground(self) -> None:
        """Ground and planes of all columns, unless the buffers have those of the map."""
        if self._since < self._map.changes or not self._map.changes:
            threads, step = self._map.settings.threads, np.float32(self._map.settings.size)
            self._find_ground(self._whole, threads)
            spread_blocks(threads, threads, fit_planes, threads, self._plane_cells, step, self._buffers)
            self._since = self._map.changes

    def _find_ground(self, spans: Int[np.ndarray, "n 2"], threads: int) -> None:
        """Ground, obstacles and feature heights of the columns in spans; of those near their ends some are wrong."""
        voxel_map, settings, buffers, surface = self._map, self.settings, self._buffers, self._surface
        size, n = voxel_map.settings.size, voxel_map.cells
        step, reach, low = np.float32(size), np.float32(settings.vehicle_height), voxel_map.low
        limit, overhang = np.float32(settings.feature_height), self._overhang_cells
        spread_blocks(threads, n, see_columns, low, spans, step, reach, voxel_map.voxels, surface)
        spread_blocks(threads, n, read_columns, low, spans, self._reference, step, overhang, surface, buffers)
        spread_blocks(threads, n, drop_overhangs, spans, overhang, reach, limit, buffers)
