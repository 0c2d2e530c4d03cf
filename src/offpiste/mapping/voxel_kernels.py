"""Loops that put observations into voxels; the same in plain NumPy is in tests/mapping.

A column keeps the `LEVELS` levels from its lowest occupied voxel upwards, whatever its height: what lies higher above
the ground matters to no vehicle. Which of them are occupied is a word of bits whose lowest is always set.

Columns say when they last changed, so that flattening looks into these alone. A voxel with up to 8 channels is one
cache line.
"""

import inspect
from functools import cache
from types import FunctionType
from typing import Final, NamedTuple

import numpy as np

from offpiste.mapping.fusion import FUSION_RULES
from offpiste.native.compilation import MAPPING, Function

BASE, OCCUPIED, FEATURED, LOWEST = range(4)
"""Fields of a column's head: level of its lowest voxel, counted from the world's zero; bits of the levels from there up
that are occupied; those that have features; slot of the lowest. In an empty column only `OCCUPIED` is valid."""

LEVELS: Final = 31
"""Levels of a column, as many as a word without its sign has bits; 6.2 m of voxels of 0.2 m."""

X, Y, Z, DISTANCE, FEATURE_DISTANCE, HITS, FEATURE_HITS, PASSED, FEATURES = range(9)
"""Fields of a voxel: x, y from its centre and z from its floor [voxels]; distance from the sensor, and that of the
features, infinite where there are none [m]; number of observations, and of those with features; times that rays passed
through it since it was last hit (`free_space.py`); the features."""

EVER, FREED, LOST = range(3)
"""Counts of a part: slots ever used, slots on the stack of those given back, observations that found no slot."""

PARTS: Final = 2
"""The rows are dealt out to parts in stripes, and so are the slots: each part can be filled by a thread of its own."""

STRIPE: Final = 3
"""log2 of the rows in a stripe."""

_ALL_BITS: Final = (1 << LEVELS) - 1


class Voxels(NamedTuple):
    """Columns, and a pool of slots with what was seen; arrays only, so that loops can take it.

    Rows and columns wrap around: the cell with integer coordinates (i, j) of the world is [j mod n, i mod n].

    Attributes:
        heads: int32 [n, n, 4].
        changed: number of the change of the map that last touched what the column shows, as it is flattened:
            int32 [n, n].
        slots: of each level of a column, if it is occupied: int32 [n, n, 32].
        seen: float32 [capacity, FEATURES + F, or more].
        freed: int32 [PARTS, capacity / PARTS].
        counts: int64 [PARTS, 3].
    """

    heads: np.ndarray
    changed: np.ndarray
    slots: np.ndarray
    seen: np.ndarray
    freed: np.ndarray
    counts: np.ndarray


@MAPPING.inlined
def take(voxels, part):  # type: ignore[no-untyped-def]
    """Take a free slot of a part; -1 if there is none."""
    counts, size = voxels.counts[part], voxels.freed.shape[1]
    if counts[FREED] > 0:
        counts[FREED] -= 1
        return np.int64(voxels.freed[part, counts[FREED]])
    if counts[EVER] == size:
        counts[LOST] += 1
        return np.int64(-1)
    counts[EVER] += 1
    return np.int64(part * size + counts[EVER] - 1)


@MAPPING.inlined
def release(voxels, part, slot):  # type: ignore[no-untyped-def]
    """Give a slot back."""
    counts = voxels.counts[part]
    voxels.freed[part, counts[FREED]] = slot
    counts[FREED] += 1


@MAPPING.inlined
def lower(voxels, part, head, slots, by):  # type: ignore[no-untyped-def]
    """Make room for a new lowest voxel `by` levels below; what leaves the column at its top is forgotten."""
    occupied = np.int64(head[OCCUPIED])
    for level in range(LEVELS - 1, -1, -1):
        if (occupied >> level) & 1:
            if level + by < LEVELS:
                slots[level + by] = slots[level]
            else:
                release(voxels, part, slots[level])
    shift = min(by, LEVELS)
    head[OCCUPIED] = (occupied << shift) & _ALL_BITS
    head[FEATURED] = (np.int64(head[FEATURED]) << shift) & _ALL_BITS
    head[BASE] -= by


@MAPPING.inlined
def slot_of(voxels, part, row, across, level):  # type: ignore[no-untyped-def]
    """The slot of a voxel, made if need be, and the bit of its level; -1 where none can be had."""
    head, slots = voxels.heads[row, across], voxels.slots[row, across]
    occupied = np.int64(head[OCCUPIED])
    up = level - head[BASE] if occupied != 0 else np.int64(0)
    if up >= LEVELS:
        return np.int64(-1), np.int64(0)
    if up >= 0 and (occupied >> up) & 1:
        return np.int64(slots[up]), np.int64(1) << up
    new = take(voxels, part)
    if new < 0:
        return new, np.int64(0)
    if occupied == 0:
        head[BASE], head[FEATURED] = level, 0
    elif up < 0:
        lower(voxels, part, head, slots, -up)
        up = np.int64(0)
    if up == 0:
        head[LOWEST] = new
    slots[up] = new
    head[OCCUPIED] |= np.int64(1) << up
    seen = voxels.seen[new]
    seen[DISTANCE], seen[FEATURE_DISTANCE], seen[HITS], seen[FEATURE_HITS] = np.inf, np.inf, 0, 0
    seen[PASSED] = 0
    return new, np.int64(1) << up


def share_of_new(distance: float, held_distance: float, count: float) -> float:
    """Stands for the fusion rule (`fusion.FusionRule`) that `point_inserter` compiles the loop with."""
    raise NotImplementedError


