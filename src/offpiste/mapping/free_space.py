"""Free space: things that moved away leave a trail of voxels in the map, which rays then pass through.

A voxel that is hit stays; one that the rays of some scans pass on all sides, on their way to things behind it, without
any hit in between, is empty. Rays must be dense enough to hit a thin trunk that stands there, so that only voxels near
the vehicle are looked at, and only where several rays pass. The lowest voxel of a column always stays: it is ground.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.core.errors import MapError
from offpiste.mapping.voxel_kernels import BASE, FEATURED, OCCUPIED, PARTS, PASSED, STRIPE, X, Y, Z, release
from offpiste.mapping.voxel_map import VoxelMap
from offpiste.native.compilation import MAPPING

STEEPEST, SLOPE, ROWS, COLUMNS = -1.0, 0.025, 64, 256
"""Slope of the lowest row, slope of a row [m per m], rows and columns: pixels of 1.4 degrees at the horizon."""


@dataclass(frozen=True)
class FreeSpaceSettings:
    """When a voxel is taken away.

    Attributes:
        reach: distance from the sensor up to which voxels are looked at, in x and in y [m].
        every: each scan looks at one of so many rows of the map.
        times: a voxel goes after so many looks at which rays passed through it since it was last hit.
        returns: number of returns around it at each look, at least.
        beyond: all of them are further away than the voxel by this [m].
    """

    reach: float = 20.0
    every: int = 5
    times: int = 5
    returns: int = 4
    beyond: float = 0.5

    def __post_init__(self) -> None:
        if min(self.reach, self.beyond, self.every, self.times, self.returns) <= 0:
            raise MapError("free space: a setting is not positive", where="map settings", how="give positive numbers")


@dataclass(frozen=True)
class NearestReturns:
    """What a scan shows around each direction from its sensor.

    Attributes:
        near: horizontal distance of the nearest return; infinite without any [m].
        many: number of returns.
    """

    near: Float[np.ndarray, "r c"]
    many: Int[np.ndarray, "r c"]


def nearest_returns(
    points_world: Float[np.ndarray, "N 3"], sensor_world: Float[np.ndarray, " 3"], left_out: Bool[np.ndarray, " N"]
) -> NearestReturns:
    """The nearest return in the 3 x 3 pixels around each direction; some points are left out."""
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
    """Whether rays of a scan passed finite places, as its nearest returns show (plain NumPy for what the loop does)."""
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
    """Takes trails out of one voxel map, scan by scan."""

    def __init__(self, voxel_map: VoxelMap, settings: FreeSpaceSettings | None = None) -> None:
        self.settings = settings or FreeSpaceSettings()
        self._map, self._turn = voxel_map, 0

    def clear(
        self,
        points_world: Float[np.ndarray, "N 3"],
        sensor_world: Float[np.ndarray, " 3"],
        left_out: Bool[np.ndarray, " N"],
    ) -> int:
        """Take away voxels that the rays of this scan, which is in the map, and of earlier ones passed through.

        Args:
            left_out: points that show nothing, such as ghosts.

        Returns:
            number of voxels.
        """
        settings, size = self.settings, self._map.settings.size
        returns = nearest_returns(points_world, sensor_world, left_out)
        self._turn = (self._turn + 1) % settings.every
        self._map.changes += 1
        return int(
            clear_passed(
                self._turn,
                settings.every,
                self._map.low,
                round(settings.reach / size),
                np.ascontiguousarray(sensor_world, np.float64),
                size,
                returns.near,
                returns.many,
                np.float32(settings.beyond),
                settings.returns,
                settings.times,
                self._map.changes,
                self._map.voxels,
            )
        )


@MAPPING.inlined
def pixel(x, y, z):  # type: ignore[no-untyped-def]
    """Row and column of a place relative to the sensor, -1 outside of the image, and its horizontal distance [m]."""
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
    """Put the distance of the nearest return of each pixel, infinite without any, and the number of its returns."""
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
    """Put the nearest return and the number of returns in the 3 x 3 pixels around each."""
    for row in range(ROWS):
        for column in range(COLUMNS):
            near[row, column], many[row, column] = nearest[row, column], count[row, column]
        for beside in (row - 1, row + 1):
            if 0 <= beside < ROWS:
                for column in range(COLUMNS):
                    near[row, column] = min(near[row, column], nearest[beside, column])
                    many[row, column] += count[beside, column]
        # Around the sensor the last column is beside the first one.
        first, before = (near[row, 0], many[row, 0]), (near[row, COLUMNS - 1], many[row, COLUMNS - 1])
        for column in range(COLUMNS):
            here = near[row, column], many[row, column]
            after = (near[row, column + 1], many[row, column + 1]) if column + 1 < COLUMNS else first
            near[row, column], many[row, column] = min(before[0], here[0], after[0]), before[1] + here[1] + after[1]
            before = here


@MAPPING.inlined
def is_passed(x, y, z, near, many, beyond, returns):  # type: ignore[no-untyped-def]
    """Whether rays pass a place, relative to the sensor: at least `returns` around it, all `beyond` further."""
    row, column, r = pixel(x, y, z)
    return row >= 0 and many[row, column] >= returns and near[row, column] > r + beyond


@MAPPING.entry
def clear_passed(  # type: ignore[no-untyped-def]
    first, stride, low, reach, sensor, size, near, many, beyond, returns, times, number, voxels
):
    """Take away voxels that rays passed through `times` times since they were last hit; returns how many.

    Looks at every `stride`th row from `first`, within `reach` cells of the sensor. The lowest voxel of a column stays.

    Args:
        low: integer coordinates x, y of the map's lowest cell [2].
        sensor: where the scan was taken from [3] [m].
        size: of a voxel [m].
        number: of this change of the map.
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
