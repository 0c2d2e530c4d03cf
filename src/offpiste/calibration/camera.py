"""Check of camera mounting and stamps: scan points must look alike in two images.

A small square on a surface, whose plane is known from a scan, is extracted from one image and warped into the other
with the assumed mounting and stamps. The shift that fits best (normalised cross-correlation, Lewis 1995) depends on
the mounting while the vehicle moves or turns, and on the delay while it turns, including on bumps.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from offpiste.calibration.misfit import PRIOR, Misfit, Pair, Parameters, differentiated, fit_misfit, planes, turned
from offpiste.calibration.samples import FURTHEST, Grey, Scan, SmallCamera, nearest_world, pairs
from offpiste.logs.measurements import Lidar
from offpiste.logs.poses import Poses
from offpiste.perception.motion_compensation import inverse, transformed
from offpiste.perception.projection import occluded_points, project_to_pinhole

_HALF: Final = 6
"""Half the side of a square [px]."""
_SEARCH: Final = 12
"""Search radius of a square [px]."""
_SQUARES: Final = 150
"""Maximum number of squares per image pair."""
_ALIKE: Final = 0.8
"""Minimum correlation of a match."""


def check_camera(
    camera: SmallCamera,
    images: Sequence[Grey],
    lidar: Lidar,
    scans: Sequence[Scan],
    poses: Poses,
    lidar_parameters: Parameters | None = None,
    *,
    prior: Parameters = PRIOR,
    start: Parameters | None = None,
) -> Misfit | None:
    """Estimate the errors of a camera's mounting and stamps; None with too few usable images.

    Args:
        lidar, scans: source of the depths.
        lidar_parameters: misfit of the LiDAR, used for correction.
        prior, start: as for `fit_misfit`; seven entries also estimate the position.
    """
    given = np.zeros(4) if lidar_parameters is None else lidar_parameters
    couples = []
    for i, j in pairs([image.time for image in images]):
        if not np.array_equal(images[i].pixels, images[j].pixels):  # otherwise it shows no motion
            world = nearest_world(scans, images[i].time, lidar.body_from_lidar, poses, given)
            couples.append((images[i], images[j], world))

    def compare(parameters: Parameters) -> list[Pair]:
        return [_compared(camera, one, other, world, poses, parameters) for one, other, world in couples]

    return fit_misfit(compare, prior=prior, start=start)


def _compared(
    camera: SmallCamera, one: Grey, other: Grey, world: Float[np.ndarray, "n 3"], poses: Poses, parameters: Parameters
) -> Pair:
    """Return the residual shifts of squares, x and y [px], and their Jacobian."""
    matrix = camera.rectifier.pinhole.matrix

    def views(now: Parameters) -> np.ndarray:
        """Return `world_from_camera` of both images; NaN without a pose."""
        moments = np.array([one.time, other.time]) - now[3]
        return np.asarray(poses.at(moments) @ turned(camera.camera.body_from_camera, now))

    first, second = views(parameters)
    if not np.isfinite(first + second).all() or len(world) < 100:
        return Pair(np.zeros(0), np.zeros((0, len(parameters))))
    points, at = _squares(camera, one, world, first)
    normal, flat = planes(world, cKDTree(world), points)
    points, at, normal = points[flat], at[flat], normal[flat]
    shift, same = _shifts(one, other, at, _Mapping(matrix, first, second, points, normal))
    points, normal, shift = points[same], normal[same], shift[same]
    back = _Mapping(matrix, second, first, points, normal)

    def residual(now: Parameters) -> np.ndarray:
        # Project the points into both cameras; the second projection is mapped back to the first image.
        here, there = (_pixels(matrix, view, points) for view in views(now))
        return (shift - (back(there[:, None])[:, 0] - here)).ravel()

    return differentiated(residual, parameters)


@dataclass(frozen=True)
class _Mapping:
    """Mapping between two images by planes in the world, one plane per square."""

    matrix: Float[np.ndarray, "3 3"]
    world_from_one: Float[np.ndarray, "4 4"]
    world_from_other: Float[np.ndarray, "4 4"]
    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]

    def __call__(self, pixels: Float[np.ndarray, "n k 2"]) -> Float[np.ndarray, "n k 2"]:
        """Return pixels in the other image [px]; NaN if a plane is not visible."""
        rays = np.concatenate((pixels, np.ones((*pixels.shape[:2], 1))), axis=2)
        rays = rays @ (self.world_from_one[:3, :3] @ np.linalg.inv(self.matrix)).T
        origin = self.world_from_one[:3, 3]
        height = np.einsum("ni,ni->n", self.normals, self.points - origin)
        with np.errstate(divide="ignore", invalid="ignore"):
            far = height[:, None] / np.einsum("ni,nki->nk", self.normals, rays)
        far = np.where((far > 0) & (far < 1000), far, np.nan)
        world = origin + far[..., None] * rays
        return _pixels(self.matrix, self.world_from_other, world.reshape(-1, 3)).reshape(pixels.shape)


def _pixels(
    matrix: Float[np.ndarray, "3 3"], world_from_camera: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 2"]:
    """Project points with a pinhole camera [px]; NaN behind the camera."""
    seen = transformed(points, inverse(world_from_camera)) @ matrix.T
    depth = np.where(seen[:, 2:] > 0.1, seen[:, 2:], np.nan)
    return seen[:, :2] / depth


def _squares(
    camera: SmallCamera, image: Grey, world: Float[np.ndarray, "n 3"], world_from_camera: Float[np.ndarray, "4 4"]
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 2"]]:
    """Return visible points and their pixels: the most textured ones, spread over the image."""
    pinhole = camera.rectifier.pinhole
    points = transformed(world, inverse(world_from_camera))
    result, at = project_to_pinhole(points, pinhole)
    reach = float(pinhole.matrix[0, 0]) * np.tan(np.deg2rad(1.0))
    kept = ~occluded_points(at, points[result, 2], pinhole.size, reach=reach) & (points[result, 2] < FURTHEST)
    result, at = result[kept], at[kept]
    column, row = np.rint(at).astype(np.int64).T
    to_edge = (np.minimum(at, last - at) for at, last in ((column, pinhole.width - 1), (row, pinhole.height - 1)))
    inside = np.logical_and(*(pixels > _HALF for pixels in to_edge))
    inside &= camera.free[row, column]
    result, at, column, row = result[inside], at[inside], column[inside], row[inside]
    texture = cv2.cornerMinEigenVal(image.pixels, 2 * _HALF + 1, ksize=3)[row, column]
    order = np.argsort(-texture, kind="stable")
    # One per tile: overlapping squares carry the same information.
    _, firsts = np.unique((row // 16 * 10_000 + column // 16)[order], return_index=True)
    chosen = order[np.sort(firsts)[:_SQUARES]]
    return world[result[chosen]], at[chosen]


def _shifts(
    one: Grey, other: Grey, at: Float[np.ndarray, "n 2"], mapping: _Mapping
) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Return the shift of each square in the other image, in pixels of this one, and a mask of matches."""
    reach = _HALF + _SEARCH
    side = np.arange(-reach, reach + 1.0)
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    there = mapping(at[:, None] + grid)
    height, width = other.pixels.shape
    with np.errstate(invalid="ignore"):
        inside = ((there >= 0) & (there <= np.array([width - 1, height - 1]))).all(axis=(1, 2))
    shift = np.full((len(at), 2), np.nan)
    middle = grid.reshape(len(side), len(side), 2)[_SEARCH:-_SEARCH, _SEARCH:-_SEARCH].reshape(-1, 2)
    for index in np.flatnonzero(inside):
        template = _sampled(one, at[index] + middle)
        window = _sampled(other, there[index])
        if template.std() > 2.0:
            shift[index] = _peak(cv2.matchTemplate(window, template, cv2.TM_CCOEFF_NORMED))
    return shift, np.isfinite(shift).all(axis=1)


def _sampled(image: Grey, places: Float[np.ndarray, "k 2"]) -> np.ndarray:
    side = round(len(places) ** 0.5)
    column, row = np.ascontiguousarray(places.T, np.float32).reshape(2, side, side)
    return np.asarray(cv2.remap(image.pixels, column, row, cv2.INTER_LINEAR), np.float32)


def _peak(score: np.ndarray) -> Float[np.ndarray, " 2"]:
    """Return the offset of the best score from the centre, refined by a parabola [px]; NaN at the edge or if low."""
    row, column = np.unravel_index(int(score.argmax()), score.shape)
    top = score[row, column]
    if not (top > _ALIKE and 0 < row < len(score) - 1 and 0 < column < len(score) - 1):
        return np.full(2, np.nan)
    across, down = score[row, column - 1 : column + 2], score[row - 1 : row + 2, column]
    sides = [(line[0] - line[2]) / (2 * (line[0] - 2 * line[1] + line[2]) - 1e-9) for line in (across, down)]
    return np.array([column + sides[0], row + sides[1]], dtype=np.float64) - score.shape[0] // 2
