"""Estimate of a camera's rotation from a rough guess, by features matched in pairs of its images, and poses.

Features (SIFT, Lowe 2004) do not depend on the mounting. The second direction of a feature must lie in the epipolar
plane of the first: translation determines two axes (the direction of travel in the image), rotation the third. All
rotations within 45 degrees of the guess are tried, and robust fits refine the best ones. Once image squares can be
found at the pixels predicted from LiDAR points, `camera.check_camera` refines the result.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from offpiste.calibration.misfit import LEAST_PAIRS, Misfit, Pair, Parameters, differentiated, fit_misfit, turned
from offpiste.calibration.samples import Grey, SmallCamera, pairs
from offpiste.logs.poses import Poses
from offpiste.perception.motion_compensation import inverse

_FEATURES: Final = 1500
"""Maximum number of features per image."""
_CONTRAST: Final = 0.01
"""Minimum contrast of a feature; OpenCV's default of 0.04 leaves few on sand."""
_RATIO: Final = 0.75
"""Maximum ratio of the distances to the best and the second-best feature (Lowe 2004)."""
_LEAST: Final = 15
"""Minimum number of matches in a pair."""
_BASELINE: Final = 0.3
"""Minimum baseline between two images [m]."""
_WIDE: Final = np.deg2rad(45.0)
"""Maximum rotation from the guess [rad]."""
_COARSE: Final = np.deg2rad(5.0)
"""Spacing of the candidate rotations [rad]."""
_SAMPLE: Final = 600
"""Number of matches used to compare rotations."""
_TRUNCATED: Final = np.deg2rad(1.0)
"""Truncation of a match's angle from its epipolar line [rad]."""
_STARTS: Final = 5
"""Maximum number of rotations from which the fit starts."""
_PRIOR: Final = np.array([*np.deg2rad([30.0, 30.0, 30.0]), 0.1])
"""Standard deviations of the prior of the fit to epipolar lines [rad, rad, rad, s]."""


@dataclass(frozen=True)
class Matches:
    """Directions of points matched in two images.

    Attributes:
        times: stamps of the two images [s].
        one, other: unit vectors in the camera's frame.
    """

    times: tuple[float, float]
    one: Float[np.ndarray, "n 3"]
    other: Float[np.ndarray, "n 3"]


