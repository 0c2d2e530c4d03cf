"""Removal of voxels that moving objects left behind, by the rays of later scans that pass through them.

A voxel is removed after the rays of several scans passed around it to returns behind it, without a hit in between. Rays
must be dense enough to hit a thin trunk, so only voxels near the vehicle with several rays around them are tested. The
lowest voxel of a column is ground and always stays.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from offpiste.core.errors import MapError
from offpiste.mapping.voxel_map import (
    BASE,
    FEATURED,
    OCCUPIED,
    PASSED,
    VOXEL_TYPES,
    VoxelMap,
    Voxels,
    X,
    Z,
    for_library,
    release,
    voxels_in,
)
from offpiste.native.library import compiled

STEEPEST, SLOPE, ROWS, COLUMNS = -1.0, 0.025, 64, 256
"""Range image: slope of the lowest row, slope per row [m/m], rows and columns (1.4 degrees at the horizon)."""


@dataclass(frozen=True)
class FreeSpaceSettings:
    """Conditions for removing a voxel."""

    reach: float = 20.0  # distance from the sensor up to which voxels are tested, in x and in y [m]
    every: int = 5  # each scan tests every n-th row of the map
    times: int = 5  # number of passed tests since the last hit that remove a voxel
    returns: int = 4  # minimum number of returns around the voxel in each test
    beyond: float = 0.5  # minimum distance of these returns behind the voxel [m]

    def __post_init__(self) -> None:
        if min(self.reach, self.beyond, self.every, self.times, self.returns) <= 0:
            raise MapError("free space: a setting is not positive", where="map settings", how="give positive numbers")


@dataclass(frozen=True)
class NearestReturns:
    """Range image of a scan over the 3 x 3 pixels around each direction."""

    near: Float[np.ndarray, "r c"]  # horizontal distance of the nearest return; infinite without any [m]
    many: Int[np.ndarray, "r c"]  # number of returns


def nearest_returns(
    points_world: Float[np.ndarray, "N 3"], sensor_world: Float[np.ndarray, " 3"], left_out: Bool[np.ndarray, " N"]
) -> NearestReturns:
    """Return the range image of a scan; points marked in `left_out` are ignored."""
    points, n = np.ascontiguousarray(points_world, np.float64), len(points_world)
    left_out, sensor = np.ascontiguousarray(left_out, np.bool_), np.ascontiguousarray(sensor_world, np.float64)
    if points.shape != (n, 3) or left_out.shape != (n,) or sensor.shape != (3,):
        raise ValueError(f"points, left_out and sensor have shapes {points.shape}, {left_out.shape} and {sensor.shape}")
    nearest, count = np.full((ROWS, COLUMNS), np.inf, np.float32), np.zeros((ROWS, COLUMNS), np.int32)
    put_returns(points, n, sensor, left_out, nearest, count)
    return NearestReturns(_around(nearest, np.minimum, np.inf), _around(count, np.add, 0.0))


def _around(values: Shaped[np.ndarray, "r c"], combine: np.ufunc, outside: float) -> Shaped[np.ndarray, "r c"]:
    """Combine the 3 x 3 pixels around each pixel; the first and the last column are neighbours."""
    wide = np.full((values.shape[0] + 2, values.shape[1]), outside, values.dtype)
    wide[1:-1] = values
    rows = combine(combine(wide[:-2], wide[1:-1]), wide[2:])
    return np.asarray(combine(combine(np.roll(rows, 1, axis=1), rows), np.roll(rows, -1, axis=1)))


def passed(
    returns: NearestReturns,
    points_world: Float[np.ndarray, "N 3"],
    sensor_world: Float[np.ndarray, " 3"],
    settings: FreeSpaceSettings,
) -> Bool[np.ndarray, " N"]:
    """Return whether the rays of a scan passed finite points."""
    row, column, r = _pixels(points_world, sensor_world)
    enough = (row >= 0) & (returns.many[row, column] >= settings.returns)
    return np.asarray(enough & (returns.near[row, column] > r + np.float32(settings.beyond)))


def _pixels(
    points: Float[np.ndarray, "N 3"], sensor: Float[np.ndarray, " 3"]
) -> tuple[Int[np.ndarray, " N"], Int[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """Return rows and columns, -1 outside the image, and horizontal distances of points."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        x, y, z = (points - sensor).astype(np.float32).T
        away, r = np.abs(x) + np.abs(y), np.sqrt(x * x + y * y)
        row = np.floor((z / r - np.float32(STEEPEST)) * np.float32(1 / SLOPE))
        share = y / away
        inside = (away > np.float32(0.01)) & (away < np.float32(1e4)) & (row >= 0) & (row < ROWS)
        around = np.where(inside, np.where(x >= 0, 1 + share, 3 - share), 0)
    column = np.minimum((around * np.float32(COLUMNS / 4)).astype(int), COLUMNS - 1)
    return np.where(inside, row, -1).astype(int), np.where(inside, column, -1), r


