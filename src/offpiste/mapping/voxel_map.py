"""A rolling voxel map around the vehicle that keeps, in each voxel, the observation taken from the closest distance.

"To fuse multiple measurements, we retain the closest observation, allowing for instant updates and temporal stability
when moving away from a location" (paper, "Mapping of Visual Features"). A fusion rule is a function of plain scalars
that Numba compiles into the loop over points; it must work on NumPy arrays too. A NumPy reference of the loops is in
tests/mapping.
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from types import FunctionType
from typing import Any, Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.core.errors import MapError
from offpiste.core.registry import Registry
from offpiste.native.compilation import MAPPING, Function
from offpiste.native.threads import spread_blocks

Scalar = Any  # number or array

FusionRule = Callable[[Scalar, Scalar, Scalar], Scalar]
"""Weight of a new observation in the voxel, from its distance [m], the distance of the held one [m] and the number of
observations including the new one. 0 keeps the held observation, 1 replaces it, values between give a weighted mean.
The rule is evaluated separately for the hit position and for its features; it is not used for the first observation."""

FUSION_RULES: Final[Registry[FusionRule]] = Registry("fusion rule", error=MapError)


@FUSION_RULES.register("closest")
def closest(distance: Scalar, held_distance: Scalar, count: Scalar) -> Scalar:
    """Keep the closest observation, the first one of a tie (paper, "Mapping of Visual Features")."""
    return distance < held_distance


@FUSION_RULES.register("latest")
def latest(distance: Scalar, held_distance: Scalar, count: Scalar) -> Scalar:
    """Keep the latest observation."""
    return 1.0


@FUSION_RULES.register("average")
def average(distance: Scalar, held_distance: Scalar, count: Scalar) -> Scalar:
    """Average all observations."""
    return 1.0 / count


BASE, OCCUPIED, FEATURED, LOWEST = range(4)
"""Fields of a column's head: level of its lowest voxel, counted from the world's zero; bit masks of the levels from
there upwards that are occupied and that have features; slot of the lowest voxel. In an empty column only `OCCUPIED` is
valid; elsewhere its lowest bit is set."""

LEVELS: Final = 31  # levels of a column, the bits of a signed word without its sign; 6.2 m with voxels of 0.2 m

X, Y, Z, DISTANCE, FEATURE_DISTANCE, HITS, FEATURE_HITS, PASSED, FEATURES = range(9)
"""Fields of a voxel: x, y from its centre and z from its floor [voxels]; distance of the sensor from the hit and the
features, infinite without any [m]; number of observations and of observations with features; number of scans whose
rays passed through it since the last hit (`free_space.py`); the features. A voxel with up to 8 channels is one cache
line."""

EVER, FREED, LOST = range(3)
"""Counters of a part: slots ever used, released slots on the stack, observations lost for want of a slot."""

PARTS: Final = 2
"""Parts that rows (in stripes) and slots are divided into, so that each part can be filled by its own thread."""

STRIPE: Final = 3  # log2 of the number of rows in a stripe

_ALL_BITS: Final = (1 << LEVELS) - 1


class Voxels(NamedTuple):
    """Columns and a pool of voxel slots, as arrays that compiled loops accept.

    Rows and columns wrap around: the cell with integer world coordinates (i, j) is [j mod n, i mod n].
    """

    heads: np.ndarray  # int32 [n, n, 4]
    changed: np.ndarray  # number of the map change that last altered the flattened column: int32 [n, n]
    slots: np.ndarray  # slot of each occupied level of a column: int32 [n, n, 32]
    seen: np.ndarray  # fields of each slot: float32 [capacity, FEATURES + F, or more]
    freed: np.ndarray  # stacks of released slots: int32 [PARTS, capacity / PARTS]
    counts: np.ndarray  # int64 [PARTS, 3]


@MAPPING.inlined
def take(voxels, part):  # type: ignore[no-untyped-def]
    """Take a free slot of a part, or return -1 if it is full."""
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
    """Return a slot to its part."""
    counts = voxels.counts[part]
    voxels.freed[part, counts[FREED]] = slot
    counts[FREED] += 1


@MAPPING.inlined
def lower(voxels, part, head, slots, by):  # type: ignore[no-untyped-def]
    """Shift a column for a new lowest voxel `by` levels below, and release voxels above the top level."""
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
    """Find or create the slot of a voxel; return it, or -1 without room, and the bit of its level."""
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
    """Placeholder of the fusion rule that `point_inserter` compiles into the loop."""
    raise NotImplementedError


@MAPPING.inlined
def fuse_place(seen, x, y, z, distance, share):  # type: ignore[no-untyped-def]
    """Fuse the position of a hit with the held one; return whether it moved."""
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
    """Fuse the features of a hit with the held ones; return whether they changed."""
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
    """Return whether all features are finite."""
    total = np.float32(0)
    for k in range(len(features)):
        total += features[k] - features[k]  # 0, or not a number
    return total == 0


@cache
def point_inserter(rule: str) -> Function:
    """Compile `insert_points` with the named fusion rule inlined."""
    share = inspect.unwrap(FUSION_RULES[rule])
    loop = inspect.unwrap(insert_points)
    own = FunctionType(loop.__code__, {**loop.__globals__, "share_of_new": MAPPING.inlined(share)}, loop.__name__)
    return MAPPING.entry(own, salt=inspect.getsource(share))


def insert_points(  # type: ignore[no-untyped-def]
    first, last, points, features, has_feature, distance, low, middle, reach, scale, number, voxels
):
    """Insert points into the parts `first` to `last` of the map.

    Args:
        points: in the world frame, float64 [N, 3] [m].
        low: integer coordinates x, y of the map's lowest cell [2].
        middle, reach: points with |z - middle| > reach are ignored [m].
        scale: voxels per metre.
        number: number of this map change.
    """
    n, one = voxels.heads.shape[0], np.float32(1)
    start_x, start_y = low[0] % n, low[1] % n
    for i in range(len(points)):
        y = points[i, 1] * scale
        floor_y = np.floor(y)
        cell_y = floor_y - low[1]
        # False for NaN as well.
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
    """Empty the columns outside the map after its lowest cell moves from `old` to `new` (integer x, y [2])."""
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


@dataclass(frozen=True)
class VoxelSettings:
    """Size and memory of the voxel map."""

    size: float = 0.2  # edge length of a voxel (paper, "Mapping of Visual Features": 0.2 m) [m]
    reach: float = 60.0  # half the side of the map, in x and in y [m]
    # points further above or below the vehicle are not mapped; 30 m is a slope of 27 degrees at 60 m [m]
    height_reach: float = 30.0
    rule: str = "closest"  # name in `FUSION_RULES`; the paper keeps the closest observation
    # maximum number of voxels; their memory is allocated when they are first used (`VoxelMap`)
    capacity: int = 1_500_000
    threads: int = 2  # threads of insertion and flattening; the map does not depend on it

    def __post_init__(self) -> None:
        check_positive(self, "size", "reach", "height_reach", "capacity", "threads")
        if self.rule not in FUSION_RULES:
            rules = ", ".join(FUSION_RULES)
            raise MapError(f"fusion rule '{self.rule}' is unknown", where="map settings", how=f"use one of: {rules}")
        if not 1 <= self.half_cells <= 10_000:
            raise MapError(f"{self.half_cells} cells to each side", where="map settings", how="set 1 to 10000")

    @property
    def half_cells(self) -> int:
        """Number of cells from the vehicle to the map's border."""
        return round(self.reach / self.size)