@MAPPING.inlined
def fuse_place(seen, x, y, z, distance, share):  # type: ignore[no-untyped-def]
    """Fuse the place of a hit with the held one; returns whether it moved."""
    if share == 1:
        seen[X], seen[Y], seen[Z], seen[DISTANCE] = x, y, z, distance
    elif share != 0:
        seen[X] += (x - seen[X]) * share
        seen[Y] += (y - seen[Y]) * share
        seen[Z] += (z - seen[Z]) * share
        seen[DISTANCE] += (distance - seen[DISTANCE]) * share
    return share != 0


@MAPPING.inlined
def fuse_features(seen, features, distance, share):  # type: ignore[no-untyped-def]
    """Fuse the features of a hit with the held ones; returns whether they changed."""
    if share == 1:
        seen[FEATURE_DISTANCE] = distance
        for k in range(len(features)):
            seen[FEATURES + k] = features[k]
    elif share != 0:
        seen[FEATURE_DISTANCE] += (distance - seen[FEATURE_DISTANCE]) * share
        for k in range(len(features)):
            seen[FEATURES + k] += (features[k] - seen[FEATURES + k]) * share
    return share != 0


@MAPPING.inlined
def finite(features):  # type: ignore[no-untyped-def]
    """Whether all features are finite."""
    total = np.float32(0)
    for k in range(len(features)):
        total += features[k] - features[k]  # 0, or not a number
    return total == 0


@cache
def point_inserter(rule: str) -> Function:
    """`insert_points` for a fusion rule, by its name: compiled with the rule's function in it.

    Raises:
        MapError: there is no such rule.
    """
    share = inspect.unwrap(FUSION_RULES[rule])
    loop = inspect.unwrap(insert_points)
    own = FunctionType(loop.__code__, {**loop.__globals__, "share_of_new": MAPPING.inlined(share)}, loop.__name__)
    return MAPPING.entry(own, salt=inspect.getsource(share))


def insert_points(  # type: ignore[no-untyped-def]
    first, last, points, features, has_feature, distance, low, middle, reach, scale, number, voxels
):
    """Put points into the parts `first` to `last` of the map.

    Args:
        points: [N, 3] in the world (float64) [m].
        features: [N, F].
        has_feature: which points have them [N].
        distance: from the sensor [N] [m].
        low: integer coordinates x, y of the map's lowest cell [2].
        middle, reach: points with |z - middle| > reach are left out [m].
        scale: voxels a metre.
        number: of this change of the map.
    """
    n, one = voxels.heads.shape[0], np.float32(1)
    start_x, start_y = low[0] % n, low[1] % n
    for i in range(len(points)):
        y = points[i, 1] * scale
        floor_y = np.floor(y)
        cell_y = floor_y - low[1]
        # Written so that what is not a number is left out too.
        if not (0 <= cell_y < n):
            continue
        row = start_y + np.int64(cell_y)
        row = row - n if row >= n else row
        part = (row >> STRIPE) % PARTS
        if not (first <= part < last):
            continue
        x = points[i, 0] * scale
        floor_x = np.floor(x)
        cell_x = floor_x - low[0]
        if not (0 <= cell_x < n) or not (abs(points[i, 2] - middle) <= reach) or not (0 <= distance[i] < np.inf):
            continue
        across = start_x + np.int64(cell_x)
        across = across - n if across >= n else across
        z = points[i, 2] * scale
        level = np.floor(z)
        slot, bit = slot_of(voxels, part, row, across, np.int64(level))
        if slot < 0:
            continue
        seen = voxels.seen[slot]
        x, y, z = x - floor_x - 0.5, y - floor_y - 0.5, z - level
        share = one
        seen[HITS] += one
        seen[PASSED] = 0
        if seen[HITS] > 1:
            share = np.float32(share_of_new(distance[i], seen[DISTANCE], seen[HITS]))
        changed = fuse_place(seen, np.float32(x), np.float32(y), np.float32(z), distance[i], share)
        if has_feature[i] and finite(features[i]):
            share = one
            seen[FEATURE_HITS] += one
            if seen[FEATURE_HITS] > 1:
                share = np.float32(share_of_new(distance[i], seen[FEATURE_DISTANCE], seen[FEATURE_HITS]))
            changed |= fuse_features(seen, features[i], distance[i], share)
            voxels.heads[row, across, FEATURED] |= bit
        if changed:
            voxels.changed[row, across] = number


@MAPPING.inlined
def forget_column(voxels, part, row, across, number):  # type: ignore[no-untyped-def]
    """Empty a column."""
    occupied, level = np.int64(voxels.heads[row, across, OCCUPIED]), 0
    while occupied != 0:
        if occupied & 1:
            release(voxels, part, voxels.slots[row, across, level])
        occupied >>= 1
        level += 1
    voxels.heads[row, across, OCCUPIED] = 0
    voxels.changed[row, across] = number


@MAPPING.entry
def forget_left_behind(old, new, number, voxels):  # type: ignore[no-untyped-def]
    """Empty the columns that the map leaves when its lowest cell moves from `old` to `new` (integer x, y [2]).

    Args:
        number: of this change of the map.
    """
    n = voxels.heads.shape[0]
    left, right = max(old[0], new[0]), min(old[0], new[0]) + n
    for j in range(old[1], old[1] + n):
        row = j % n
        part = (row >> STRIPE) % PARTS
        gone = not (new[1] <= j < new[1] + n) or left >= right
        for i in range(old[0], old[0] + n if gone else left):
            forget_column(voxels, part, row, i % n, number)
        if not gone:
            for i in range(right, old[0] + n):
                forget_column(voxels, part, row, i % n, number)
