"""Search for returns from the vehicle itself, which are static in the body frame while the vehicle drives."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.calibration.samples import Scan
from offpiste.logs.measurements import Lidar
from offpiste.logs.poses import Poses

AROUND: Final = 1.5
"""Margin around the wheels within which vehicle parts are searched [m]."""
_ABOVE_GROUND: Final = 0.5
"""Minimum height above the ground of returns from the vehicle [m]; the ground is static in the body frame as well."""
_NEAR: Final = 8.0
"""Distance within which the ground height is measured [m]."""
_STEP: Final = 1.0
"""Minimum distance between two compared scans [m]; at a standstill everything is static."""
_SCANS: Final = 8
"""Minimum number of scans for a decision."""
_VOXEL: Final = 0.2
_NUMBERS: Final = np.array([1, 1000, 1_000_000])
"""Factors that combine the three indices of a voxel into one; voxels lie within a few metres of the vehicle."""
_OFTEN: Final = 0.6
"""Minimum share of scans with returns in a static voxel; bushes beside a trail stay below it."""
_RETURNS: Final = 10
"""Minimum mean number of returns per scan in all static voxels."""
_MARGIN: Final = 0.1
"""Margin of the box around static returns [m]."""


@dataclass(frozen=True)
class OwnBody:
    """Returns from the vehicle itself.

    Attributes:
        box: lower and upper corner in the body frame [m].
        returns: mean number of returns per scan.
        scans: number of compared scans.
    """

    box: Float[np.ndarray, "2 3"]
    returns: float
    scans: int


def find_own_body(
    lidar: Lidar, scans: Sequence[Scan], poses: Poses, wheels: Sequence[tuple[float, float]]
) -> OwnBody | None:
    """Find returns above the ground near the wheels that are static in the body frame; return None if there are few.

    Args:
        wheels: x, y in the body frame [m].
    """
    low, high = np.min(wheels, axis=0) - AROUND, np.max(wheels, axis=0) + AROUND
    seen = [_above_ground(lidar, scan, low, high) for scan in _apart(scans, poses)]
    if len(seen) < _SCANS:
        return None
    voxels = [np.floor(points / _VOXEL).astype(np.int64) for points in seen]
    places, count = np.unique(np.concatenate([np.unique(v, axis=0) for v in voxels]), axis=0, return_counts=True)
    standing = places[count > _OFTEN * len(seen)]
    returns = float(np.mean([np.isin(v @ _NUMBERS, standing @ _NUMBERS).sum() for v in voxels]))
    if not returns > _RETURNS:
        return None
    box = np.array([standing.min(axis=0) * _VOXEL - _MARGIN, (standing.max(axis=0) + 1) * _VOXEL + _MARGIN])
    if lidar.source.own_body is not None:
        box = np.array([np.minimum(box[0], lidar.source.own_body[0]), np.maximum(box[1], lidar.source.own_body[1])])
    return OwnBody(box, returns, len(seen))


def _apart(scans: Sequence[Scan], poses: Poses) -> list[Scan]:
    """Select scans taken at least `_STEP` apart."""
    places = poses.at(np.array([scan.time for scan in scans]))[:, :3, 3]
    chosen: list[int] = []
    for number in np.flatnonzero(np.isfinite(places).all(axis=1)).tolist():
        if not chosen or np.linalg.norm(places[number] - places[chosen[-1]]) > _STEP:
            chosen.append(number)
    return [scans[number] for number in chosen]


def _above_ground(
    lidar: Lidar, scan: Scan, low: Float[np.ndarray, " 2"], high: Float[np.ndarray, " 2"]
) -> Float[np.ndarray, "n 3"]:
    """Return the points above the ground within a rectangle, in the body frame [m]."""
    body = scan.points @ lidar.body_from_lidar[:3, :3].T + lidar.body_from_lidar[:3, 3]
    near = np.linalg.norm(body[:, :2], axis=1) < _NEAR
    ground = float(np.percentile(body[near, 2], 20)) if near.any() else np.inf
    inside = ((body[:, :2] > low) & (body[:, :2] < high)).all(axis=1) & (body[:, 2] > ground + _ABOVE_GROUND)
    return np.asarray(body[inside])
