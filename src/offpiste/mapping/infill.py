"""Filling of gaps from the nearest cell, and writing of the layers, for blocks of rows or for selected cells.

The nearest cell is found for a whole row at once: neighbours are visited from the furthest to the nearest, and nearer
ones overwrite. Rows are divided into `blocks`; a call takes blocks `first` to `last`. Planes around selected cells are
summed from gathered windows in the order of `normals.py`, so that both paths agree to the bit.
"""

from collections import namedtuple
from typing import Final

import numpy as np

from offpiste.mapping.normals import SUMS, add_columns, put, put_moments, solve, sum_rows
from offpiste.native.compilation import MAPPING

CHUNK: Final = 256
"""Number of cells whose windows are gathered at a time, so that their sums stay in the processor's cache."""


@MAPPING.loop
def nearest_grounds(j, offsets, height, which, ground):  # type: ignore[no-untyped-def]
    """Write the number of the first offset that leads to ground, and the height of that ground, for each cell."""
    n = len(which)
    which[:] = np.int32(-1)
    ground[:] = np.float32(np.nan)
    for k in range(len(offsets) - 1, -1, -1):
        jj, right = j + offsets[k, 0], offsets[k, 1]
        if 0 <= jj < n:
            to, at = slice(max(0, -right), min(n, n - right)), slice(max(0, right), min(n, n + right))
            result, height_here, height_there, number = which[to], ground[to], height[jj, at], np.int32(k)
            for i in range(len(result)):
                result[i] = number if height_there[i] == height_there[i] else result[i]
            for i in range(len(result)):
                height_here[i] = height_there[i] if height_there[i] == height_there[i] else height_here[i]


@MAPPING.loop
def nearest_features(j, offsets, limit, feature_height, ground, which):  # type: ignore[no-untyped-def]
    """Write the number of the first offset to features within `limit` of the ground, for each cell of a row."""
    n = len(ground)
    which[:] = np.int32(-1)
    for k in range(len(offsets) - 1, -1, -1):
        jj, right = j + offsets[k, 0], offsets[k, 1]
        if 0 <= jj < n:
            to, at = slice(max(0, -right), min(n, n - right)), slice(max(0, right), min(n, n + right))
            result, here, height, number = which[to], ground[to], feature_height[jj, at], np.int32(k)
            for i in range(len(result)):
                off = height[i] - here[i]
                result[i] = number if (off <= limit) & (off >= -limit) else result[i]


