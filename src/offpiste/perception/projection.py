"""Projection of LiDAR points into the patches of camera images.

Points are motion-compensated to the world frame (`offpiste.perception.motion_compensation`), and each image has the
pose at its own stamp, so that motion within a scan and between scan and image cancels in a static world.

LiDAR points are sparse: a z-buffer alone would let occluded points through between those of the occluder, and one with
larger cells would drop ground up a slope behind nearer ground. A point counts as occluded if nearer points surround it:
within a small window, no gap between their directions is wider than `FREE` sectors. Nearer points of a plane all lie on
one side, so a plane never occludes itself. After Pintus et al., "Real-time rendering of massive unstructured raw point
clouds using screen-space operators", VAST 2011.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from offpiste.core.errors import PerceptionError
from offpiste.native.compilation import FUSED_PROJECTION, OCCLUSION, PROJECTION
from offpiste.perception.camera import PinholeCamera
from offpiste.perception.motion_compensation import inverse
from offpiste.rig.camera import CameraModel

SECTORS: Final = 8
FREE: Final = 2  # widest gap between nearer points that still occludes a point [sectors]
NEAREST = 0.2  # smallest depth of projected points [m]


@dataclass(frozen=True)
class CameraView:
    """Camera and its pose at the time of an image [s]."""

    camera: PinholeCamera
    time: float
    world_from_camera: Float[np.ndarray, "4 4"]


@dataclass(frozen=True)
class ProjectionSettings:
    """Settings of occlusion: nearer points within an angle occlude a point."""

    reach: float = 1.0  # half of that angle, about the spacing of a LiDAR's rings [deg]
    relative: float = 0.06  # occluding points are nearer by relative * depth + absolute [m]
    absolute: float = 0.3

    def __post_init__(self) -> None:
        if not (0 < self.reach < 20 and 0 <= self.relative < 1 and self.absolute >= 0):
            raise PerceptionError(
                f"reach {self.reach} deg, relative {self.relative}, absolute {self.absolute} m",
                where="projection settings",
                how="give a reach of 0 to 20 degrees and tolerances from 0 on",
            )


@dataclass(frozen=True)
class Projection:
    """Image, pixel and patch of each of n points."""

    view: Int[np.ndarray, " n"]  # index of the view that shows the point; -1 if none
    pixel: Float[np.ndarray, "n 2"]  # x, y in the rectified image [px]; NaN if not seen
    row: Int[np.ndarray, " n"]  # of the patch; 0 if not seen
    column: Int[np.ndarray, " n"]
    distance: Float[np.ndarray, " n"]  # from camera to point [m]; NaN if not seen

    @property
    def seen(self) -> Bool[np.ndarray, " n"]:
        """Points seen in a view."""
        return self.view >= 0

    def gather(self, features: Sequence[Float[np.ndarray, "_ _ f"]]) -> Float[np.ndarray, "n f"]:
        """Return the features of each point's patch, NaN if not seen, from a feature image per view."""
        result = np.full((len(self.view), features[0].shape[2]), np.nan, features[0].dtype)
        for number, image in enumerate(features):
            gather_features(number, self.view, self.row, self.column, image, result)
        return result


def project(
    points_world: Float[np.ndarray, "n 3"],
    views: Sequence[CameraView],
    settings: ProjectionSettings | None = None,
) -> Projection:
    """Project points into the images of several views.

    Of the views that see a point, the one whose optical axis passes nearest in angle is chosen. Points that are not
    finite, behind the camera, outside its free patches, or occluded (`occluded_points`) are not seen.
    """
    settings = settings or ProjectionSettings()
    n = len(points_world)
    out = Projection(np.full(n, -1), np.full((n, 2), np.nan), np.zeros(n, int), np.zeros(n, int), np.full(n, np.nan))
    arrays = (out.view, out.pixel, out.row, out.column, out.distance)
    best, points, world = np.full(n, np.inf), np.empty((n, 3)), np.ascontiguousarray(points_world, np.float64)
    for number, this in enumerate(views):
        model, grid = this.camera.model, this.camera.grid
        put_in_camera(world, inverse(this.world_from_camera), points)
        index, pixels, depth = _in_image(points, model)
        occluded = occluded_points(
            pixels,
            depth,
            model.size,
            reach=float(model.matrix[0, 0]) * np.tan(np.deg2rad(settings.reach)),
            relative=settings.relative,
            absolute=settings.absolute,
        )
        patches = (*(float(first) for first in grid.offset), float(grid.size))
        keep_better(number, points, index, pixels, occluded, patches, this.camera.free, best, arrays)
    return out


