"""Effects of scan and pose errors on a map: ghosts below the ground, height drift, moving objects.

All are measured on scans of the first minute of driving (`sensor_samples.gather`), without a map.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import uniform_filter

from offpiste.calibration.samples import Gathered, Scan
from offpiste.logs.measurements import Lidar
from offpiste.logs.poses import Poses
from offpiste.mapping.free_space import FreeSpaceSettings, nearest_returns, passed
from offpiste.mapping.ghosts import GhostFinder

_APART: Final = (1.5, 4.0)
"""Range of times between scans whose ground is compared [s]."""
_GROUND_REACH: Final = 25.0
_MOVING_REACH: Final = 30.0
"""Maximum range from the sensor for ground, ghosts and moving objects [m]."""
_CELL: Final = 1.0
"""Side of a ground cell [m]."""
_FLAT: Final = 0.2
"""Maximum range of heights in a ground cell [m]."""
_LEAST_CELLS: Final = 20
_MOVED: Final = (0.3, 0.8)
"""Range of times between scans used to detect moving objects [s]."""
_PIT_DEPTH: Final = 0.5
"""Minimum depth of a pit below the surrounding ground [m]."""
_PIT_REACH: Final = 5
"""Half-width in cells of the ground around a pit: 1 m with cells of 0.2 m."""
_PIT_LONE: Final = 0.1
"""Maximum share of equally low ground around a pit; ditches and holes cover more."""


@dataclass(frozen=True)
class MapHealth:
    """Effects of scan and pose errors on a map; NaN if not measurable.

    Attributes:
        returns: number of examined returns within 25 m.
        ghosts: share of them below the ground; at longer range, gaps between branches are indistinguishable.
        drift: median absolute height change of the same ground between scans 1.5 to 4 s apart [m/s].
        drift_error: its standard error [m/s].
        drift_pairs: number of scan pairs.
        moving: share of returns within 30 m in space that rays of a scan half a second earlier passed through.
        moving_pairs: number of scan pairs.
    """

    returns: int
    ghosts: float
    drift: float
    drift_error: float
    drift_pairs: int
    moving: float
    moving_pairs: int

    def __str__(self) -> str:
        return (
            f"{self.ghosts:.3%} of the returns below the ground; ground moves up or down by {100 * self.drift:.1f} cm/s"
            f" between scans ({self.drift_pairs} pairs); {self.moving:.2%} of the returns move"
        )


@dataclass(frozen=True)
class PlacedScan:
    """A scan in the world frame, its sensor position, and a mask of ghosts."""

    time: float
    points: Float[np.ndarray, "n 3"]
    sensor: Float[np.ndarray, " 3"]
    ghosts: Bool[np.ndarray, " n"]


def map_health(lidars: Mapping[str, Lidar], gathered: Gathered, poses: Poses) -> MapHealth:
    """Measure ghosts, height drift and moving returns of a log's LiDARs."""
    placed = {name: list(_placed(lidar, gathered.scans[name], poses)) for name, lidar in lidars.items()}
    scans = [scan for mine in placed.values() for scan in mine]
    near = [_within(scan, _GROUND_REACH) for scan in scans]
    returns = int(sum(inside.sum() for inside in near))
    ghosts = float(sum((scan.ghosts & inside).sum() for scan, inside in zip(scans, near, strict=True)))
    rates = np.array([rate for mine in placed.values() for rate in height_rates(mine)])
    moving = np.array([share for mine in placed.values() for share in moving_shares(mine)])
    error = 1.25 * rates.std() / np.sqrt(len(rates)) if len(rates) else np.nan  # standard error of a median
    return MapHealth(
        returns=returns,
        ghosts=ghosts / returns if returns else np.nan,
        drift=float(np.median(rates)) if len(rates) else np.nan,
        drift_error=float(error),
        drift_pairs=len(rates),
        moving=float(np.mean(moving)) if len(moving) else np.nan,
        moving_pairs=len(moving),
    )