@MAPPING.entry
def fill_gaps(first, last, blocks, offsets, limit, buffers):  # type: ignore[no-untyped-def]
    """Find the source cells of each cell's ground and features.

    Args:
        offsets: rows and columns to neighbours, nearest first, the cell itself at [0] [K, 2].
        limit: maximum height of features above or below the ground [m].
    """
    n = buffers.height.shape[0]
    for block in range(first, last):
        ground = buffers.line[block, 0]
        for j in range(n * block // blocks, n * (block + 1) // blocks):
            nearest_grounds(j, offsets, buffers.height, buffers.which[j], ground)
            nearest_features(j, offsets, limit, buffers.feature_height, ground, buffers.which_feature[j])


@MAPPING.loop
def put_up(rise_x, rise_y, out):  # type: ignore[no-untyped-def]
    """Write the upward components of the unit normals."""
    for i in range(len(out)):
        out[i] = np.float32(1) / np.sqrt(np.float32(1) + (rise_x[i] * rise_x[i] + rise_y[i] * rise_y[i]))


@MAPPING.loop
def write_own_ground(j, floor, up, buffers, layers):  # type: ignore[no-untyped-def]
    """Write the ground of a row, NaN for cells without their own."""
    rise_x, rise_y, height = buffers.rise_x[j], buffers.rise_y[j], buffers.height[j]
    elevation, centre, slope, normal = layers.elevation[j], buffers.centre[j], layers.slope[j], layers.normal[j]
    obstacle, obstacle_here = layers.obstacle_height[j], buffers.obstacle[j]
    roughness, roughness_here = layers.roughness[j], buffers.roughness[j]
    put_up(rise_x, rise_y, up)
    for i in range(len(up)):
        elevation[i] = floor + centre[i]
    for i in range(len(up)):
        normal[i, 0], normal[i, 1], normal[i, 2] = -rise_x[i] * up[i], -rise_y[i] * up[i], up[i]
    for i in range(len(up)):
        slope[i] = np.sqrt(rise_x[i] * rise_x[i] + rise_y[i] * rise_y[i])
    for i in range(len(up)):
        roughness[i] = roughness_here[i]
    for i in range(len(up)):
        obstacle[i] = obstacle_here[i] if height[i] == height[i] else np.float32(np.nan)


@MAPPING.loop
def write_filled_ground(j, floor, offsets, buffers, layers):  # type: ignore[no-untyped-def]
    """Write the ground of the filled cells of a row."""
    which = buffers.which[j]
    for i in range(len(which)):
        if which[i] > 0:
            jj, ii = j + offsets[which[i], 0], i + offsets[which[i], 1]
            rise_x, rise_y = buffers.rise_x[jj, ii], buffers.rise_y[jj, ii]
            squared = rise_x * rise_x + rise_y * rise_y
            up = np.float32(1) / np.sqrt(np.float32(1) + squared)
            layers.elevation[j, i] = floor + buffers.centre[jj, ii]
            layers.normal[j, i, 0], layers.normal[j, i, 1], layers.normal[j, i, 2] = -rise_x * up, -rise_y * up, up
            layers.slope[j, i] = np.sqrt(squared)
            layers.roughness[j, i] = buffers.roughness[jj, ii]
            layers.obstacle_height[j, i] = buffers.obstacle[jj, ii]


@MAPPING.loop
def write_flags(which, which_feature, observed, known, valid):  # type: ignore[no-untyped-def]
    """Write the masks of a row."""
    for i in range(len(which)):
        observed[i] = which[i] == 0
    for i in range(len(which)):
        known[i] = which[i] >= 0
    for i in range(len(which)):
        valid[i] = which_feature[i] >= 0


@MAPPING.loop
def write_features(j, low, offsets, surface, buffers, layers):  # type: ignore[no-untyped-def]
    """Write the features of a row; cells without features before and now are skipped."""
    n, channels = layers.valid.shape[0], layers.features.shape[2]
    which, valid = buffers.which_feature[j], layers.valid[j]
    start_x, start_y = low[0] % n, low[1] % n + j
    for i in range(n):
        k = which[i]
        if k >= 0:
            row, across = start_y + offsets[k, 0], start_x + i + offsets[k, 1]
            seen = surface.features[row - n if row >= n else row, across - n if across >= n else across]
            layers.distance[j, i] = seen[0]
            for q in range(channels):
                layers.features[j, i, q] = seen[1 + q]
        elif valid[i]:
            layers.distance[j, i] = np.float32(np.nan)
            for q in range(channels):
                layers.features[j, i, q] = np.float32(np.nan)


@MAPPING.entry
def write_layers(first, last, blocks, floor, low, offsets, surface, buffers, layers):  # type: ignore[no-untyped-def]
    """Write the layers.

    Args:
        floor: height of the reference level in the world [m].
        low: integer coordinates x, y of the lowest cell [2].
    """
    n = buffers.height.shape[0]
    for block in range(first, last):
        for j in range(n * block // blocks, n * (block + 1) // blocks):
            write_own_ground(j, floor, buffers.line[block, 0], buffers, layers)
            write_filled_ground(j, floor, offsets, buffers, layers)
            write_features(j, low, offsets, surface, buffers, layers)
            write_flags(
                buffers.which[j], buffers.which_feature[j], layers.observed[j], layers.known[j], layers.valid[j]
            )


Gathered = namedtuple("Gathered", "moments sums total hits")
"""Buffers for windows of cells: moments of the cells of a row and sums of each row [window, SUMS, CHUNK], sums of the
window [SUMS, CHUNK], and x, y, height of one cell and a line [4, CHUNK]."""


def make_gathered(radius: int) -> Gathered:
    """Return buffers for windows of +-radius."""
    shapes = ((2 * radius + 1, SUMS, CHUNK), (2 * radius + 1, SUMS, CHUNK), (SUMS, CHUNK), (4, CHUNK))
    return Gathered(*(np.zeros(shape, np.float32) for shape in shapes))


@MAPPING.loop
def gather(rows, columns, down, right, buffers, x, y, z):  # type: ignore[no-untyped-def]
    """Write the hits of the cells `down` rows and `right` columns from some cells; z is NaN outside the map."""
    n = buffers.height.shape[0]
    for q in range(len(rows)):
        j, i = rows[q] + down, columns[q] + right
        x[q], y[q], z[q] = np.float32(0), np.float32(0), np.float32(np.nan)
        if 0 <= j < n and 0 <= i < n:
            x[q], y[q], z[q] = buffers.x[j, i], buffers.y[j, i], buffers.height[j, i]


@MAPPING.entry
def fit_planes_at(radius, size, buffers, gathered, planes):  # type: ignore[no-untyped-def]
    """Fit planes around the cells at `planes.rows`, `planes.columns`; the arguments are those of `fit_planes`."""
    for first in range(0, len(planes.rows), CHUNK):
        mine = slice(first, min(first + CHUNK, len(planes.rows)))
        rows, columns = planes.rows[mine], planes.columns[mine]
        here = slice(0, len(rows))
        moments, sums, total = gathered.moments[:, :, here], gathered.sums[:, :, here], gathered.total[:, here]
        x, y, z, line = gathered.hits[0, here], gathered.hits[1, here], gathered.hits[2, here], gathered.hits[3, here]
        for down in range(-radius, radius + 1):
            for right in range(-radius, radius + 1):
                gather(rows, columns, down, right, buffers, x, y, z)
                put_moments(x, y, z, 0, moments[radius + right])
            row = sums[radius + down]
            for q in range(SUMS):
                put(moments[radius, q], row[q])
            for k in range(1, radius + 1):
                add_columns(moments[radius + k], moments[radius - k], np.float32(k), row)
        sum_rows(sums, radius, radius, total)
        height = planes.height[mine]
        gather(rows, columns, 0, 0, buffers, x, y, height)
        solve(total, x, y, height, size, line, planes.rise_x[mine], planes.rise_y[mine], planes.centre[mine])


@MAPPING.entry
def find_grounds(rows, columns, offsets, buffers, planes):  # type: ignore[no-untyped-def]
    """Write the source cells of the ground of some cells, the cells themselves without ground nearby."""
    n = buffers.height.shape[0]
    for q in range(len(rows)):
        planes.rows[q], planes.columns[q] = rows[q], columns[q]
        for k in range(len(offsets)):
            jj, ii = rows[q] + offsets[k, 0], columns[q] + offsets[k, 1]
            if 0 <= jj < n and 0 <= ii < n and buffers.height[jj, ii] == buffers.height[jj, ii]:
                planes.rows[q], planes.columns[q] = jj, ii
                break


@MAPPING.entry
def read_cells(rows, columns, floor, low, offsets, limit, surface, buffers, planes, out):  # type: ignore[no-untyped-def]
    """Write the values of `fill_gaps` and `write_layers` for some cells only."""
    n, channels = buffers.height.shape[0], out.features.shape[1]
    for q in range(len(rows)):
        j, i, found_feature = rows[q], columns[q], -1
        rise_x, rise_y, ground = planes.rise_x[q], planes.rise_y[q], planes.height[q]
        up = np.float32(1) / np.sqrt(np.float32(1) + (rise_x * rise_x + rise_y * rise_y))
        out.known[q] = ground == ground
        out.elevation[q] = floor + planes.centre[q] if ground == ground else np.float32(np.nan)
        out.normal[q, 0], out.normal[q, 1], out.normal[q, 2] = -rise_x * up, -rise_y * up, up
        if up != up:
            out.normal[q] = np.float32(np.nan)
        for k in range(len(offsets)):
            jj, ii = j + offsets[k, 0], i + offsets[k, 1]
            if 0 <= jj < n and 0 <= ii < n:
                off = buffers.feature_height[jj, ii] - ground
                if (off <= limit) & (off >= -limit):
                    found_feature = k
                    break
        out.valid[q] = found_feature >= 0
        out.distance[q] = np.float32(np.nan)
        for c in range(channels):
            out.features[q, c] = np.float32(np.nan)
        if found_feature >= 0:
            row = low[1] % n + j + offsets[found_feature, 0]
            across = low[0] % n + i + offsets[found_feature, 1]
            row, across = row - n if row >= n else row, across - n if across >= n else across
            out.distance[q] = surface.features[row, across, 0]
            for c in range(channels):
                out.features[q, c] = surface.features[row, across, 1 + c]
