"""Estimates of a LiDAR's mounting and delay from the consistency of scan pairs.

Points of one scan are transformed by the poses into another; their distances from its planes (Chen and Medioni, 1992)
depend on the LiDAR's mounting while the vehicle moves or turns, and on its delay while it turns or changes speed.

A guess may be far off: roll and pitch then come from the mean ground normal over the drive, which is vertical in the
body frame, and yaw from scans some metres apart, which align only if the mounting's heading matches the direction of
travel; the full circle is searched. From the best headings, the fit to planes refines the result.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from offpiste.calibration.misfit import PRIOR, Misfit, Pair, Parameters, differentiated, fit_misfit, planes, turned
from offpiste.calibration.samples import FURTHEST, Grey, Scan, pairs
from offpiste.logs.measurements import Lidar
from offpiste.logs.poses import Poses

_SAMPLE: Final = 1500
"""Number of points per scan compared with planes of the other."""
_REACH: Final = 1.0
"""Search radius for a plane [m]: a few degrees at 20 m."""
GROUND: Final = np.deg2rad(1.0)
"""Standard deviation of the ground slope in the body frame, due to camber, load and suspension [rad]."""
_LEVEL: Final = np.cos(np.deg2rad(40.0))
"""Minimum vertical component of a ground normal under the guess."""
_THICK: Final = 0.1
"""Inlier distance of a plane [m]."""
_AROUND: Final = 15.0
"""Radius within which the ground is assumed planar [m]."""
_SHARE: Final = 0.25
"""Minimum share of ground points around the vehicle."""
_PLANES: Final = 200
"""Number of candidate planes per scan."""
_PATH: Final = (2.0, 8.0)
"""Range of distances driven between two scans used for the heading [m]."""
_COUPLES: Final = 8
"""Number of scan pairs used for the heading."""
_HEADINGS: Final = 72
"""Number of candidate headings over the full circle."""
_STARTS: Final = 3
"""Maximum number of headings from which the fit starts."""
_DISTINCT: Final = 0.5
"""Maximum cost of a candidate heading, as a share of the way from the minimum to the median."""
_TURNING: Final = np.deg2rad(3.0)
"""Minimum rotation between the scans of a pair that determines the LiDAR's position [rad]."""
_HELD: Final = 0.1
"""Share of its prior to which roll is held if the drive does not determine it."""
_TRUNCATED: Final = 1.0
"""Truncation of distances [m]."""
WORLD: Final = 0.2
"""Maximum distance of scans from each other's planes for a consistent world [m]; fault-free: 0.02 to 0.04."""
_RIVAL: Final = 1.15
"""Maximum residual ratio at which the second-best heading makes the result ambiguous."""
_FEW_PLANES: Final = "too few of its points lie on planes that two scans share"
_PRIOR: Final = np.array([GROUND, GROUND, np.deg2rad(30.0), 0.1, 0.5, 0.5])
"""Standard deviations of the fit's prior: roll and pitch about level, yaw, delay, position x and y [rad, s, m]."""


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
    usable = np.isfinite(here).all(axis=1) & (np.linalg.norm(one.points[chosen], axis=1) < FURTHEST)
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


