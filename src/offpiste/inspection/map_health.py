"""What scans and poses do to a map: ghosts below the ground, a height that drifts, things that move.

All of it is measured on the scans of the first minute of driving (`sensor_samples.gather`), without a map.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import uniform_filter

from offpiste.inspection.findings import Finding, Severity
from offpiste.inspection.sensor_samples import Gathered, Scan
from offpiste.logs.measurements import Lidar
from offpiste.logs.poses import Poses
from offpiste.mapping.free_space import FreeSpaceSettings, nearest_returns, passed
from offpiste.mapping.ghosts import GhostFinder

MANY_GHOSTS: Final = 1e-4
"""Share of returns below the ground that is worth a note: ten in a scan of 100,000. Simulated drives: below 3e-5."""
MUCH_DRIFT: Final = 0.05
"""Drift of the height that is a warning [m/s]: one voxel of 0.2 m in the 4 s that a cell is in view before the wheels
reach it, so that level ground is drawn as an obstacle."""
SOME_DRIFT: Final = 0.02
"""Drift that is a note [m/s]. Simulated drives: 0.002; KITTI's GPS: 0.05."""
SURE: Final = 3.0
"""Standard errors by which the drift must exceed these."""
MUCH_MOVING: Final = 0.004
"""Share of moving returns that is worth a note. Simulated drives: up to 0.0012; with 1 % of dust: 0.006."""
LEAST_PAIRS: Final = 8
"""Pairs of scans that a number rests on, at least."""

_APART: Final = (1.5, 4.0)
"""Least and most time between scans whose ground is compared [s]."""
_GROUND_REACH: Final = 25.0
_MOVING_REACH: Final = 30.0
"""Distance from the sensor up to which ground, ghosts in it, and moving things are looked at [m]."""
_CELL: Final = 1.0
"""Side of a cell of ground [m]."""
_FLAT: Final = 0.2
"""Largest range of heights in a cell that is ground [m]."""
_LEAST_CELLS: Final = 20
_MOVED: Final = (0.3, 0.8)
"""Least and most time between scans that moving things are seen in [s]."""
_PIT_DEPTH: Final = 0.5
"""Depth of a pit below the ground around it [m]."""
_PIT_REACH: Final = 5
"""The ground around a cell are the known cells up to so many rows and columns away: 1 m with cells of 0.2 m."""
_PIT_LONE: Final = 0.1
"""Largest share of the ground around that may lie so low: a ditch or a hole in the ground takes more."""


@dataclass(frozen=True)
class MapHealth:
    """What scans and poses do to a map; NaN where it cannot be measured.

    Attributes:
        returns: number within 25 m that was looked at.
        ghosts: share of them below the ground; further away too few rays tell a ghost from a gap between branches.
        drift: change of the height of the same ground between scans 1.5 to 4 s apart: median of its size [m/s].
        drift_error: its standard error [m/s].
        drift_pairs: pairs of scans.
        moving: share of returns within 30 m at places that the rays of a scan half a second earlier passed through.
        moving_pairs: pairs of scans.
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
    """A scan in the world, its sensor, and which points are ghosts."""

    time: float
    points: Float[np.ndarray, "n 3"]
    sensor: Float[np.ndarray, " 3"]
    ghosts: Bool[np.ndarray, " n"]


def map_health(lidars: Mapping[str, Lidar], gathered: Gathered, poses: Poses) -> MapHealth:
    """Measure ghosts, drift of height and moving returns of a log's LiDARs."""
    placed = {name: list(_placed(lidar, gathered.scans[name], poses)) for name, lidar in lidars.items()}
    scans = [scan for mine in placed.values() for scan in mine]
    near = [_within(scan, _GROUND_REACH) for scan in scans]
    returns = int(sum(inside.sum() for inside in near))
    ghosts = float(sum((scan.ghosts & inside).sum() for scan, inside in zip(scans, near, strict=True)))
    rates = np.array([rate for mine in placed.values() for rate in height_rates(mine)])
    moving = np.array([share for mine in placed.values() for share in moving_shares(mine)])
    error = 1.25 * rates.std() / np.sqrt(len(rates)) if len(rates) else np.nan  # of a median
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
    """Points up to a horizontal distance from the sensor [m]."""
    return np.asarray(np.linalg.norm(scan.points[:, :2] - scan.sensor[:2], axis=1) < reach)