def _placed(lidar: Lidar, scans: Sequence[Scan], poses: Poses) -> Iterator[PlacedScan]:
    finder = GhostFinder()
    for scan in scans:
        pose = poses.at(np.array([scan.time]))[0]
        points = scan.in_world(lidar.body_from_lidar, poses, np.zeros(4))
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) and np.isfinite(pose).all():
            sensor = (pose @ lidar.body_from_lidar)[:3, 3]
            yield PlacedScan(scan.time, points, sensor, finder.find(points, sensor))


def _within(scan: PlacedScan, reach: float) -> Bool[np.ndarray, " n"]:
    """Return a mask of points up to a horizontal distance from the sensor [m]."""
    return np.asarray(np.linalg.norm(scan.points[:, :2] - scan.sensor[:2], axis=1) < reach)


def height_rates(scans: Sequence[PlacedScan]) -> list[float]:
    """Return the height change rate of the shared ground for each pair of scans 1.5 to 4 s apart [m/s]."""
    ground = [_ground(scan) for scan in scans]
    rates = []
    for i, one in enumerate(scans):
        for j in range(i + 1, len(scans)):
            apart = scans[j].time - one.time
            if apart > _APART[1]:
                break
            if apart < _APART[0]:
                continue
            _, mine, other = np.intersect1d(ground[i][0], ground[j][0], assume_unique=True, return_indices=True)
            if len(mine) >= _LEAST_CELLS:
                rates.append(float(abs(np.median(ground[j][1][other] - ground[i][1][mine])) / apart))
    return rates


def _ground(scan: PlacedScan) -> tuple[np.ndarray, np.ndarray]:
    """Return the cells of a scan with flat ground, and their mean heights [m]."""
    near = ~scan.ghosts & _within(scan, _GROUND_REACH)
    points = scan.points[near & (scan.points[:, 2] < scan.sensor[2])]
    column, row = np.floor(points[:, :2] / _CELL).astype(np.int64).T
    cells, which, count = np.unique(column * 2**32 + row, return_inverse=True, return_counts=True)
    lowest, highest = np.full(len(cells), np.inf), np.full(len(cells), -np.inf)
    np.minimum.at(lowest, which, points[:, 2])
    np.maximum.at(highest, which, points[:, 2])
    mean = np.bincount(which, points[:, 2], minlength=len(cells)) / np.maximum(count, 1)
    flat = (count >= 3) & (highest - lowest < _FLAT)
    return cells[flat], mean[flat]


def moving_shares(scans: Sequence[PlacedScan]) -> list[float]:
    """Return for each pair the share of near returns in space that rays of the previous scan passed through."""
    settings = FreeSpaceSettings(beyond=1.0)
    shares = []
    for before, after in pairwise(scans):
        if not _MOVED[0] <= after.time - before.time <= _MOVED[1]:
            continue
        near = ~after.ghosts & _within(after, _MOVING_REACH)
        if near.any():
            seen = nearest_returns(before.points, before.sensor, before.ghosts)
            shares.append(float(passed(seen, after.points[near], before.sensor, settings).mean()))
    return shares


def find_pits(elevation: Float[np.ndarray, "ny nx"]) -> Bool[np.ndarray, "ny nx"]:
    """Return a mask of pits.

    Args:
        elevation: of the map; NaN if unknown [m].
    """
    known = np.isfinite(elevation)
    result = np.zeros(elevation.shape, bool)
    if not known.any():
        return result
    level = np.where(known, elevation - np.median(elevation[known]), 0.0)
    side = 2 * _PIT_REACH + 1
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = uniform_filter(level, side) / uniform_filter(known.astype(float), side)
        # Below 90 % of the surroundings by _PIT_DEPTH implies below their mean by 0.9 _PIT_DEPTH.
        maybe = known & (level < mean - (1 - _PIT_LONE) * _PIT_DEPTH + 1e-6)
    for row, column in np.argwhere(maybe):
        around = elevation[
            max(row - _PIT_REACH, 0) : row + _PIT_REACH + 1, max(column - _PIT_REACH, 0) : column + _PIT_REACH + 1
        ]
        around = around[np.isfinite(around)]
        result[row, column] = (around - _PIT_DEPTH <= elevation[row, column]).mean() <= _PIT_LONE
    return result
