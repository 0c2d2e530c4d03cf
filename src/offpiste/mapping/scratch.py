"""What the loops from voxels to layers hand to each other.

Rows and columns are those of the layers, from the map's lowest cell. Offsets are in cells, heights in metres over the
floor of a reference level, so that float32 is fine wherever the map is.
"""

from typing import NamedTuple

import numpy as np

from offpiste.mapping.planes import SUMS


class Layers(NamedTuple):
    """Arrays of `layers.TerrainLayers`."""

    elevation: np.ndarray
    normal: np.ndarray
    slope: np.ndarray
    roughness: np.ndarray
    obstacle_height: np.ndarray
    features: np.ndarray
    distance: np.ndarray
    known: np.ndarray
    observed: np.ndarray
    valid: np.ndarray


class Surface(NamedTuple):
    """What each column shows from above; kept from one flattening to the next, wrapped around as the voxels are.

    Attributes:
        level: of the lowest voxel, counted from the world's zero [n, n].
        x, y, z: where it was hit, from its centre, z from its floor; NaN in an empty column [voxels] [n, n].
        obstacle: height of the highest thing in reach over that [m] [n, n].
        feature_height: of the lowest voxel with features over it; infinite if there is none [m] [n, n].
        features: of that voxel, and before them the distance from which they were seen [n, n, 1 + F].
    """

    level: np.ndarray
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    obstacle: np.ndarray
    feature_height: np.ndarray
    features: np.ndarray


def make_surface(cells: int, channels: int) -> Surface:
    """Of an empty map of [cells, cells]."""
    shape = (cells, cells)
    names = ("x", "y", "z", "obstacle", "feature_height")
    return Surface(
        level=np.zeros(shape, np.int32),
        **{name: np.full(shape, np.nan, np.float32) for name in names},
        features=np.full((*shape, 1 + channels), np.nan, np.float32),
    )


class Scratch(NamedTuple):
    """What is handed from loop to loop.

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
        sums, moments: room for the sums of `planes.py` [blocks, 2 plane_cells + 2, SUMS, n] and
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


def make_scratch(cells: int, blocks: int, plane_cells: int) -> Scratch:
    """Room for maps of [cells, cells], worked on in blocks of rows."""
    whole = {"which", "which_feature"}
    grids = [name for name in Scratch._fields if name not in ("sums", "moments", "line")]
    return Scratch(
        **{name: np.zeros((cells, cells), np.int32 if name in whole else np.float32) for name in grids},
        sums=np.zeros((blocks, 2 * plane_cells + 2, SUMS, cells), np.float32),
        moments=np.zeros((blocks, SUMS, cells + 2 * plane_cells), np.float32),
        line=np.zeros((blocks, 2, cells), np.float32),
    )
