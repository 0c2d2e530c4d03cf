"""One scan carried by the poses to another's surroundings: how far it lies off what stands upright there."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from offpiste.logs.measurements import Cloud, Lidar
from offpiste.logs.poses import Poses
from offpiste.perception.carry import points_in_world

WAYS = ("by the poses", "sweep not unbent", "stamped 0.2 s late", "not carried")
"""How scans are carried: as they should be, and three ways in which they should not."""
_LATE = 0.2
"""[s]"""
_LEAST = 300
"""Points on upright planes, below which two scans tell nothing."""


def carried_scans(
    scans: Sequence[Cloud], lidar: Lidar, poses: Poses, *, apart: int, every: int = 5
) -> Float[np.ndarray, "n 4"]:
    """Median distance from upright planes of the later scan, by `WAYS` [m]; NaN where there are too few planes.

    Args:
        apart: which later scan each one is carried to.
        every: that scan of the drive begins a pair.
    """
    found = []
    for one, other in zip(scans[: len(scans) - apart : every], scans[apart::every], strict=False):
        unbent = [_in_world(scan, lidar, poses) for scan in (one, other)]
        bent = [_in_world(replace(scan, offset=None), lidar, poses) for scan in (one, other)]
        late = _in_world(replace(one, time=one.time + _LATE), lidar, poses)
        stays = _in_world(replace(one, time=other.time), lidar, poses)
        pairs = (unbent, bent, (late, unbent[1]), (stays, unbent[1]))
        found.append([off_upright_planes(carried[::5], onto[::2]) for carried, onto in pairs])
    return np.array(found).reshape(-1, len(WAYS))


def off_upright_planes(carried: Float[np.ndarray, "n 3"], onto: Float[np.ndarray, "m 3"]) -> float:
    """Median distance of points from planes through upright structure of another scan [m]; NaN where there is little.

    Of each point the nearest one of the other scan within 1 m counts, where its ten neighbours lie on a plane that is
    flat to 5 cm, no line, and not level.
    """
    if len(carried) < _LEAST or len(onto) < _LEAST:
        return float("nan")
    tree = cKDTree(onto)
    distance, index = tree.query(carried, distance_upper_bound=1.0)
    carried, index = carried[np.isfinite(distance)], index[np.isfinite(distance)]
    reach, near = tree.query(onto[index], 10)
    patch = onto[near] - onto[near].mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", patch, patch) / 10)
    normal, spread = axes[:, :, 0], spread.clip(0)
    upright = (np.abs(normal[:, 2]) < 0.3) & (spread[:, 0] < 0.05**2) & (spread[:, 1] > 9 * spread[:, 0])
    upright &= reach[:, -1] < 1
    if upright.sum() < _LEAST:
        return float("nan")
    return float(np.median(np.abs(np.einsum("ni,ni->n", carried - onto[index], normal))[upright]))


def _in_world(scan: Cloud, lidar: Lidar, poses: Poses) -> Float[np.ndarray, "n 3"]:
    points = points_in_world(scan, lidar, poses)
    return points[np.isfinite(points).all(axis=1)]
