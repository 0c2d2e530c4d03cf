"""Loops that fill gaps and write the layers, over blocks `first` to `last` of the `blocks` that the rows are cut into.

The nearest cell is found for a whole row at once: neighbours are gone through from the furthest to the nearest, each
writing over what those before it left.
"""

import numpy as np

from offpiste.mapping.compiled import map_loop, row_loop
from offpiste.mapping.voxel_kernels import FEATURE_DISTANCE, FEATURES


@row_loop
def add(out, a):  # type: ignore[no-untyped-def]
    """Add a."""
    for i in range(len(out)):
        out[i] += a[i]


@map_loop
def smooth_residuals(first, last, blocks, radius, scratch):  # type: ignore[no-untyped-def]
    """Roughness: root mean square of the residuals in the square around each cell that has a plane."""
    n = scratch.height.shape[0]
    for block in range(first, last):
        room = scratch.sums[block, 0]
        count, total, near_count, near_total = room[0], room[1], room[2], room[3]
        for j in range(n * block // blocks, n * (block + 1) // blocks):
            room[:] = np.float32(0)
            for jj in range(max(0, j - radius), min(n, j + radius + 1)):
                residual = scratch.residual[jj]
                for i in range(n):
                    count[i] += np.float32(1) if residual[i] == residual[i] else np.float32(0)
                for i in range(n):
                    total[i] += residual[i] if residual[i] == residual[i] else np.float32(0)
            for k in range(-radius, radius + 1):
                to, at = slice(max(0, -k), min(n, n - k)), slice(max(0, k), min(n, n + k))
                add(near_count[to], count[at])
                add(near_total[to], total[at])
            rise, roughness = scratch.rise_x[j], scratch.roughness[j]
            for i in range(n):
                value = np.sqrt(near_total[i] / near_count[i])
                roughness[i] = value if rise[i] == rise[i] else np.float32(np.nan)


@row_loop
def nearest_grounds(j, offsets, height, which, ground):  # type: ignore[no-untyped-def]
    """For each cell of a row, the number of the first offset that leads to ground, and how high that was hit."""
    n = len(which)
    which[:] = np.int32(-1)
    ground[:] = np.float32(np.nan)
    for k in range(len(offsets) - 1, -1, -1):
        jj, right = j + offsets[k, 0], offsets[k, 1]
        if 0 <= jj < n:
            to, at = slice(max(0, -right), min(n, n - right)), slice(max(0, right), min(n, n + right))
            found, height_here, height_there, number = which[to], ground[to], height[jj, at], np.int32(k)
            for i in range(len(found)):
                found[i] = number if height_there[i] == height_there[i] else found[i]
            for i in range(len(found)):
                height_here[i] = height_there[i] if height_there[i] == height_there[i] else height_here[i]


@row_loop
def nearest_features(j, offsets, limit, ground, scratch):  # type: ignore[no-untyped-def]
    """For each cell of a row, the nearest slot whose features were seen within `limit` of the ground here."""
    n = len(ground)
    scratch.filled_slot[j, :] = np.int32(-1)
    for k in range(len(offsets) - 1, -1, -1):
        jj, right = j + offsets[k, 0], offsets[k, 1]
        if 0 <= jj < n:
            to, at = slice(max(0, -right), min(n, n - right)), slice(max(0, right), min(n, n + right))
            found, here = scratch.filled_slot[j, to], ground[to]
            slot, height = scratch.feature_slot[jj, at], scratch.feature_height[jj, at]
            for i in range(len(found)):
                off = height[i] - here[i]
                good = (slot[i] >= 0) & (off <= limit) & (off >= -limit)
                found[i] = slot[i] if good else found[i]


@map_loop
def fill_gaps(first, last, blocks, offsets, limit, scratch):  # type: ignore[no-untyped-def]
    """Where each cell's ground and features come from.

    Args:
        offsets: rows and columns to neighbours, nearest first, the cell itself at [0] [K, 2].
        limit: how far from the ground features may have been seen [m].
    """
    n = scratch.height.shape[0]
    for block in range(first, last):
        ground = scratch.line[block, 0]
        for j in range(n * block // blocks, n * (block + 1) // blocks):
            nearest_grounds(j, offsets, scratch.height, scratch.which[j], ground)
            nearest_features(j, offsets, limit, ground, scratch)


@row_loop
def write_ground(j, floor, offsets, scratch, layers):  # type: ignore[no-untyped-def]
    """The ground of a row, its own or that of the cell which fills it; cells that had none stay as they are."""
    nothing = np.float32(np.nan)
    for i in range(scratch.height.shape[0]):
        k = scratch.which[j, i]
        if k >= 0:
            jj, ii = j + offsets[k, 0], i + offsets[k, 1]
            rise_x, rise_y = scratch.rise_x[jj, ii], scratch.rise_y[jj, ii]
            squared = rise_x * rise_x + rise_y * rise_y
            up = np.float32(1) / np.sqrt(np.float32(1) + squared)
            layers.elevation[j, i] = floor + scratch.centre[jj, ii]
            layers.normal[j, i, 0], layers.normal[j, i, 1], layers.normal[j, i, 2] = -rise_x * up, -rise_y * up, up
            layers.slope[j, i] = np.sqrt(squared)
            layers.roughness[j, i] = scratch.roughness[jj, ii]
            layers.obstacle_height[j, i] = scratch.obstacle[jj, ii]
        elif layers.known[j, i]:
            layers.elevation[j, i] = np.nan
            layers.normal[j, i, 0], layers.normal[j, i, 1], layers.normal[j, i, 2] = nothing, nothing, nothing
            layers.slope[j, i], layers.roughness[j, i], layers.obstacle_height[j, i] = nothing, nothing, nothing
        layers.observed[j, i], layers.known[j, i] = k == 0, k >= 0


@row_loop
def write_features(j, seen, scratch, layers):  # type: ignore[no-untyped-def]
    """The features of a row; cells that had none already stay as they are."""
    channels = layers.features.shape[2]
    for i in range(layers.features.shape[1]):
        slot = scratch.filled_slot[j, i]
        if slot >= 0:
            for k in range(channels):
                layers.features[j, i, k] = seen[slot, FEATURES + k]
            layers.distance[j, i] = seen[slot, FEATURE_DISTANCE]
        elif layers.valid[j, i]:
            for k in range(channels):
                layers.features[j, i, k] = np.float32(np.nan)
            layers.distance[j, i] = np.float32(np.nan)
        layers.valid[j, i] = slot >= 0


@map_loop
def write_layers(first, last, blocks, floor, offsets, voxels, scratch, layers):  # type: ignore[no-untyped-def]
    """Write the layers.

    Args:
        floor: height of the reference level in the world [m].
        offsets: as `fill_gaps` was given.
        layers: `scratch.Layers`.
    """
    n = scratch.height.shape[0]
    for block in range(first, last):
        for j in range(n * block // blocks, n * (block + 1) // blocks):
            write_ground(j, floor, offsets, scratch, layers)
            write_features(j, voxels.seen, scratch, layers)
