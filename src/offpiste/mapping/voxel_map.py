"""A rolling voxel map around the vehicle that keeps, in each voxel, the observation taken from the closest distance.

"To fuse multiple measurements, we retain the closest observation, allowing for instant updates and temporal stability
when moving away from a location" (paper, "Mapping of Visual Features").
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.core.errors import MapError
from offpiste.core.registry import Registry
from offpiste.native.library import Type, compiled
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


COMPILED_RULES: Final = 3
"""Number of rules in the compiled library, the first in `FUSION_RULES`; others are evaluated on arrays, slower."""


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

_HIGHEST: Final = 1e9  # bound of levels, so that int32 suffices


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


VOXEL_TYPES: Final[tuple[Type, ...]] = ("i4", "i4", "i4", "f4", "i4", "i8", int, int, int)
"""Types of what `for_library` returns."""


def for_library(voxels: Voxels) -> tuple[Any, ...]:
    """Return the arrays, the number of cells, the width of a voxel and the number of slots of a part."""
    return (*voxels, len(voxels.heads), voxels.seen.shape[1], voxels.freed.shape[1])


def find_slots(
    voxels: Voxels, row: Int[np.ndarray, " N"], column: Int[np.ndarray, " N"], level: Int[np.ndarray, " N"]
) -> Int[np.ndarray, " N"]:
    """Return the slots of voxels, -1 where there is none."""
    head = voxels.heads[row, column].astype(np.int64)
    up = level - head[:, BASE]
    inside = np.clip(up, 0, LEVELS - 1)
    held = (up == inside) & (head[:, OCCUPIED] >> inside & 1 == 1)
    return np.where(held, voxels.slots[row, column, inside], -1)


def voxels_in(
    voxels: Voxels, rows: Int[np.ndarray, " R"], columns: Int[np.ndarray, " C"]
) -> tuple[Int[np.ndarray, " N"], ...]:
    """Return row, column, level over the lowest voxel, and slot of all voxels where rows and columns cross."""
    occupied = voxels.heads[rows[:, None], columns, OCCUPIED]
    j, i = np.nonzero(occupied)
    column, level = np.nonzero(occupied[j, i, None] >> np.arange(LEVELS, dtype=np.int32) & 1)
    row, across = rows[j[column]], columns[i[column]]
    return row, across, level, voxels.slots[row, across, level]


def release(voxels: Voxels, slots: Int[np.ndarray, " N"]) -> None:
    """Return slots to their parts."""
    size = voxels.freed.shape[1]
    for part in np.unique(slots // size).tolist():
        own, start = slots[slots // size == part], voxels.counts[part, FREED]
        voxels.freed[part, start : start + len(own)] = own
        voxels.counts[part, FREED] += len(own)


def _create(voxels: Voxels, row: int, column: int, level: int) -> None:
    """Create a voxel if there is none; an observation without room is counted as lost."""
    head, slots = voxels.heads[row, column], voxels.slots[row, column]
    part, size, occupied = (row >> STRIPE) % PARTS, voxels.freed.shape[1], int(head[OCCUPIED])
    up, counts = level - int(head[BASE]) if occupied else 0, voxels.counts[part]
    if up >= LEVELS or (up >= 0 and occupied >> up & 1):
        return
    if counts[FREED] > 0:
        counts[FREED] -= 1
        slot = voxels.freed[part, counts[FREED]]
    elif counts[EVER] < size:
        slot = part * size + counts[EVER]
        counts[EVER] += 1
    else:
        counts[LOST] += 1
        return
    if up < 0:  # shift the column for a new lowest voxel, and release voxels above the top level
        held = np.flatnonzero(occupied >> np.arange(LEVELS) & 1)
        kept = held[held - up < LEVELS]
        release(voxels, slots[held[len(kept) :]])
        slots[kept - up] = slots[kept]
        for field in (OCCUPIED, FEATURED):
            head[field] = int(head[field]) << min(-up, LEVELS) & _ALL_BITS
        head[BASE], up = level, 0
    if not occupied:
        head[BASE], head[FEATURED] = level, 0
    if up == 0:
        head[LOWEST] = slot
    slots[up] = slot
    head[OCCUPIED] |= 1 << up
    voxels.seen[slot, :FEATURES] = 0
    voxels.seen[slot, [DISTANCE, FEATURE_DISTANCE]] = np.inf


def _fuse(
    seen: Float[np.ndarray, "S W"],
    slots: Int[np.ndarray, " N"],
    values: Float[np.ndarray, "N C"],
    fields: Sequence[int],
    count: int,
    rule: FusionRule,
) -> Bool[np.ndarray, " N"]:
    """Fuse observations into fields of their voxels, the first of which is the distance; return which had an effect."""
    effect, order = np.zeros(len(slots), bool), np.argsort(slots, kind="stable")
    starts = np.flatnonzero(np.diff(slots[order], prepend=-1))
    rank = np.arange(len(slots)) - np.repeat(starts, np.diff(starts, append=len(slots)))
    for rows in np.split(order[np.argsort(rank, kind="stable")], np.cumsum(np.bincount(rank))[:-1]):
        at, new = slots[rows], values[rows]  # the next observation of each voxel
        held = seen[at[:, None], fields]
        seen[at, count] += 1
        share, again = np.ones(len(at), np.float32), seen[at, count] > 1
        share[again] = rule(new[again, 0], held[again, 0], seen[at[again], count])
        with np.errstate(invalid="ignore"):
            fused = np.where(share[:, None] == 1, new, held + (new - held) * share[:, None])
        seen[at[:, None], fields] = np.where(share[:, None] == 0, held, fused)
        effect[rows] = share != 0
    return effect


@compiled(int, int, int, "f8", "f4", "b1", "f4", int, int, "i8", float, float, float, int, *VOXEL_TYPES)
def insert_points(
    first: int,
    last: int,
    rule: int,
    points: Float[np.ndarray, "N 3"],
    features: Float[np.ndarray, "N F"] | None,
    has_feature: Bool[np.ndarray, " N"],
    distance: Float[np.ndarray, " N"],
    count: int,
    channels: int,
    low: Int[np.ndarray, " 2"],
    middle: float,
    reach: float,
    scale: float,
    number: int,
    *arrays: Any,
) -> None:
    """Insert points into the parts `first` to `last` of the map.

    Args:
        rule: index in `FUSION_RULES`, less than `COMPILED_RULES` in the library.
        points: in the world frame [m].
        count, channels: N and F.
        low: integer coordinates x, y of the map's lowest cell.
        middle, reach: points with |z - middle| > reach are ignored [m].
        scale: voxels per metre.
        number: number of this map change.
        arrays: of `for_library`.
    """
    share = FUSION_RULES[tuple(FUSION_RULES)[rule]]
    voxels, n = Voxels(*arrays[:6]), arrays[6]
    with np.errstate(invalid="ignore", over="ignore"):
        scaled = points * scale
        cell = np.floor(scaled)
        good = ((cell[:, :2] >= low) & (cell[:, :2] < low + n)).all(axis=1) & (np.abs(cell[:, 2]) < _HIGHEST)
        good &= (np.abs(points[:, 2] - middle) <= reach) & (distance >= 0) & (distance < np.inf)
    good[good] &= np.isin((cell[good, 1].astype(np.int64) % n >> STRIPE) % PARTS, range(first, last))
    cell = cell[good].astype(np.int64)
    (column, row), level = cell[:, :2].T % n, cell[:, 2]
    new = find_slots(voxels, row, column, level) < 0
    for place in np.column_stack((row, column, level))[new].tolist():
        _create(voxels, *place)
    slots = find_slots(voxels, row, column, level)
    held = slots >= 0
    good[good], slots, row, column, level = held, slots[held], row[held], column[held], level[held]
    offset = scaled[good] - np.floor(scaled[good]) - [0.5, 0.5, 0.0]
    values = np.column_stack((distance[good], offset)).astype(np.float32)
    voxels.seen[slots, PASSED] = 0
    changed = _fuse(voxels.seen, slots, values, (DISTANCE, X, Y, Z), HITS, share)
    if features is not None:
        seen = has_feature[good] & np.isfinite(features[good]).all(axis=1)
        values = np.column_stack((distance[good], features[good]))[seen]
        fields = (FEATURE_DISTANCE, *range(FEATURES, FEATURES + features.shape[1]))
        changed[seen] |= _fuse(voxels.seen, slots[seen], values, fields, FEATURE_HITS, share)
        bit = 1 << level - voxels.heads[row, column, BASE]
        np.bitwise_or.at(voxels.heads[..., FEATURED], (row[seen], column[seen]), bit[seen].astype(np.int32))
    voxels.changed[row[changed], column[changed]] = number


def forget_left_behind(old: Int[np.ndarray, " 2"], new: Int[np.ndarray, " 2"], number: int, voxels: Voxels) -> None:
    """Empty the columns outside the map after its lowest cell moves from `old` to `new` (integer x, y)."""
    index = np.arange(len(voxels.heads))
    cell = old + (index[:, None] - old) % len(index)
    stays = (cell >= new) & (cell < new + len(index))
    for rows, columns in ((index[~stays[:, 1]], index), (index[stays[:, 1]], index[~stays[:, 0]])):
        row, column, _, slots = voxels_in(voxels, rows, columns)
        release(voxels, slots)
        voxels.heads[row, column, OCCUPIED], voxels.changed[row, column] = 0, number


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
            raise MapError(
                f"invalid map size: {self.half_cells} cells to each side", where="map settings", how="set 1 to 10000"
            )

    @property
    def half_cells(self) -> int:
        """Number of cells from the vehicle to the map's border."""
        return round(self.reach / self.size)


