"""Estimate of a camera's position: triangulated image points must lie on surfaces measured by a LiDAR.

With a known rotation, features in two images are triangulated. The estimated position aligns these points with the
planes of the nearest scan (translation-only ICP) in a robust fit of all three coordinates.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from offpiste.calibration.image_motion import Matches
from offpiste.calibration.misfit import Misfit, Pair, Parameters, differentiated, fit_misfit, planes, turned
from offpiste.calibration.samples import Scan, nearest_world
from offpiste.logs.measurements import Lidar
from offpiste.logs.poses import Poses

_REACHES: Final = (4.0, 3.0, 2.0, 1.5, 1.0, 0.7, 0.5)
"""Successive search radii for surfaces [m]."""
_PARALLAX: Final = np.deg2rad(2.0)
"""Minimum parallax for triangulation [rad]."""
_FURTHEST: Final = 20.0
"""Maximum distance of triangulated points [m]."""
_PRIOR: Final = np.array([*np.deg2rad([0.3, 0.3, 0.3]), 0.01, 3.0, 3.0, 3.0])
"""Standard deviations of the prior; rotation and delay are nearly fixed [rad, s, m]."""


@dataclass(frozen=True)
class _Seen:
    matches: Matches
    world: Float[np.ndarray, "n 3"]
    tree: cKDTree


def estimate_place(
    body_from_camera: Float[np.ndarray, "4 4"],
    matches: Sequence[Matches],
    lidar: Lidar,
    scans: Sequence[Scan],
    poses: Poses,
) -> Misfit | None:
    """Estimate a camera's offset along the body axes, the last three parameters [m]; None with too little overlap.

    Args:
        body_from_camera: rotation correct to 1 to 2 degrees; the position may be metres off.
        lidar: with a correct mounting.
    """
    worlds = [nearest_world(scans, one.times[0], lidar.body_from_lidar, poses, np.zeros(4)) for one in matches]
    seen = [_Seen(m, world, cKDTree(world)) for m, world in zip(matches, worlds, strict=True) if len(world) > 100]
    misfit = None
    for reach in _REACHES:
        start = None if misfit is None else misfit.parameters

        def compare(now: Parameters, reach: float = reach) -> list[Pair]:
            return [_compared(one, body_from_camera, poses, now, reach) for one in seen]

        misfit = fit_misfit(compare, prior=_PRIOR, start=start, rounds=3)
        if misfit is None:
            return None
    return misfit


def _compared(
    seen: _Seen, body_from_camera: Float[np.ndarray, "4 4"], poses: Poses, parameters: Parameters, reach: float
) -> Pair:
    points = _triangulated(seen.matches, body_from_camera, poses, parameters)
    known = np.flatnonzero(np.isfinite(points).all(axis=1))
    distance, nearest = seen.tree.query(points[known], distance_upper_bound=reach)
    kept = np.isfinite(distance)
    known, nearest = known[kept], nearest[kept]
    normal, flat = planes(seen.world, seen.tree, seen.world[nearest])
    known, normal, onto = known[flat], normal[flat], seen.world[nearest][flat]

    def residual(now: Parameters) -> np.ndarray:
        return np.einsum("ni,ni->n", normal, _triangulated(seen.matches, body_from_camera, poses, now)[known] - onto)

    return differentiated(residual, parameters)


def _triangulated(
    matches: Matches, body_from_camera: Float[np.ndarray, "4 4"], poses: Poses, parameters: Parameters
) -> Float[np.ndarray, "n 3"]:
    """Return world points nearest to the rays of both images [m]; NaN if behind, too far or unknown."""
    one, other = poses.at(np.array(matches.times) - parameters[3]) @ turned(body_from_camera, parameters)
    here, there = matches.one @ one[:3, :3].T, matches.other @ other[:3, :3].T
    way = other[:3, 3] - one[:3, 3]
    cosine = np.einsum("ni,ni->n", here, there)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (here @ way - cosine * (there @ way)) / (1 - cosine**2)
        good = (np.arccos(np.clip(cosine, -1, 1)) > _PARALLAX) & (depth > 0.3) & (depth < _FURTHEST)
    return one[:3, 3] + np.where(good, depth, np.nan)[:, None] * here