def _in_image(
    points: Float[np.ndarray, "n 3"], pinhole: CameraModel
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 2"], Float[np.ndarray, " m"]]:
    """Return indices, pixels and depths [m] of the points inside an image."""
    n = len(points)
    index, pixels, depth = np.empty(n, np.int64), np.empty((n, 2)), np.empty(n)
    count = put_pixels(points, pinhole.matrix, NEAREST, *pinhole.size, index, pixels, depth)
    return index[:count], pixels[:count], depth[:count]


def project_to_pinhole(
    points_camera: Float[np.ndarray, "n 3"], pinhole: CameraModel
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 2"]]:
    """Return indices and pixels of the points inside an image without distortion."""
    index, pixels, _ = _in_image(np.ascontiguousarray(points_camera, np.float64), pinhole)
    return index, pixels


# The loops over points add in the order of NumPy and BLAS.


@FUSED_PROJECTION.entry
def put_in_camera(points, camera_from_world, result):  # type: ignore[no-untyped-def]
    """Transform points [n, 3] by one matrix [4, 4] into `result` [n, 3]."""
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for axis in range(3):
            row = camera_from_world[axis]
            result[i, axis] = (x * row[0] + y * row[1] + z * row[2]) + row[3]


@PROJECTION.entry
def put_pixels(points, matrix, nearest, width, height, index, pixels, depth):  # type: ignore[no-untyped-def]
    """Write index, pixels and depth of the points inside an image, and return their number.

    Args:
        points: in the camera's frame [n, 3].
        nearest: smallest depth [m].
        width, height: of the image [px].
        index, pixels, depth: outputs [n], [n, 2], [n].
    """
    count = 0
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if not z > nearest:  # also skips NaN
            continue
        across = matrix[0, 0] * x / z + matrix[0, 1] * y / z + matrix[0, 2]
        down = matrix[1, 1] * y / z + matrix[1, 2]
        if across > -0.5 and across < width - 0.5 and down > -0.5 and down < height - 0.5:
            index[count], pixels[count, 0], pixels[count, 1], depth[count] = i, across, down, z
            count += 1
    return count


@PROJECTION.entry
def keep_better(number, points, index, pixels, occluded, patches, free, best, out):  # type: ignore[no-untyped-def]
    """Assign points to a view that sees them nearer to its axis than earlier views.

    Args:
        number: of the view.
        points: in the camera's frame [n, 3].
        index, pixels, occluded: of the points inside the image [m], [m, 2], [m].
        patches: x, y of the first patch, and side of a patch [px].
        free: usable patches [rows, columns].
        best: lowest cost of each point so far [n].
        out: arrays of `Projection`.
    """
    rows, columns = free.shape
    first_x, first_y, size = patches
    shown, pixel, patch_row, patch_column, distance = out
    for k in range(len(index)):
        if occluded[k]:
            continue
        across, down = pixels[k, 0], pixels[k, 1]
        column = np.floor((across + 0.5 - first_x) / size)
        row = np.floor((down + 0.5 - first_y) / size)
        if not (column >= 0 and row >= 0 and column < columns and row < rows):
            continue
        r, c, i = np.int64(row), np.int64(column), index[k]
        if not free[r, c]:
            continue
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        far = np.sqrt((x * x + y * y) + z * z)
        cost = -z / far
        if cost < best[i]:
            best[i], shown[i], distance[i] = cost, number, far
            pixel[i, 0], pixel[i, 1], patch_row[i], patch_column[i] = across, down, r, c


@PROJECTION.entry
def gather_features(number, shown, row, column, image, out):  # type: ignore[no-untyped-def]
    """Copy the features of the points that a view shows into `out` [n, F]."""
    for i in range(len(shown)):
        if shown[i] == number:
            for k in range(image.shape[2]):
                out[i, k] = image[row[i], column[i], k]


def occluded_points(
    pixels: Float[np.ndarray, "n 2"],
    depth: Float[np.ndarray, " n"],
    size: tuple[int, int],
    *,
    reach: float,
    cell: int = 2,
    relative: float = 0.06,
    absolute: float = 0.3,
) -> Bool[np.ndarray, " n"]:
    """Return the mask of occluded points.

    Args:
        pixels: x, y of points inside the image [px].
        depth: along the optical axis, positive [m].
        size: width and height of the image [px].
        reach: half of the window with occluding points, about the spacing of a LiDAR's rings [px].
        cell: size of a cell of the z-buffer [px].
        relative, absolute: occluding points are nearer by more than relative * depth + absolute [m].
    """
    if not len(pixels):
        return np.zeros(0, dtype=bool)
    width, height = (length // cell + 1 for length in size)
    row, column = np.empty((2, len(pixels)), np.int64)
    nearest = np.full((height, width), np.inf)
    put_nearest(np.ascontiguousarray(pixels), np.ascontiguousarray(depth), cell, row, column, nearest)
    window = max(1, int(np.ceil(reach / cell)))
    return np.asarray(surrounded(nearest, row, column, depth, window, _sectors(window), relative, absolute))


@cache
def _sectors(window: int) -> UInt8[np.ndarray, "k k"]:
    """Return the sector of each cell of the window."""
    y, x = np.mgrid[-window : window + 1, -window : window + 1]
    return (np.round(np.arctan2(y, x) / (2 * np.pi) * SECTORS).astype(np.int64) % SECTORS).astype(np.uint8)


@OCCLUSION.entry
def surrounded(nearest, row, column, depth, window, sectors, relative, absolute):  # type: ignore[no-untyped-def]
    """Return the mask of points that nearer points surround."""
    height, width = nearest.shape
    occluded = np.zeros(len(depth), np.bool_)
    for i in range(len(depth)):
        limit = depth[i] - (relative * depth[i] + absolute)
        if nearest[row[i], column[i]] < limit:
            occluded[i] = True
            continue
        taken = 0
        for dy in range(-window, window + 1):
            y = row[i] + dy
            if y < 0 or y >= height:
                continue
            for dx in range(-window, window + 1):
                x = column[i] + dx
                if 0 <= x < width and dx * dx + dy * dy <= window * window and nearest[y, x] < limit:
                    taken |= 1 << sectors[dy + window, dx + window]
        gap = 0
        widest = 0
        for k in range(2 * SECTORS):
            gap = 0 if taken >> (k % SECTORS) & 1 else gap + 1
            widest = max(widest, gap)
        occluded[i] = widest <= FREE
    return occluded


@OCCLUSION.entry
def put_nearest(pixels, depth, cell, row, column, nearest):  # type: ignore[no-untyped-def]
    """Write the cell of each point and the smallest depth in each cell."""
    height, width = nearest.shape
    for i in range(len(depth)):
        column[i] = min(max(np.int64(np.floor((pixels[i, 0] + 0.5) / cell)), 0), width - 1)
        row[i] = min(max(np.int64(np.floor((pixels[i, 1] + 0.5) / cell)), 0), height - 1)
        nearest[row[i], column[i]] = min(nearest[row[i], column[i]], depth[i])
