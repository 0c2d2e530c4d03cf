"""From voxels to 2D layers: the lowest valid voxel of each column, gaps filled from the nearest cell, planes.

"The visual terrain features in the 3D voxel data are compressed to a 2D map output by taking the lowest valid data
point within each vertical stack of voxels [...] missing data is filled in with data from the nearest neighboring cell
in a 0.4 m radius" (paper, "Mapping of Visual Features"). Ground under a bush is the lowest hit below it; a branch over
a column without any other hit is told from ground by its neighbours (`FlattenSettings.overhang_radius`).
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Int

from offpiste.mapping.columns import drop_overhangs, read_columns, see_columns
from offpiste.mapping.fill import fill_gaps, smooth_residuals, write_layers
from offpiste.mapping.layers import TerrainLayers, empty_layers
from offpiste.mapping.planes import fit_planes
from offpiste.mapping.scratch import Layers, make_scratch, make_surface
from offpiste.mapping.settings import FlattenSettings
from offpiste.mapping.voxels import VoxelMap
from offpiste.threads import spread


def flatten(voxel_map: VoxelMap, settings: FlattenSettings | None = None) -> TerrainLayers:
    """The layers of a map, once; `Flattener` does it again and again without new memory."""
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
    """Makes layers of one voxel map, looking only into columns that changed since it last did.

    Keeps the memory that this takes: on 600 x 600 cells 29 MB, and 1.4 MB for each feature.
    """

    def __init__(self, voxel_map: VoxelMap, settings: FlattenSettings) -> None:
        self.settings = settings
        self._map = voxel_map
        size, n, threads = voxel_map.settings.size, voxel_map.cells, voxel_map.settings.threads
        self._plane_cells = max(1, round(settings.plane_radius / size))
        self._overhang_cells = round(settings.overhang_radius / size)
        self._offsets = neighbour_offsets(settings.fill_radius / size)
        self._scratch = make_scratch(n, threads, self._plane_cells)
        self._surface, self._since = make_surface(n, voxel_map.channels), 0

    def layers(self, out: TerrainLayers | None = None) -> TerrainLayers:
        """The map's layers.

        Args:
            out: layers of this map that are no longer needed: written over and returned. Whoever changed them by hand
                must not give them back.
        """
        voxel_map, settings = self._map, self.settings
        size, n, threads = voxel_map.settings.size, voxel_map.cells, voxel_map.settings.threads
        out = out or empty_layers(n, voxel_map.channels)
        scratch, surface, low = self._scratch, self._surface, voxel_map.low
        reference = round(voxel_map.middle / size)
        step, reach = np.float32(size), np.float32(settings.vehicle_height)
        arrays = Layers(*(getattr(out, name) for name in Layers._fields))
        limit, floor = np.float32(settings.feature_height), reference * size

        spread(threads, n, see_columns, self._since, step, reach, voxel_map.voxels, surface)
        self._since = voxel_map.changes
        spread(threads, n, read_columns, low, reference, step, self._overhang_cells, surface, scratch)
        spread(threads, n, drop_overhangs, self._overhang_cells, reach, limit, scratch)
        spread(threads, threads, fit_planes, threads, self._plane_cells, step, scratch)
        spread(threads, threads, smooth_residuals, threads, self._plane_cells, scratch)
        spread(threads, threads, fill_gaps, threads, self._offsets, limit, scratch)
        spread(threads, threads, write_layers, threads, floor, low, self._offsets, surface, scratch, arrays)
        return replace(out, origin=voxel_map.origin, resolution=size)
