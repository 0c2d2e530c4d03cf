"""Check for parts of the vehicle in a LiDAR's view: what stands in the body frame while the vehicle drives on."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.inspection.findings import Finding
from offpiste.inspection.sensor_samples import Scan
from offpiste.logs.measurements import Lidar
from offpiste.logs.poses import Poses
from offpiste.rig.edits import Edit

_AROUND: Final = 1.5
"""Parts are looked for between the wheels, and so far beyond them [m]."""
_ABOVE_GROUND: Final = 0.5
"""Height above the ground from which returns may be of the vehicle [m]: ground stands in the body frame as well."""
_NEAR: Final = 8.0
"""Distance within which the ground's height is measured [m]."""
_STEP: Final = 1.0
"""Least way between two scans that are compared [m]: at a standstill everything stands."""
_SCANS: Final = 8
"""Fewer scans than this do not tell what stands."""
_VOXEL: Final = 0.2
_NUMBERS: Final = np.array([1, 1000, 1_000_000])
"""Make one number of a voxel's three: they lie within some metres of the vehicle."""
_OFTEN: Final = 0.6
"""A voxel in which so many of the scans have returns stands; bushes beside a trail do not stay in one."""
_RETURNS: Final = 10
"""Least number of returns a scan, on average, in all voxels that stand."""
_MARGIN: Final = 0.1
"""Margin of the box around what stands [m]."""


def check_own_body(
    lidar: Lidar, scans: Sequence[Scan], poses: Poses, wheels: Sequence[tuple[float, float]]
) -> list[Finding]:
    """Finding if returns above the ground, at the wheels and between them, stay where they are in the body frame.

    Args:
        wheels: x, y in the body frame [m].
    """
    low, high = np.min(wheels, axis=0) - _AROUND, np.max(wheels, axis=0) + _AROUND
    seen = [_above_ground(lidar, scan, low, high) for scan in _apart(scans, poses)]
    if len(seen) < _SCANS:
        return []
    voxels = [np.floor(points / _VOXEL).astype(np.int64) for points in seen]
    places, count = np.unique(np.concatenate([np.unique(v, axis=0) for v in voxels]), axis=0, return_counts=True)
    standing = places[count > _OFTEN * len(seen)]
    returns = [np.isin(v @ _NUMBERS, standing @ _NUMBERS).sum() for v in voxels]
    if not np.mean(returns) > _RETURNS:
        return []
    box = np.array([standing.min(axis=0) * _VOXEL - _MARGIN, (standing.max(axis=0) + 1) * _VOXEL + _MARGIN])
    if lidar.source.own_body is not None:
        box = np.array([np.minimum(box[0], lidar.source.own_body[0]), np.maximum(box[1], lidar.source.own_body[1])])
    cure = Edit(f"lidars.{lidar.name}.own_body", box.round(2).tolist())
    evidence = (
        f"{np.mean(returns):.0f} returns a scan stay at the same places of the body frame, above the ground and within "
        f"{_AROUND:g} m of the wheels, in {len(seen)} scans on the way"
    )
    return [Finding("warning", lidar.name, "sees the vehicle itself", evidence, str(cure), 1.0, ((cure,),))]


def _apart(scans: Sequence[Scan], poses: Poses) -> list[Scan]:
    """Scans that were taken `_STEP` from each other."""
    places = poses.at(np.array([scan.time for scan in scans]))[:, :3, 3]
    chosen: list[int] = []
    for number in np.flatnonzero(np.isfinite(places).all(axis=1)).tolist():
        if not chosen or np.linalg.norm(places[number] - places[chosen[-1]]) > _STEP:
            chosen.append(number)
    return [scans[number] for number in chosen]


def _above_ground(
    lidar: Lidar, scan: Scan, low: Float[np.ndarray, " 2"], high: Float[np.ndarray, " 2"]
) -> Float[np.ndarray, "n 3"]:
    """Points in the body frame that are above the ground and in a rectangle [m]."""
    body = scan.points @ lidar.body_from_lidar[:3, :3].T + lidar.body_from_lidar[:3, 3]
    near = np.linalg.norm(body[:, :2], axis=1) < _NEAR
    ground = float(np.percentile(body[near, 2], 20)) if near.any() else np.inf
    inside = ((body[:, :2] > low) & (body[:, :2] < high)).all(axis=1) & (body[:, 2] > ground + _ABOVE_GROUND)
    return np.asarray(body[inside])
