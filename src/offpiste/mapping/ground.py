"""Loops over voxel columns: ground, obstacles and features.

Only changed columns are evaluated; their results are kept and wrap around like the voxels. Rows `first` to `last` count
from the map's lowest cell. Loops work on a span of each row: all columns for the layers, the neighbourhood of the cells
where only some are read. A NumPy reference is in tests/mapping.
"""

from typing import Final

import numpy as np

from offpiste.mapping.normals import put
from offpiste.mapping.voxel_map import BASE, FEATURE_DISTANCE, FEATURED, FEATURES, LEVELS, LOWEST, OCCUPIED, X, Y, Z
from offpiste.native.compilation import MAPPING

BLOCK: Final = 32
"""Number of columns that share a change number."""


@MAPPING.inlined
def over_ground(voxels, slot, up, hit, size):  # type: ignore[no-untyped-def]
    """Return the height of the hit `up` levels above the lowest voxel over the lowest hit of the column."""
    return (np.float32(up) + voxels.seen[slot, Z] - hit[Z]) * size


@MAPPING.inlined
def obstacle_above(voxels, occupied, slots, hit, size, reach):  # type: ignore[no-untyped-def]
    """Return the height over the ground of the highest hit at most `reach` above it."""
    levels = int(reach / size) + 1
    for up in range(levels if levels < LEVELS else LEVELS - 1, 0, -1):
        if (occupied >> up) & 1:
            above = over_ground(voxels, slots[up], up, hit, size)
            if above <= reach:
                return above
    return np.float32(0)


@MAPPING.inlined
def keep_features(seen, kept):  # type: ignore[no-untyped-def]
    """Store the features of a voxel and their sensor distance."""
    kept[0] = seen[FEATURE_DISTANCE]
    for k in range(1, len(kept)):
        kept[k] = seen[FEATURES + k - 1]


@MAPPING.inlined  # passing the arrays to a call takes as long as the work itself
def see_column(row, across, size, reach, voxels, surface):  # type: ignore[no-untyped-def]
    """Store the ground, the obstacle and the features of a column."""
    head, slots = voxels.heads[row, across], voxels.slots[row, across]
    surface.feature_height[row, across] = np.float32(np.nan)
    if head[OCCUPIED] == 0:
        surface.z[row, across] = np.float32(np.nan)
        return
    hit, featured = voxels.seen[head[LOWEST]], head[FEATURED]
    surface.level[row, across] = head[BASE]
    surface.x[row, across], surface.y[row, across], surface.z[row, across] = hit[X], hit[Y], hit[Z]
    surface.obstacle[row, across] = np.float32(0)
    if head[OCCUPIED] != 1:
        surface.obstacle[row, across] = obstacle_above(voxels, head[OCCUPIED], slots, hit, size, reach)
    if featured & 1:
        surface.feature_height[row, across] = np.float32(0)
        keep_features(hit, surface.features[row, across])
    elif featured != 0:
        up = 1
        while not (featured >> up) & 1:
            up += 1
        surface.feature_height[row, across] = over_ground(voxels, slots[up], up, hit, size)
        keep_features(voxels.seen[slots[up]], surface.features[row, across])


@MAPPING.entry
def put_spans(rows, columns, margin, bare, spans):  # type: ignore[no-untyped-def]
    """Write for each row the first and the last + 1 column within `margin` of some cells, 0 and 0 without any.

    `bare` [n, 2] is a buffer for the spans without the margin.
    """
    n = len(spans)
    bare[:, 0], bare[:, 1] = n, 0
    for q in range(len(rows)):
        bare[rows[q], 0] = min(bare[rows[q], 0], columns[q])
        bare[rows[q], 1] = max(bare[rows[q], 1], columns[q] + 1)
    for j in range(n):
        begin, end = n, 0
        for jj in range(max(j - margin, 0), min(j + margin + 1, n)):
            begin, end = min(begin, bare[jj, 0]), max(end, bare[jj, 1])
        spans[j, 0], spans[j, 1] = 0, 0
        if begin < end:
            spans[j, 0], spans[j, 1] = max(begin - margin, 0), min(end + margin, n)