def height_rates(scans: Sequence[PlacedScan]) -> list[float]:
    """Change of the height of the ground that two scans share, for each pair that is 1.5 to 4 s apart [m/s]."""
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
    """Numbers of the cells in which a scan shows flat ground, and its mean height there [m]."""
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
    """Share of the near returns of a scan at places that rays of the one before passed through, for each pair."""
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


def check_map_health(health: MapHealth, *, turned: bool = False) -> list[Finding]:
    """A warning for a height that drifts, notes for ghosts and for many moving returns.

    Args:
        turned: a LiDAR is mounted otherwise than the rig says, from which ground seems to rise or sink as well.
    """
    result = []
    least = health.drift - SURE * health.drift_error
    if health.drift_pairs >= LEAST_PAIRS and least > SOME_DRIFT:
        evidence = (
            f"the same ground is {100 * health.drift:.1f} cm higher or lower after 1 s (standard error "
            f"{100 * health.drift_error:.1f}); {health.drift_pairs} pairs of scans 1.5 to 4 s apart"
        )
        remedy = "take poses from a source with a better height (LiDAR odometry, RTK); no rig line helps"
        if turned:
            remedy = "correct the mounting of the LiDAR that is turned, which can do this, and inspect again"
        severity: Severity = "warning" if least > MUCH_DRIFT and not turned else "note"
        result.append(Finding(severity, "poses", "drift in height", evidence, remedy, min(1.0, health.drift / 0.2)))
    if health.ghosts > MANY_GHOSTS:
        evidence = (
            f"{health.ghosts:.3%} of {health.returns} returns within 25 m, from rays that pass below ground nearer by"
        )
        remedy = "nothing: the map leaves them out (mapping.ghosts); other software may not"
        result.append(Finding("note", "LiDARs", "see ghosts below the ground", evidence, remedy, health.ghosts))
    if health.moving_pairs >= LEAST_PAIRS and health.moving > MUCH_MOVING:
        evidence = (
            f"{health.moving:.1%} of the returns within 30 m, where rays passed through half a second earlier;"
            f" {health.moving_pairs} pairs of scans"
        )
        remedy = "nothing: their trails leave the map near the vehicle (mapping.free_space); further away they stay"
        result.append(Finding("note", "LiDARs", "see much that moves", evidence, remedy, health.moving))
    return result


def find_pits(elevation: Float[np.ndarray, "ny nx"]) -> Bool[np.ndarray, "ny nx"]:
    """Which cells are pits.

    Args:
        elevation: of the map, NaN where it is unknown [m].
    """
    known = np.isfinite(elevation)
    result = np.zeros(elevation.shape, bool)
    if not known.any():
        return result
    level = np.where(known, elevation - np.median(elevation[known]), 0.0)
    side = 2 * _PIT_REACH + 1
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = uniform_filter(level, side) / uniform_filter(known.astype(float), side)
        # What is below nine tenths of its surroundings by _PIT_DEPTH is below their mean by nine tenths of that.
        maybe = known & (level < mean - (1 - _PIT_LONE) * _PIT_DEPTH + 1e-6)
    for row, column in np.argwhere(maybe):
        around = elevation[
            max(row - _PIT_REACH, 0) : row + _PIT_REACH + 1, max(column - _PIT_REACH, 0) : column + _PIT_REACH + 1
        ]
        around = around[np.isfinite(around)]
        result[row, column] = (around - _PIT_DEPTH <= elevation[row, column]).mean() <= _PIT_LONE
    return result