def check_positive(settings: object, *names: str) -> None:
    """Raise `MapError` if one of these settings is not a positive number."""
    for name in names:
        value = getattr(settings, name)
        if not 0 < value < float("inf"):
            raise MapError(f"invalid {name} = {value}", where="map settings", how="give a positive number")


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

    @property
    def cells(self) -> int:
        """Number of cells along each side of the map."""
        return 2 * self.settings.half_cells

    @property
    def origin(self) -> Float[np.ndarray, " 2"]:
        """Centre of the cell with the lowest x and y, in the world frame [m]."""
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
        if features is not None and features.shape[1] != self.channels:
            raise ValueError(f"the map has {self.channels} channels, these points {features.shape[1]}")
        self.changes += 1
        points, distance = np.ascontiguousarray(points_world, np.float64), np.ascontiguousarray(distance, np.float32)
        has_feature = np.ascontiguousarray(has_feature, np.bool_)
        features = None if features is None else np.ascontiguousarray(features, np.float32)
        n, others = len(points), (has_feature, distance) if features is None else (has_feature, distance, features)
        if points.shape != (n, 3) or any(len(other) != n for other in others):
            raise ValueError("points [N, 3], features, masks and distances are not of one number N")
        rule = tuple(FUSION_RULES).index(self.settings.rule)
        insert = insert_points if rule < COMPILED_RULES else insert_points.plain  # type: ignore[attr-defined]
        cloud = rule, points, features, has_feature, distance, n, self.channels
        frame = self.low, self.middle, self.settings.height_reach, self._scale, self.changes
        spread_blocks(self.settings.threads, PARTS, insert, *cloud, *frame, *for_library(self.voxels))


def _aligned(shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """Return zeros aligned to cache lines; pages are allocated on the first write."""
    size = int(np.prod(shape)) * 4
    raw = np.zeros(size + 64, np.uint8)
    first = -raw.ctypes.data % 64
    return raw[first : first + size].view(dtype).reshape(shape)