@MAPPING.inlined
def see_block(row, number, size, reach, voxels, surface):  # type: ignore[no-untyped-def]
    """Update the columns of a block that changed since the last update."""
    start, since = number * BLOCK, surface.since[row, number]
    changed, newest = voxels.changed[row, start : start + BLOCK], since
    for i in range(len(changed)):
        newest = max(newest, changed[i])
    if newest > since:
        for i in range(len(changed)):
            if changed[i] > since:
                see_column(row, start + i, size, reach, voxels, surface)
        surface.since[row, number] = newest


@MAPPING.entry
def see_columns(first, last, low, spans, size, reach, voxels, surface):  # type: ignore[no-untyped-def]
    """Update ground, obstacles and features of the columns in the spans of rows `first` to `last`."""
    n = voxels.changed.shape[0]
    for j in range(first, last):
        row, count = (low[1] + j) % n, spans[j, 1] - spans[j, 0]
        if count > 0:
            begin = (low[0] + spans[j, 0]) % n
            for number in range(begin // BLOCK, (min(begin + count, n) - 1) // BLOCK + 1):
                see_block(row, number, size, reach, voxels, surface)
            if begin + count > n:
                for number in range((begin + count - n - 1) // BLOCK + 1):
                    see_block(row, number, size, reach, voxels, surface)


@MAPPING.loop
def put_lower(a, out):  # type: ignore[no-untyped-def]
    """Write the minimum of a and out."""
    for i in range(len(out)):
        out[i] = a[i] if a[i] < out[i] else out[i]


@MAPPING.loop
def put_lowest_beside(height, radius, lowest):  # type: ignore[no-untyped-def]
    """Write the lowest ground within `radius` cells along a row, infinite without any."""
    n = len(height)
    for i in range(n):
        lowest[i] = height[i] if height[i] == height[i] else np.float32(np.inf)
    for k in range(1, radius + 1):  # NaN is not less
        put_lower(height[k:], lowest[: n - k])
        put_lower(height[: n - k], lowest[k:])


@MAPPING.loop
def put_heights(level, z, reference, size, out):  # type: ignore[no-untyped-def]
    """Write heights over the floor of the reference level."""
    for i in range(len(out)):
        out[i] = (np.float32(level[i] - reference) + z[i]) * size


@MAPPING.entry
def read_columns(first, last, low, spans, reference, size, radius, surface, buffers):  # type: ignore[no-untyped-def]
    """Copy spans of columns in the order of the layers and find the lowest ground within `radius` cells along rows."""
    n = buffers.height.shape[0]
    start = low[0] % n
    for j in range(first, last):
        row, begin, end = (low[1] + j) % n, spans[j, 0], spans[j, 1]
        middle = min(max(begin, n - start), end)
        for to, shift in ((slice(begin, middle), start), (slice(middle, end), start - n)):
            at = slice(to.start + shift, to.stop + shift)
            put_heights(surface.level[row, at], surface.z[row, at], np.int32(reference), size, buffers.height[j, to])
            put(surface.x[row, at], buffers.x[j, to])
            put(surface.y[row, at], buffers.y[j, to])
            put(surface.obstacle[row, at], buffers.obstacle[j, to])
            put(surface.feature_height[row, at], buffers.feature_height[j, to])
        put_lowest_beside(buffers.height[j, begin:end], radius, buffers.lowest[j, begin:end])


@MAPPING.entry
def drop_overhangs(first, last, spans, radius, reach, feature_height, buffers):  # type: ignore[no-untyped-def]
    """Remove the ground of columns whose lowest voxel is a branch, and features too far above the ground.

    Feature heights become relative to the reference level.
    """
    n = buffers.height.shape[0]
    nothing = np.float32(np.nan)
    for j in range(first, last):
        span = slice(spans[j, 0], spans[j, 1])
        lowest, height, feature = buffers.centre[j, span], buffers.height[j, span], buffers.feature_height[j, span]
        lowest[:] = np.float32(np.inf)
        for jj in range(max(j - radius, 0), min(j + radius + 1, n)):
            put_lower(buffers.lowest[jj, span], lowest)
        for i in range(len(height)):
            good = (feature[i] <= feature_height) & (height[i] <= lowest[i] + reach)
            feature[i] = height[i] + feature[i] if good else nothing
        for i in range(len(height)):
            height[i] = height[i] if height[i] <= lowest[i] + reach else nothing
