"""Removal of voxels that moving objects left behind, by the rays of later scans that pass through them.

A voxel is removed after the rays of several scans passed around it to returns behind it, without a hit in between. Rays
must be dense enough to hit a thin trunk, so only voxels near the vehicle with several rays around them are tested. The
lowest voxel of a column is ground and always stays.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.core.errors import MapError
from offpiste.mapping.voxel_map import BASE, FEATURED, OCCUPIED, PARTS, PASSED, STRIPE, VoxelMap, X, Y, Z, release
from offpiste.native.compilation import MAPPING

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
    points, sensor = np.ascontiguousarray(points_world, np.float64), np.ascontiguousarray(sensor_world, np.float64)
    nearest, count = np.zeros((ROWS, COLUMNS), np.float32), np.zeros((ROWS, COLUMNS), np.int32)
    put_nearest(points, sensor, left_out, nearest, count)
    result = NearestReturns(np.zeros_like(nearest), np.zeros_like(count))
    put_around(nearest, count, result.near, result.many)
    return result


def passed(
    returns: NearestReturns,
    points_world: Float[np.ndarray, "N 3"],
    sensor_world: Float[np.ndarray, " 3"],
    settings: FreeSpaceSettings,
) -> Bool[np.ndarray, " N"]:
    """Return whether the rays of a scan passed finite points (NumPy version of `is_passed`)."""
    x, y, z = (points_world - sensor_world).astype(np.float32).T
    with np.errstate(invalid="ignore", divide="ignore"):
        away, r = np.abs(x) + np.abs(y), np.sqrt(x * x + y * y)
        row = np.floor((z / r - np.float32(STEEPEST)) * np.float32(1 / SLOPE))
        share = y / away
    inside = (away > np.float32(0.01)) & (away < np.float32(1e4)) & (row >= 0) & (row < ROWS)
    around = np.where(inside, np.where(x >= 0, 1 + share, 3 - share), 0)
    column = np.minimum((around * np.float32(COLUMNS / 4)).astype(int), COLUMNS - 1)
    row = np.where(inside, row, 0).astype(int)
    enough = returns.many[row, column] >= settings.returns
    return np.asarray(inside & enough & (returns.near[row, column] > r + np.float32(settings.beyond)))


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
        where = self._turn, settings.every, self._map.low, round(settings.reach / size), sensor, size
        rule = np.float32(settings.beyond), settings.returns, settings.times
        return int(clear_passed(*where, image.near, image.many, *rule, self._map.changes, self._map.voxels))


@MAPPING.inlined
def pixel(x, y, z):  # type: ignore[no-untyped-def]
    """Return row and column of a point relative to the sensor, -1 outside the image, and its horizontal distance."""
    away = abs(x) + abs(y)
    r = np.sqrt(x * x + y * y)
    if not (np.float32(0.01) < away < np.float32(1e4)):
        return -1, -1, r
    row = np.floor((z / r - np.float32(STEEPEST)) * np.float32(1 / SLOPE))
    if not (0 <= row < ROWS):
        return -1, -1, r
    share = y / away
    around = np.float32(1) + share if x >= 0 else np.float32(3) - share
    return np.int64(row), min(np.int64(around * np.float32(COLUMNS / 4)), COLUMNS - 1), r


@MAPPING.entry
def put_nearest(points, sensor, left_out, nearest, count):  # type: ignore[no-untyped-def]
    """Write the distance of each pixel's nearest return, infinite without any, and its number of returns."""
    nearest[:] = np.float32(np.inf)
    count[:] = 0
    for i in range(len(points)):
        x, y = np.float32(points[i, 0] - sensor[0]), np.float32(points[i, 1] - sensor[1])
        row, column, r = pixel(x, y, np.float32(points[i, 2] - sensor[2]))
        if row >= 0 and not left_out[i]:
            count[row, column] += 1
            nearest[row, column] = min(nearest[row, column], r)


@MAPPING.entry
def put_around(nearest, count, near, many):  # type: ignore[no-untyped-def]
    """Write the nearest return and the number of returns of the 3 x 3 pixels around each pixel."""
    for row in range(ROWS):
        for column in range(COLUMNS):
            near[row, column], many[row, column] = nearest[row, column], count[row, column]
        for beside in (row - 1, row + 1):
            if 0 <= beside < ROWS:
                for column in range(COLUMNS):
                    near[row, column] = min(near[row, column], nearest[beside, column])
                    many[row, column] += count[beside, column]
        # The first and the last column are neighbours.
        first, before = (near[row, 0], many[row, 0]), (near[row, COLUMNS - 1], many[row, COLUMNS - 1])
        for column in range(COLUMNS):
            here = near[row, column], many[row, column]
            after = (near[row, column + 1], many[row, column + 1]) if column + 1 < COLUMNS else first
            near[row, column], many[row, column] = min(before[0], here[0], after[0]), before[1] + here[1] + after[1]
            before = here


@MAPPING.inlined
def is_passed(x, y, z, near, many, beyond, returns):  # type: ignore[no-untyped-def]
    """Return whether a point has at least `returns` around it, all of them `beyond` further from the sensor."""
    row, column, r = pixel(x, y, z)
    return row >= 0 and many[row, column] >= returns and near[row, column] > r + beyond


@MAPPING.entry
def clear_passed(  # type: ignore[no-untyped-def]
    first, stride, low, reach, sensor, size, near, many, beyond, returns, times, number, voxels
):
    """Remove voxels that rays passed through `times` times since the last hit, in every `stride`th row from `first`.

    Args:
        low: integer coordinates x, y of the map's lowest cell [2].
        reach: distance from the sensor [cells].
        number: number of this map change.
    """
    n, gone = voxels.heads.shape[0], 0
    middle_x, middle_y = np.int64(np.floor(sensor[0] / size)), np.int64(np.floor(sensor[1] / size))
    for j in range(max(low[1], middle_y - reach), min(low[1] + n, middle_y + reach + 1)):
        if j % stride != first:
            continue
        row = j % n
        part = (row >> STRIPE) % PARTS
        for i in range(max(low[0], middle_x - reach), min(low[0] + n, middle_x + reach + 1)):
            head, slots = voxels.heads[row, i % n], voxels.slots[row, i % n]
            above, level = np.int64(head[OCCUPIED]) >> 1, 1
            while above != 0:
                if above & 1:
                    seen = voxels.seen[slots[level]]
                    x = np.float32((i + np.float64(0.5) + seen[X]) * size - sensor[0])
                    y = np.float32((j + np.float64(0.5) + seen[Y]) * size - sensor[1])
                    z = np.float32((head[BASE] + level + np.float64(seen[Z])) * size - sensor[2])
                    if is_passed(x, y, z, near, many, beyond, returns):
                        seen[PASSED] += np.float32(1)
                        if seen[PASSED] >= times:
                            release(voxels, part, slots[level])
                            head[OCCUPIED] &= ~(np.int64(1) << level)
                            head[FEATURED] &= ~(np.int64(1) << level)
                            voxels.changed[row, i % n] = number
                            gone += 1
                above >>= 1
                level += 1
    return gone