def check_positive(settings: object, *names: str) -> None:
    """Raise `MapError` if one of these settings is not a positive number."""
    for name in names:
        value = getattr(settings, name)
        if not 0 < value < float("inf"):
            raise MapError(f"{name} is {value}", where="map settings", how="give a positive number")


class VoxelMap:
    """Voxels on a world-aligned grid; the map is the part of the grid around the vehicle.

    A voxel stores a hit position and features separately: a point without features never replaces features, however
    close it is.

    A column keeps 31 levels from its lowest occupied voxel upwards, at any height; points more than 6.2 m above that
    voxel are dropped. Memory with voxels of 0.2 m and +-60 m: 53 MB for the columns, and 36 bytes per voxel ever in use
    without features, 68 with up to 8, 196 with up to 40, i.e. at most 350 MB for 1.5 million voxels of 40 features.
    """

    def __init__(self, channels: int, settings: VoxelSettings | None = None) -> None:
        self.settings = settings or VoxelSettings()
        n, slots = 2 * self.settings.half_cells, -(-self.settings.capacity // PARTS)
        width = FEATURES if channels == 0 else -(-(FEATURES + channels) // 16) * 16
        # Integer coordinates x, y of the lowest cell; cell i covers [i, i + 1) voxel sizes.
        self.low: Int[np.ndarray, " 2"] = np.full(2, -self.settings.half_cells, np.int64)
        self.middle, self.changes = 0.0, 0  # height of the vehicle [m]; number of insertions and moves so far
        self.channels = channels  # number of features per voxel
        self.voxels = Voxels(
            heads=_aligned((n, n, 4), np.int32),
            changed=np.zeros((n, n), np.int32),
            slots=_aligned((n, n, LEVELS + 1), np.int32),
            seen=_aligned((PARTS * slots, width), np.float32),
            freed=np.empty((PARTS, slots), np.int32),
            counts=np.zeros((PARTS, 3), np.int64),
        )
        self._scale = 1.0 / self.settings.size
        self._insert_points = point_inserter(self.settings.rule)

    @property
    def cells(self) -> int:
        """Number of cells along each side of the map."""
        return 2 * self.settings.half_cells

    @property
    def origin(self) -> Float[np.ndarray, " 2"]:
        """World position x, y of the lowest cell's centre [m]."""
        return (self.low + 0.5) * self.settings.size

    @property
    def occupied(self) -> int:
        """Number of occupied voxels."""
        counts = self.voxels.counts
        return int((counts[:, EVER] - counts[:, FREED]).sum())

    @property
    def lost(self) -> int:
        """Number of observations lost because `capacity` was exhausted."""
        return int(self.voxels.counts[:, LOST].sum())

    def recentre(self, xy: Float[np.ndarray, " 2"], z: float) -> None:
        """Move the map by whole cells to centre it on the vehicle at xy, z [m]; columns outside it are dropped.

        Raises `ValueError` for a position that is not finite, or beyond 1e8 cells from the world's origin.
        """
        cell = np.floor(np.asarray(xy, np.float64) * self._scale + 0.5)
        if not (np.abs([*cell, z * self._scale]) < 1e8).all():
            raise ValueError(f"a map cannot be centred at {xy}, {z} m")
        new = cell.astype(np.int64) - self.settings.half_cells
        moved = (new != self.low).any()
        if moved or round(z / self.settings.size) != round(self.middle / self.settings.size):
            self.changes += 1  # heights of layers are relative to the vehicle's level
        if moved:
            forget_left_behind(self.low, new, self.changes, self.voxels)
        self.low, self.middle = new, float(z)

    def insert(
        self,
        points_world: Float[np.ndarray, "N 3"],
        features: Float[np.ndarray, "N F"] | None,
        has_feature: Bool[np.ndarray, " N"],
        distance: Float[np.ndarray, " N"],
    ) -> None:
        """Insert observations in the given order.

        Points outside the map and non-finite points or distances are ignored, as are non-finite features. Raises
        `ValueError` for another number of channels than the map's.

        Args:
            points_world: float64 far from the world's origin [m].
            has_feature: mask of the points that have features.
            distance: distance from the sensor to each point [m].
        """
        if features is None:
            features, has_feature = np.zeros((1, self.channels), np.float32), np.zeros(len(points_world), bool)
        elif features.shape[1] != self.channels:
            raise ValueError(f"the map has {self.channels} channels, these points {features.shape[1]}")
        self.changes += 1
        points, distance = np.ascontiguousarray(points_world, np.float64), np.ascontiguousarray(distance, np.float32)
        features, has_feature = np.ascontiguousarray(features, np.float32), np.ascontiguousarray(has_feature)
        frame = self.low, self.middle, self.settings.height_reach, self._scale, self.changes, self.voxels
        seen = points, features, has_feature, distance
        spread_blocks(self.settings.threads, PARTS, self._insert_points, *seen, *frame)


def _aligned(shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """Return zeros aligned to cache lines; pages are allocated on the first write."""
    size = int(np.prod(shape)) * 4
    raw = np.zeros(size + 64, np.uint8)
    first = -raw.ctypes.data % 64
    return raw[first : first + size].view(dtype).reshape(shape)