def estimate_lidar(lidar: Lidar, scans: Sequence[Scan], poses: Poses) -> tuple[Float[np.ndarray, "4 4"], Misfit] | str:
    """Estimate a LiDAR's mounting from a rough guess; return the reason as text if the drive does not determine it.

    Args:
        lidar: with the guess, whose vertical must be correct to about 30 degrees; its heading is ignored.
        scans: without points of the vehicle itself, which the guess may not separate from others.

    Returns:
        `body_from_lidar` with the z position of the guess, and the misfit of the last fit, with sigma of roll, pitch,
        yaw [rad], delay [s], x and y [m].
    """
    rng = np.random.default_rng(0)
    normals = [n for scan in scans[:: max(1, len(scans) // 30)] if (n := ground(scan, lidar, rng)) is not None]
    levelled = len(normals) >= 5
    level = _levelled(lidar, np.array(normals)) if levelled else lidar
    couples = _couples(scans, poses)
    if len(couples) < 3:
        return "the vehicle hardly moves while it measures: its heading is not observable"
    fitted = [_fitted(level, heading, scans, poses) for heading in headings(level, scans, couples, poses, rng)]
    results = sorted((one for one in fitted if one is not None), key=lambda one: one[1].scale)
    if not results:
        return _FEW_PLANES
    (start, _), *others = results
    # Relative to the levelled mounting at the estimated heading, so that the prior keeps undetermined angles level.
    upright = _headed(level, start)
    misfit = _refined(upright, scans, poses, GROUND if levelled else np.deg2rad(30.0))
    if misfit is None:
        return _FEW_PLANES
    if misfit.scale > WORLD:
        return f"its scans do not fit together with any mounting ({misfit.scale:.2f} m apart)"
    apart = [m.scale for s, m in others if _between(s, start) > np.deg2rad(10)]
    if min(apart, default=np.inf) < _RIVAL * misfit.scale:
        return "another heading fits its scans as well; its surroundings look alike all around"
    return turned(upright.body_from_lidar, misfit.parameters), misfit


def ground(scan: Scan, lidar: Lidar, rng: np.random.Generator) -> Float[np.ndarray, " 3"] | None:
    """Return the ground normal in the LiDAR frame, upwards under the guess; None without a plane.

    RANSAC over planes through three random points (Fischler and Bolles, 1981), then principal axes of the inliers.
    """
    points = scan.points[np.linalg.norm(scan.points, axis=1) < _AROUND]
    if len(points) < 200:
        return None
    points = points[rng.permutation(len(points))[:3000]]
    corner = points[rng.integers(0, len(points), (_PLANES, 3))]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-12
    up = lidar.body_from_lidar[2, :3]
    normal *= np.sign(normal @ up)[:, None]
    offset = np.einsum("ni,ni->n", normal, corner[:, 0])
    # Level under the guess, and below the sensor.
    possible = (normal @ up > _LEVEL) & (offset < -0.2)
    if not possible.any():
        return None
    normal, offset = normal[possible], offset[possible]
    votes = (np.abs(points @ normal.T - offset) < _THICK).sum(axis=0)
    best = int(votes.argmax())
    if votes[best] < _SHARE * len(points):
        return None
    inside = points[np.abs(points @ normal[best] - offset[best]) < 2 * _THICK]
    axis = np.linalg.eigh(np.cov(inside.T))[1][:, 0]
    return np.asarray(axis * np.sign(axis @ up))


def headings(
    lidar: Lidar,
    scans: Sequence[Scan],
    couples: Sequence[tuple[int, int]],
    poses: Poses,
    rng: np.random.Generator,
) -> list[float]:
    """Return the most likely yaws of a levelled LiDAR, best first, at most `_STARTS` [rad]."""
    chosen = {i: rng.permutation(len(scans[i].points))[:600] for i, _ in couples}
    thinned = {j: rng.permutation(len(scans[j].points))[:5000] for _, j in couples}
    tried = np.linspace(-np.pi, np.pi, _HEADINGS, endpoint=False)
    cost = np.zeros(_HEADINGS)
    for k, yaw in enumerate(tried):
        parameters = np.array([0.0, 0.0, yaw, 0.0])
        for i, j in couples:
            there = scans[j].in_world(lidar.body_from_lidar, poses, parameters, thinned[j])
            here = scans[i].in_world(lidar.body_from_lidar, poses, parameters, chosen[i])
            there, here = (points[np.isfinite(points).all(axis=1)] for points in (there, here))
            if len(there) and len(here):
                distance, _ = cKDTree(there).query(here, distance_upper_bound=_TRUNCATED)
                cost[k] += float(np.minimum(distance, _TRUNCATED).mean())
    lowest = np.flatnonzero((cost <= np.roll(cost, 1)) & (cost <= np.roll(cost, -1)))
    floor, ceiling = float(cost.min()), float(np.median(cost))
    lowest = lowest[cost[lowest] < floor + _DISTINCT * (ceiling - floor)]
    return [float(tried[k]) for k in lowest[np.argsort(cost[lowest])][:_STARTS]]


def _fitted(
    level: Lidar, yaw: float, scans: Sequence[Scan], poses: Poses
) -> tuple[Float[np.ndarray, "4 4"], Misfit] | None:
    """Fit few pairs from a heading; return the mounting and its misfit."""
    start = turned(level.body_from_lidar, np.array([0.0, 0.0, yaw, 0.0]))
    few = [scan.kept(slice(None, None, max(1, len(scan.points) // 6000))) for scan in _some(scans)]
    misfit = check_lidar(replace(level, body_from_lidar=start), few, poses, prior=_PRIOR[:4], rounds=4)
    return None if misfit is None else (turned(start, misfit.parameters), misfit)


def _refined(upright: Lidar, scans: Sequence[Scan], poses: Poses, known: float) -> Misfit | None:
    """Fit all pairs, including the position if the vehicle turns; without turns, roll is taken from the ground.

    Args:
        known: prior standard deviation of roll and pitch [rad].
    """
    prior = np.concatenate(([known, known], _PRIOR[2:]))
    if mean_turn(poses, scans) > _TURNING:
        first = check_lidar(upright, scans, poses, prior=prior[:4])
        start = None if first is None else np.append(first.parameters, [0.0, 0.0])
        return None if first is None else check_lidar(upright, scans, poses, prior=prior, start=start)
    # A roll error shifts scans by roll times rotation, which is below the pose errors.
    prior[0] *= _HELD
    misfit = check_lidar(upright, scans, poses, prior=prior[:4])
    return None if misfit is None else replace(misfit, sigma=np.append(known, misfit.sigma[1:]))


def mean_turn(poses: Poses, measured: Sequence[Scan] | Sequence[Grey]) -> float:
    """Return the RMS rotation of the vehicle between the measurements of pairs [rad]; 0 without pairs."""
    times = [one.time for one in measured]
    couples = np.array(list(pairs(times))).reshape(-1, 2)
    pose = poses.at(np.array(times))[:, :3, :3]
    cosine = (np.einsum("nij,nij->n", pose[couples[:, 0]], pose[couples[:, 1]]) - 1) / 2
    angle = np.arccos(np.clip(cosine[np.isfinite(cosine)], -1, 1))
    return float(np.sqrt((angle**2).mean())) if len(angle) else 0.0


def _some(scans: Sequence[Scan]) -> list[Scan]:
    """Return scans of eight pairs spread over the drive."""
    couples = list(pairs([scan.time for scan in scans]))
    kept = {k for i, j in couples[:: max(1, len(couples) // 8)] for k in (i, j)}
    return [scans[k] for k in sorted(kept)]


def _couples(scans: Sequence[Scan], poses: Poses) -> list[tuple[int, int]]:
    """Return pairs of scans some metres apart along the path, spread over the drive."""
    if not scans:
        return []
    place = poses.at(np.array([scan.time for scan in scans]))[:, :2, 3]
    result = []
    for i in range(len(scans)):
        distance = np.linalg.norm(place[i + 1 : i + 6] - place[i], axis=1)
        fits = np.flatnonzero((distance > _PATH[0]) & (distance < _PATH[1]))
        if len(fits):
            result.append((i, i + 1 + int(fits[-1])))
    return result[:: max(1, len(result) // _COUPLES)][:_COUPLES]


def _levelled(lidar: Lidar, normals: Float[np.ndarray, "n 3"]) -> Lidar:
    """Rotate the guess by the smallest angle that makes the ground level.

    Args:
        normals: of the ground in several scans, in the LiDAR frame.
    """
    up = lidar.body_from_lidar[:3, :3] @ np.median(normals, axis=0)
    turn = Rotation.align_vectors([0.0, 0.0, 1.0], up)[0].as_rotvec()
    return replace(lidar, body_from_lidar=turned(lidar.body_from_lidar, np.append(turn, 0.0)))


def _headed(level: Lidar, mounting: Float[np.ndarray, "4 4"]) -> Lidar:
    """Rotate a levelled LiDAR about the vertical to the heading of a mounting."""
    relative = Rotation.from_matrix(mounting[:3, :3] @ level.body_from_lidar[:3, :3].T)
    yaw = relative.as_euler("ZYX")[0]
    return replace(level, body_from_lidar=turned(level.body_from_lidar, np.array([0.0, 0.0, yaw, 0.0])))


def _between(one: Float[np.ndarray, "4 4"], other: Float[np.ndarray, "4 4"]) -> float:
    """Return the angle between two mountings [rad]."""
    return float(Rotation.from_matrix(one[:3, :3].T @ other[:3, :3]).magnitude())
