"""Check of a LiDAR against the poses: two of its scans should show one world.

Points of one scan are moved by the poses to the other's surroundings; their distances from the planes there
(Chen and Medioni, 1992) depend on how the LiDAR is mounted, wherever the vehicle drives on or turns, and on its delay,
wherever it turns or changes its speed.
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
"""Points of a scan that are compared with planes of the other."""
_REACH: Final = 1.0
"""Distance within which a plane is searched [m]: a few degrees at 20 m."""
_FURTHEST: Final = 40.0
"""Further away neighbours are too far from each other for planes [m]."""
_NEIGHBOURS: Final = 12


def check_lidar(
    lidar: Lidar,
    scans: Sequence[Scan],
    poses: Poses,
    *,
    seed: int = 0,
    prior: Parameters = PRIOR,
    start: Parameters | None = None,
    rounds: int = 6,
) -> Misfit | None:
    """Estimate by how much a LiDAR's mounting and stamps are off; None with too few usable scans.

    Args:
        prior, start, rounds: as for `fit_misfit`; with more than four entries the place is estimated, too.
    """
    rng = np.random.default_rng(seed)
    chosen = [rng.permutation(len(scan.points))[:_SAMPLE] for scan in scans]
    couples = list(pairs([scan.time for scan in scans]))

    def compare(parameters: Parameters) -> list[Pair]:
        return [_compared(lidar, scans[i], scans[j], chosen[i], poses, parameters) for i, j in couples]

    return fit_misfit(compare, prior=prior, start=start, rounds=rounds)


def median_distance(lidar: Lidar, scans: Sequence[Scan], poses: Poses, *, seed: int = 0) -> float:
    """Median distance of points from planes of the next scan, as they are mounted now [m]; NaN without pairs."""
    rng = np.random.default_rng(seed)
    couples = list(pairs([scan.time for scan in scans]))
    distances = []
    for i, j in couples[:: max(1, len(couples) // 12)]:
        chosen = rng.permutation(len(scans[i].points))[:_SAMPLE]
        distances.append(np.abs(_compared(lidar, scans[i], scans[j], chosen, poses, np.zeros(4)).residual))
    known = np.concatenate(distances) if distances else np.zeros(0)
    return float(np.median(known)) if len(known) else np.nan


def _compared(lidar: Lidar, one: Scan, other: Scan, chosen: np.ndarray, poses: Poses, parameters: Parameters) -> Pair:
    """Distances of points of one scan from planes of the other, and how they change with the parameters."""
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
    """A residual [n] and its slopes by central differences; rows that are unknown anywhere are left out."""
    steps = np.diag(STEPS[: len(parameters)])
    slopes = [(residual(parameters + s) - residual(parameters - s)) / (2 * s.sum()) for s in steps]
    value, slope = residual(parameters), np.stack(slopes, axis=1)
    known = np.isfinite(value) & np.isfinite(slope).all(axis=1)
    return Pair(value[known], slope[known])


def planes(
    points: Float[np.ndarray, "n 3"], tree: cKDTree, at: Float[np.ndarray, "m 3"]
) -> tuple[Float[np.ndarray, "m 3"], Bool[np.ndarray, " m"]]:
    """Unit normals of the neighbours of some places, and where these do lie in a plane and not along one ring."""
    if len(points) < _NEIGHBOURS or not len(at):
        return np.zeros((len(at), 3)), np.zeros(len(at), dtype=bool)
    distance, index = tree.query(at, k=_NEIGHBOURS)
    near = points[index] - points[index].mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("mki,mkj->mij", near, near) / _NEIGHBOURS)
    flat = (spread[:, 0] < 0.1 * spread[:, 1]) & (spread[:, 1] > 0.04 * spread[:, 2]) & (spread[:, 0] < 0.05**2)
    return axes[:, :, 0], flat & (distance[:, -1] < 2.0)
