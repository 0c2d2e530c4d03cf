"""Ground of voxel columns: their lowest hits without branches, obstacles and features, in grids around the vehicle.

Only changed columns are evaluated; their results are kept and wrap around like the voxels. Rows and columns of grids
count from the map's lowest cell. Work is limited to a span of each row: all columns for the layers, the neighbourhood
of the cells where only some are read.
"""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy.lib.stride_tricks import sliding_window_view

from offpiste.mapping.voxel_map import BASE, FEATURE_DISTANCE, FEATURED, FEATURES, LEVELS, LOWEST, OCCUPIED, X, Y, Z
from offpiste.native.library import compiled

BLOCK: Final = 32
"""Number of columns that share a change number."""

HEIGHT, OBSTACLE, FEATURE_HEIGHT, BESIDE, RISE_X, RISE_Y, CENTRE, RESIDUAL, ROUGHNESS = range(2, 11)
"""Grids after those of the hits' x and y from the cells' centres [cells]: height of the ground over a reference level,
NaN without any, of the highest thing within reach over it, and of the features over the reference level, NaN without
any that count [m]; lowest ground of the cells beside, along the row [m]; rise of the plane [m/m], ground at the cell's
centre [m], squared residual of the hit [m^2] and roughness [m], NaN without a plane."""


class Surface(NamedTuple):
    """Ground of each column, kept between calls and indexed like the voxels.

    Attributes:
        level: level of the lowest voxel from the world's zero [n, n].
        hits: x, y of its hit from its centre and z from its floor, NaN in an empty column [voxels]; height of the
            highest thing within reach over it [m]; height of the lowest voxel with features over it, NaN without any
            [m] [5, n, n].
        features: sensor distance and features of that voxel [n, n, 1 + F].
        since: number of the last evaluated map change by block of columns [n, n / BLOCK].
    """

    level: np.ndarray
    hits: np.ndarray
    features: np.ndarray
    since: np.ndarray