class FreeSpace:
    """Remover of voxels that rays pass through, for one voxel map."""

    def __init__(self, voxel_map: VoxelMap, settings: FreeSpaceSettings | None = None) -> None:
        self.settings = settings or FreeSpaceSettings()
        self._map, self._turn = voxel_map, 0

    def clear(
        self,
        points_world: Float[np.ndarray, "N 3"],
        sensor_world: Float[np.ndarray, " 3"],
        left_out: Bool[np.ndarray, " N"],
    ) -> int:
        """Remove voxels that the rays of this and earlier scans passed through; return their number.

        Args:
            points_world: a scan that is already in the map [m].
            left_out: mask of points to ignore, such as ghosts.
        """
        settings, size = self.settings, self._map.settings.size
        image = nearest_returns(points_world, sensor_world, left_out)
        sensor = np.ascontiguousarray(sensor_world, np.float64)
        self._turn = (self._turn + 1) % settings.every
        self._map.changes += 1
        where = self._turn, settings.every, self._map.low, float(round(settings.reach / size)), sensor, size
        rule = float(settings.beyond), settings.returns, settings.times, self._map.changes
        return int(clear_passed(*where, image.near, image.many, *rule, *for_library(self._map.voxels)))


@compiled("f8", int, "f8", "b1", "f4", "i4")
def put_returns(
    points: Float[np.ndarray, "N 3"],
    count: int,
    sensor: Float[np.ndarray, " 3"],
    left_out: Bool[np.ndarray, " N"],
    nearest: Float[np.ndarray, "r c"],
    many: Int[np.ndarray, "r c"],
) -> None:
    """Reduce the distance of each pixel's nearest return [m], and add to its number of returns."""
    row, column, r = _pixels(points, sensor)
    there = (row >= 0) & ~left_out
    np.minimum.at(nearest, (row[there], column[there]), r[there])
    np.add.at(many, (row[there], column[there]), 1)


@compiled(*(int, int, "i8", float, "f8", float, "f4", "i4", float, int, int, int), *VOXEL_TYPES, returns=int)
def clear_passed(
    first: int,
    stride: int,
    low: Int[np.ndarray, " 2"],
    reach: float,
    sensor: Float[np.ndarray, " 3"],
    size: float,
    near: Float[np.ndarray, "r c"],
    many: Int[np.ndarray, "r c"],
    beyond: float,
    returns: int,
    times: int,
    number: int,
    *arrays: Any,
) -> int:
    """Remove voxels that rays passed through `times` times since the last hit, in every `stride`th row from `first`.

    Args:
        low: integer coordinates x, y of the map's lowest cell.
        reach: distance from the sensor [cells].
        near, many, beyond, returns: as in `NearestReturns` and `FreeSpaceSettings`.
        number: number of this map change.
        arrays: of `for_library`.
    """
    voxels, n = Voxels(*arrays[:6]), arrays[6]
    middle = np.floor(sensor[:2] / size)
    begin, end = (np.fmin(np.fmax(middle + to, low), low + n).astype(np.int64) for to in (-reach, reach + 1))
    x, y = np.arange(begin[0], end[0]), np.arange(begin[1], end[1])
    found = voxels_in(voxels, y[y % stride == first] % n, x % n)
    row, column, level, slots = (each[found[2] > 0] for each in found)
    corner = np.column_stack((column, row)) - begin
    cell = np.column_stack((begin + corner % n + 0.5, voxels.heads[row, column, BASE] + level))
    settings = FreeSpaceSettings(beyond=beyond, returns=returns)
    free = passed(NearestReturns(near, many), (cell + voxels.seen[slots, X : Z + 1]) * size, sensor, settings)
    voxels.seen[slots, PASSED] += free
    gone = np.flatnonzero(free & (voxels.seen[slots, PASSED] >= times))
    release(voxels, slots[gone])
    for field in (OCCUPIED, FEATURED):
        kept = ~(1 << level[gone]).astype(np.int32)
        np.bitwise_and.at(voxels.heads[..., field], (row[gone], column[gone]), kept)
    voxels.changed[row[gone], column[gone]] = number
    return len(gone)
