"""Check of a LiDAR against the poses, by the consistency of scan pairs.

Points of one scan are transformed by the poses into another; their distances from its planes (Chen and Medioni, 1992)
depend on the LiDAR's mounting while the vehicle moves or turns, and on its delay while it turns or changes speed.
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from offpiste.inspection.misfit import PRIOR, STEPS, Misfit, Pair, Parameters, fit_misfit
from offpiste.inspection.sensor_samples import Scan, pairs
from offpiste.logs.measurements import Lidar
from offpiste.logs.poses import Poses

_SAMPLE: Final = 1500
"""Number of points per scan compared with planes of the other."""
_REACH: Final = 1.0
"""Search radius for a plane [m]: a few degrees at 20 m."""
_FURTHEST: Final = 40.0
"""Maximum range; beyond it, points are too sparse for planes [m]."""
_NEIGHBOURS: Final = 12


def check_lidar(
    lidar: Lidar,
    scans: Sequence[Scan],
    poses: Poses,
    *,
    prior: Parameters = PRIOR,
    start: Parameters | None = None,
    rounds: int = 6,
) -> Misfit | None:
    """Estimate the errors of a LiDAR's mounting and stamps; None with too few usable scans.

    Args:
        prior, start, rounds: as for `fit_misfit`; more than four entries also estimate the position.
    """
    rng = np.random.default_rng(0)
    chosen = [rng.permutation(len(scan.points))[:_SAMPLE] for scan in scans]
    couples = list(pairs([scan.time for scan in scans]))

    def compare(parameters: Parameters) -> list[Pair]:
        return [_compared(lidar, scans[i], scans[j], chosen[i], poses, parameters) for i, j in couples]

    return fit_misfit(compare, prior=prior, start=start, rounds=rounds)


def median_distance(lidar: Lidar, scans: Sequence[Scan], poses: Poses) -> float:
    """Return the median distance of points from the next scan's planes as mounted now [m]; NaN without pairs."""
    rng = np.random.default_rng(0)
    couples = list(pairs([scan.time for scan in scans]))
    distances = []
    for i, j in couples[:: max(1, len(couples) // 12)]:
        chosen = rng.permutation(len(scans[i].points))[:_SAMPLE]
        distances.append(np.abs(_compared(lidar, scans[i], scans[j], chosen, poses, np.zeros(4)).residual))
    known = np.concatenate(distances) if distances else np.zeros(0)
    return float(np.median(known)) if len(known) else np.nan


def _compared(lidar: Lidar, one: Scan, other: Scan, chosen: np.ndarray, poses: Poses, parameters: Parameters) -> Pair:
    """Return distances of one scan's points from planes of another, and their Jacobian."""
    mounting = lidar.body_from_lidar
    there = other.in_world(mounting, poses, parameters)
    here = one.in_world(mounting, poses, parameters, chosen)
    known = np.flatnonzero(np.isfinite(there).all(axis=1))
    usable = np.isfinite(here).all(axis=1) & (np.linalg.norm(one.points[chosen], axis=1) < _FURTHEST)
    if len(known) < 100 or not usable.any():
        return Pair(np.zeros(0), np.zeros((0, len(parameters))))
    chosen, here = chosen[usable], here[usable]
    tree = cKDTree(there[known])
    distance, nearest = tree.query(here, distance_upper_bound=_REACH)
    result = np.isfinite(distance)
    chosen, here, nearest = chosen[result], here[result], known[nearest[result]]
    normal, flat = planes(there[known], tree, there[nearest])
    chosen, here, nearest, normal = chosen[flat], here[flat], nearest[flat], normal[flat]

    def residual(at: Parameters) -> np.ndarray:
        apart = one.in_world(mounting, poses, at, chosen) - other.in_world(mounting, poses, at, nearest)
        return np.einsum("ni,ni->n", normal, apart)

    return differentiated(residual, parameters)


def differentiated(residual: Callable[[Parameters], Float[np.ndarray, " n"]], parameters: Parameters) -> Pair:
    """Return a residual [n] and its Jacobian by central differences; rows with unknown values are dropped."""
    steps = np.diag(STEPS[: len(parameters)])
    slopes = [(residual(parameters + s) - residual(parameters - s)) / (2 * s.sum()) for s in steps]
    value, slope = residual(parameters), np.stack(slopes, axis=1)
    known = np.isfinite(value) & np.isfinite(slope).all(axis=1)
    return Pair(value[known], slope[known])


def planes(
    points: Float[np.ndarray, "n 3"], tree: cKDTree, at: Float[np.ndarray, "m 3"]
) -> tuple[Float[np.ndarray, "m 3"], Bool[np.ndarray, " m"]]:
    """Return unit normals of point neighbourhoods, and a mask of the planar ones that are not a single ring."""
    if len(points) < _NEIGHBOURS or not len(at):
        return np.zeros((len(at), 3)), np.zeros(len(at), dtype=bool)
    distance, index = tree.query(at, k=_NEIGHBOURS)
    near = points[index] - points[index].mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("mki,mkj->mij", near, near) / _NEIGHBOURS)
    flat = (spread[:, 0] < 0.1 * spread[:, 1]) & (spread[:, 1] > 0.04 * spread[:, 2]) & (spread[:, 0] < 0.05**2)
    return axes[:, :, 0], flat & (distance[:, -1] < 2.0)