def matched(camera: SmallCamera, images: Sequence[Grey]) -> list[Matches]:
    """Return the features shared by consecutive images; images that repeat the one before show no motion."""
    sift = cv2.SIFT.create(nfeatures=_FEATURES, contrastThreshold=_CONTRAST)
    mask = camera.free.astype(np.uint8) * 255
    from_pixels = np.linalg.inv(camera.rectifier.pinhole.matrix)

    @cache
    def features(number: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the directions of an image's features, and their descriptors."""
        points, described = sift.detectAndCompute(images[number].pixels, mask)
        rays = np.array([(*point.pt, 1.0) for point in points]).reshape(-1, 3) @ from_pixels.T
        return rays / np.linalg.norm(rays, axis=1, keepdims=True), described

    result = []
    for i, j in pairs([image.time for image in images]):
        if np.array_equal(images[i].pixels, images[j].pixels):
            continue
        (one, first), (other, second) = features(i), features(j)
        if min(len(one), len(other)) < _LEAST:
            continue
        best = cv2.BFMatcher().knnMatch(first, second, k=2)
        kept = [match[0] for match in best if len(match) == 2 and match[0].distance < _RATIO * match[1].distance]
        # Ambiguous features are dropped.
        claims = np.bincount([match.trainIdx for match in kept], minlength=len(other))
        index = np.array([(m.queryIdx, m.trainIdx) for m in kept if claims[m.trainIdx] == 1], np.int64).reshape(-1, 2)
        if len(index) >= _LEAST:
            result.append(Matches((images[i].time, images[j].time), one[index[:, 0]], other[index[:, 1]]))
    return result


def epipolar_angles(
    matches: Matches, body_from_camera: Float[np.ndarray, "4 4"], poses: Poses, parameters: Parameters
) -> Float[np.ndarray, " n"]:
    """Return angles of the second directions from the first ones' epipolar planes [rad]; NaN without a pose.

    For a point behind the cameras, this is the angle from the first direction, as without motion.
    """
    mounting = turned(body_from_camera, parameters)
    one, other = poses.at(np.array(matches.times) - parameters[3]) @ mounting
    relative = inverse(other) @ one
    return _angles(relative[None, :3, :3], relative[None, :3, 3], matches.one, matches.other)[0]


def _angles(
    turn: Float[np.ndarray, "k 3 3"],
    way: Float[np.ndarray, "k 3"],
    one: Float[np.ndarray, "n 3"],
    other: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "k n"]:
    here = one @ turn.transpose(0, 2, 1)
    way = way / np.linalg.norm(way, axis=1, keepdims=True)
    normal = np.cross(way[:, None], here)
    size = np.linalg.norm(normal, axis=2)
    angle = np.arcsin(np.clip(np.einsum("kni,ni->kn", normal, other) / (size + 1e-9), -1, 1))
    # Positive depth: the second direction departs from the first towards the translation, within their common plane.
    across = np.cross(here, other)
    ahead = np.einsum("kni,kni->kn", np.cross(other, way[:, None]), across) > 0
    moved = np.arcsin(np.clip(np.linalg.norm(across, axis=2), 0, 1))
    return np.where(ahead | (moved < np.deg2rad(0.2)), angle, np.copysign(np.maximum(moved, np.abs(angle)), angle))


def candidates(
    camera: Float[np.ndarray, "4 4"], matches: Sequence[Matches], poses: Poses, rng: np.random.Generator
) -> list[Parameters]:
    """Return at most `_STARTS` rotations from the guess that fit the matches best, with zero delay."""
    steps = np.arange(-_WIDE, _WIDE + 1e-6, _COARSE)
    turns = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    turns = turns[np.linalg.norm(turns, axis=1) <= _WIDE + 1e-6]
    mounting = np.tile(camera, (len(turns), 1, 1))
    mounting[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix() @ camera[:3, :3]
    camera_from_body = np.linalg.inv(mounting)
    cost = np.zeros(len(turns))
    few = matches[:: max(1, len(matches) // 12)]
    for one in few:
        pose = poses.at(np.array(one.times))
        relative = camera_from_body @ np.linalg.inv(pose[1]) @ pose[0] @ mounting
        chosen = rng.permutation(len(one.one))[: _SAMPLE // len(few)]
        angle = _angles(relative[:, :3, :3], relative[:, :3, 3], one.one[chosen], one.other[chosen])
        cost += np.minimum(np.abs(angle), _TRUNCATED).mean(axis=1)
    order: list[int] = []
    for k in np.argsort(cost):
        if all(np.linalg.norm(turns[k] - turns[m]) > 2.5 * _COARSE for m in order):
            order.append(int(k))
        if len(order) == _STARTS:
            break
    return [np.append(turns[k], 0.0) for k in order]


def estimate_rotation(
    guess: Float[np.ndarray, "4 4"], matches: Sequence[Matches], poses: Poses
) -> tuple[Float[np.ndarray, "4 4"], Misfit] | str:
    """Estimate a camera's mounting from image motion; return the reason as text if the drive does not determine it.

    Args:
        guess: `body_from_camera`; its rotation may be off by about 40 degrees.

    Returns:
        `body_from_camera` with the position of the guess, and the misfit of the fit, whose scale is an angle [rad].
    """
    moving = [one for one in matches if _baseline(one, poses) > _BASELINE]
    results = []
    for start in candidates(guess, moving, poses, np.random.default_rng(0)) if len(moving) >= LEAST_PAIRS else []:
        # Linearised near the candidate, so that large rotations remain rotations.
        mounting = turned(guess, start)

        def compare(now: Parameters, at: np.ndarray = mounting) -> list[Pair]:
            return [differentiated(partial(epipolar_angles, one, at, poses), now) for one in moving]

        misfit = fit_misfit(compare, prior=_PRIOR, rounds=10)
        if misfit is not None:
            results.append((turned(mounting, misfit.parameters), misfit))
    if not results:
        return "too few pairs of its images share features while the vehicle moves"
    return min(results, key=lambda one: _cost(moving, one[0], poses, one[1].parameters[3]))


def median_angle(matches: Sequence[Matches], mounting: Float[np.ndarray, "4 4"], poses: Poses) -> float:
    """Return the median angle of matches from their epipolar planes [rad]; NaN without matches."""
    angles = [epipolar_angles(one, mounting, poses, np.zeros(4)) for one in matches]
    return float(np.nanmedian(np.abs(np.concatenate(angles)))) if angles else np.nan


def _cost(matches: Sequence[Matches], mounting: Float[np.ndarray, "4 4"], poses: Poses, late: float) -> float:
    angles = [epipolar_angles(one, mounting, poses, np.array([0.0, 0.0, 0.0, late])) for one in matches]
    return float(np.nanmean(np.minimum(np.abs(np.concatenate(angles)), _TRUNCATED)))


def _baseline(matches: Matches, poses: Poses) -> float:
    place = poses.at(np.array(matches.times))[:, :3, 3]
    distance = float(np.linalg.norm(place[1] - place[0]))
    return distance if np.isfinite(distance) else 0.0
