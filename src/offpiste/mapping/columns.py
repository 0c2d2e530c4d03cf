"""Loops over the columns of voxels: the ground, what stands on it and what it looks like. `reference.py` says the same.

Each works on rows `first` to `last` of the layers.
"""

import numpy as np

from offpiste.mapping.compiled import inlined, map_loop, row_loop
from offpiste.mapping.voxel_kernels import BASE, FEATURED, LEVELS, LOWEST, OCCUPIED, X, Y, Z


@inlined
def height_of(voxels, slot, level, reference, size):  # type: ignore[no-untyped-def]
    """How high a voxel was hit."""
    return (np.float32(level - reference) + voxels.seen[slot, Z]) * size


@inlined
def obstacle_above(voxels, head, slots, ground, reference, size, reach):  # type: ignore[no-untyped-def]
    """Height over the ground of the highest voxel that was hit at most `reach` above it."""
    occupied = head[OCCUPIED]
    levels = int(reach / size) + 1
    for up in range(levels if levels < LEVELS else LEVELS - 1, 0, -1):
        if (occupied >> up) & 1:
            above = height_of(voxels, slots[up], head[BASE] + up, reference, size) - ground
            if above <= reach:
                return above
    return np.float32(0)


@inlined
def lowest_feature(voxels, head, slots, reference, size):  # type: ignore[no-untyped-def]
    """Slot and height of the lowest voxel with features; slot -1 if there is none."""
    featured, up = head[FEATURED], 0
    if featured == 0:
        return np.int32(-1), np.float32(0)
    while not (featured >> up) & 1:
        up += 1
    return slots[up], height_of(voxels, slots[up], head[BASE] + up, reference, size)


@row_loop
def put_lowest_beside(height, radius, lowest):  # type: ignore[no-untyped-def]
    """The lowest ground within `radius` cells along a row; infinite if none."""
    n = len(height)
    for i in range(n):
        lowest[i] = height[i] if height[i] == height[i] else np.float32(np.inf)
    for k in range(1, radius + 1):
        for i in range(n - k):  # what is not a number is not less
            lowest[i] = height[i + k] if height[i + k] < lowest[i] else lowest[i]
        for i in range(k, n):
            lowest[i] = height[i - k] if height[i - k] < lowest[i] else lowest[i]


@map_loop
def read_columns(first, last, low, reference, size, reach, radius, voxels, scratch):  # type: ignore[no-untyped-def]
    """Ground, obstacle and feature of each column, and the lowest ground within `radius` cells along the row."""
    n = voxels.heads.shape[0]
    for j in range(first, last):
        row = (low[1] + j) % n
        across = low[0] % n
        for i in range(n):
            head, slots, hit = voxels.heads[row, across], voxels.slots[row, across], voxels.ground[row, across]
            across = across + 1 if across + 1 < n else 0
            scratch.feature_slot[j, i] = -1
            if head[OCCUPIED] == 0:
                scratch.height[j, i] = np.nan
                continue
            ground = (np.float32(head[BASE] - reference) + hit[Z]) * size
            scratch.x[j, i], scratch.y[j, i], scratch.height[j, i] = hit[X], hit[Y], ground
            scratch.obstacle[j, i] = np.float32(0)
            if head[OCCUPIED] != 1:
                scratch.obstacle[j, i] = obstacle_above(voxels, head, slots, ground, reference, size, reach)
            if head[FEATURED] & 1:
                scratch.feature_slot[j, i], scratch.feature_height[j, i] = head[LOWEST], ground
            else:
                slot, height = lowest_feature(voxels, head, slots, reference, size)
                scratch.feature_slot[j, i], scratch.feature_height[j, i] = slot, height
        put_lowest_beside(scratch.height[j], radius, scratch.lowest[j])


@map_loop
def drop_overhangs(first, last, radius, reach, feature_height, scratch):  # type: ignore[no-untyped-def]
    """Columns whose lowest voxel is a branch have no ground; features too far above their ground do not count."""
    n = scratch.height.shape[0]
    for j in range(first, last):
        lowest, height, slot = scratch.centre[j], scratch.height[j], scratch.feature_slot[j]
        lowest[:] = np.float32(np.inf)
        for jj in range(max(j - radius, 0), min(j + radius + 1, n)):
            other = scratch.lowest[jj]
            for i in range(n):
                lowest[i] = other[i] if other[i] < lowest[i] else lowest[i]
        for i in range(n):
            overhang = height[i] > lowest[i] + reach
            high = not (scratch.feature_height[j, i] - height[i] <= feature_height)
            slot[i] = -1 if overhang or high else slot[i]
            height[i] = np.float32(np.nan) if overhang else height[i]