def make_surface(cells: int, channels: int) -> Surface:
    """Return the surface of an empty map of [cells, cells]."""
    hits, features = np.full((5, cells, cells), np.nan, np.float32), np.full((cells, cells, 1 + channels), np.nan)
    since = np.zeros((cells, -(-cells // BLOCK)), np.int32)
    return Surface(np.zeros((cells, cells), np.int32), hits, features.astype(np.float32), since)


def make_grids(cells: int, border: int) -> Float[np.ndarray, "11 rows columns"]:
    """Return grids of [cells, cells], with `border` unknown cells around them, whose rows end with whole vectors."""
    shape = (ROUGHNESS + 1, cells + 2 * border, -(-cells // 16) * 16 + 2 * border)
    return np.full(shape, np.nan, np.float32)


def find_spans(
    rows: Int[np.ndarray, " K"], columns: Int[np.ndarray, " K"], margin: int, cells: int
) -> Int[np.ndarray, "n 2"]:
    """Return for each row the first and the last + 1 column within `margin` of some cells, 0 and 0 without any."""
    begin, end = np.full(cells + 2 * margin, cells), np.zeros(cells + 2 * margin, int)
    np.minimum.at(begin, rows + margin, columns)
    np.maximum.at(end, rows + margin, columns + 1)
    begin = sliding_window_view(begin, 2 * margin + 1).min(axis=1)
    end = sliding_window_view(end, 2 * margin + 1).max(axis=1)
    spans = np.column_stack((np.maximum(begin - margin, 0), np.minimum(end + margin, cells)))
    return np.where((begin < end)[:, None], spans, 0)


@compiled(int, int, int, int, "i8", float, float, *4 * ("i4",), "f4", "f4", "i4", *3 * (int,), "f4")
def see_columns(  # type: ignore[no-untyped-def]
    first, last, start_x, start_y, spans, size, reach, heads, changed, slots, level, hits, features, since, cells,
    channels, width, seen,
):  # fmt: skip
    """Update ground, obstacles and features of the columns in the spans of rows `first` to `last` - 1.

    Args:
        start_x, start_y: column and row of the map's lowest cell in the voxels.
        spans: first and last + 1 column of each row [n, 2].
        size, reach: size of a voxel, and height above the ground up to which things are obstacles [m].
        heads, changed, slots, seen: `Voxels`; `seen` has `width` numbers a slot.
        level, hits, features, since: `Surface`.
        cells, channels: number of cells along a side, and of features.
    """
    fields, up = [FEATURE_DISTANCE, *range(FEATURES, FEATURES + channels)], np.arange(LEVELS)
    for j in range(first, last):
        row, across = (start_y + j) % cells, (start_x + np.arange(*spans[j])) % cells
        blocks = np.unique(across // BLOCK)
        new = np.isin(np.arange(cells) // BLOCK, blocks) & (changed[row] > since[row].repeat(BLOCK)[:cells])
        since[row, blocks] = np.maximum.reduceat(changed[row], np.arange(0, cells, BLOCK))[blocks]
        x, y, z, obstacle, feature_height = hits[:, row]
        z[new], feature_height[new] = np.nan, np.nan
        some = np.flatnonzero(new & (heads[row, :, OCCUPIED] != 0))
        head, slot = heads[row, some], slots[row, some, :LEVELS]
        hit = seen[head[:, LOWEST]]
        level[row, some], x[some], y[some], z[some] = head[:, BASE], hit[:, X], hit[:, Y], hit[:, Z]
        above = (up.astype(np.float32) + seen[slot, Z] - hit[:, Z, None]) * size
        occupied, featured = ((head[:, [mask]] >> up) & 1 > 0 for mask in (OCCUPIED, FEATURED))
        obstacle[some] = np.where(occupied & (up > 0) & (above <= reach), above, 0).max(axis=1)
        known, lowest = np.flatnonzero(featured.any(axis=1)), featured.argmax(axis=1)
        feature_height[some[known]] = above[known, lowest[known]]
        features[row, some[known]] = seen[slot[known, lowest[known]]][:, fields]


@compiled(int, int, int, int, "i8", int, float, int, "i4", "f4", "f4", int, int)
def read_columns(  # type: ignore[no-untyped-def]
    first, last, start_x, start_y, spans, reference, size, radius, level, hits, grids, cells, border
):
    """Copy spans of columns in the order of the grids and find the lowest ground within `radius` cells along rows.

    Args:
        reference: level that heights are relative to.
        level, hits: `Surface`; the other arguments are those of `see_columns`.
        grids: `make_grids`, with `border` cells around them; feature heights are over the ground until
            `drop_overhangs`.
    """
    for j in range(first, last):
        row, columns = (start_y + j) % cells, np.arange(*spans[j])
        to, across = border + columns, (start_x + columns) % cells
        grids[:5, border + j, to] = hits[:, row, across]
        heights = (level[row, across] - reference).astype(np.float32) + hits[Z, row, across]
        grids[HEIGHT, border + j, to] = heights * size
        near = grids[HEIGHT, border + j, border - radius : border + cells + radius]
        beside = np.fmin.reduce(sliding_window_view(near, 2 * radius + 1), axis=1, initial=np.inf)
        grids[BESIDE, border + j, border : border + cells] = beside


@compiled(int, int, "i8", int, float, float, "f4", int, int)
def drop_overhangs(first, last, spans, radius, reach, limit, grids, cells, border):  # type: ignore[no-untyped-def]
    """Remove the ground of columns whose lowest voxel is a branch, and features too far above the ground.

    Feature heights become relative to the reference level; values outside the spans are undefined.

    Args:
        radius: of the square in which ground more than `reach` [m] above the lowest is a branch [cells].
        limit: maximum height of features above the ground [m].
    """
    inner = slice(border, border + cells)
    for j in range(border + first, border + last):
        lowest = np.fmin.reduce(grids[BESIDE, j - radius : j + radius + 1, inner], axis=0, initial=np.inf)
        height, feature = grids[HEIGHT, j, inner], grids[FEATURE_HEIGHT, j, inner]
        is_ground = height <= lowest + reach
        feature[:] = np.where(is_ground & (feature <= limit), height + feature, np.nan)
        height[~is_ground] = np.nan
