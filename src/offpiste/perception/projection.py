"""Projection of LiDAR points into the patches of camera images.

Points are given in the world frame, each by the vehicle's pose at its own moment
(`offpiste.perception.motion_compensation`); every image has the pose of its own stamp. The motion between scan and
image, and within the scan, is compensated as far as poses are right and the world is static.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from offpiste.core.errors import PerceptionError
from offpiste.native.compilation import FUSED_PROJECTION, PROJECTION
from offpiste.perception.camera import PinholeCamera
from offpiste.perception.motion_compensation import inverse
from offpiste.perception.occlusion import occluded_points
from offpiste.rig.camera import CameraModel

NEAREST = 0.2
"""Least distance of projected points from the plane of the pinhole [m]."""


@dataclass(frozen=True)
class CameraView:
    """A camera at the moment of one of its images.

    Attributes:
        time: of the image [s].
        world_from_camera: at that time.
    """

    camera: PinholeCamera
    time: float
    world_from_camera: Float[np.ndarray, "4 4"]


@dataclass(frozen=True)
class ProjectionSettings:
    """Settings of the projection.

    Attributes:
        rule: for points that several images show: "centre" takes the image whose optical axis passes nearest, in
            angle, where a lens is sharpest and rectification stretches least; "newest" the one taken last, and of
            those taken together the first.
        reach: half of the angle within which nearer points occlude a point [deg]: about the spacing of a LiDAR's rings.
        relative, absolute: how much nearer they have to be: relative * depth + absolute [m].
        occlusion: whether occluded points are dropped.
    """

    rule: Literal["centre", "newest"] = "centre"
    reach: float = 1.0
    relative: float = 0.06
    absolute: float = 0.3
    occlusion: bool = True

    def __post_init__(self) -> None:
        if not (0 < self.reach < 20 and 0 <= self.relative < 1 and self.absolute >= 0):
            raise PerceptionError(
                f"reach {self.reach} deg, relative {self.relative}, absolute {self.absolute} m",
                where="projection settings",
                how="give a reach of 0 to 20 degrees and tolerances from 0 on",
            )


@dataclass(frozen=True)
class Projection:
    """Image, pixel and patch of each of n points.

    Attributes:
        view: index of the view that shows the point; -1 where none does.
        pixel: x, y in that rectified image [px]; NaN where none.
        row, column: of the patch that the pixel lies in; 0 where none.
        distance: of the point from that camera [m]; NaN where none.
    """

    view: Int[np.ndarray, " n"]
    pixel: Float[np.ndarray, "n 2"]
    row: Int[np.ndarray, " n"]
    column: Int[np.ndarray, " n"]
    distance: Float[np.ndarray, " n"]

    @property
    def seen(self) -> Bool[np.ndarray, " n"]:
        """Points that some view shows."""
        return self.view >= 0

    def gather(self, features: Sequence[Float[np.ndarray, "_ _ f"]]) -> Float[np.ndarray, "n f"]:
        """Features of the patch of each point; NaN where no view shows it.

        Args:
            features: one feature image for each view [rows, columns, f].
        """
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

    A view does not show points behind the camera, outside of its patches, on patches of the vehicle itself, behind
    something nearer (`occluded_points`), or points that are not finite.
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
        occluded = np.zeros(len(index), bool)
        if settings.occlusion:
            focal_length = float(model.matrix[0, 0])
            occluded = occluded_points(
                pixels,
                depth,
                model.size,
                reach=focal_length * np.tan(np.deg2rad(settings.reach)),
                relative=settings.relative,
                absolute=settings.absolute,
            )
        patches = (*(float(first) for first in grid.offset), float(grid.size))
        time = np.nan if settings.rule == "centre" else this.time
        keep_better(number, points, index, pixels, occluded, patches, this.camera.free, time, best, arrays)
    return out


def _in_image(
    points: Float[np.ndarray, "n 3"], pinhole: CameraModel
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 2"], Float[np.ndarray, " m"]]:
    """Indices of points that fall into an image, their places in it [px] and their depths [m]."""
    n = len(points)
    index, pixels, depth = np.empty(n, np.int64), np.empty((n, 2)), np.empty(n)
    count = put_pixels(points, pinhole.matrix, NEAREST, *pinhole.size, index, pixels, depth)
    return index[:count], pixels[:count], depth[:count]


def project_to_pinhole(
    points_camera: Float[np.ndarray, "n 3"], pinhole: CameraModel
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 2"]]:
    """Indices of the points that fall into an image without distortion, and their places in it [px]."""
    index, pixels, _ = _in_image(np.ascontiguousarray(points_camera, np.float64), pinhole)
    return index, pixels


# Loops over the points of a scan; they add in the order in which NumPy and BLAS do.


@FUSED_PROJECTION.entry
def put_in_camera(points, camera_from_world, result):  # type: ignore[no-untyped-def]
    """Move points by one transform.

    Args:
        points: [n, 3].
        camera_from_world: [4, 4].
        result: where they go [n, 3].
    """
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for axis in range(3):
            row = camera_from_world[axis]
            result[i, axis] = (x * row[0] + y * row[1] + z * row[2]) + row[3]


@PROJECTION.entry
def put_pixels(points, matrix, nearest, width, height, index, pixels, depth):  # type: ignore[no-untyped-def]
    """Put the pixels of the points that fall into an image; returns how many do.

    Args:
        points: in the camera's frame [n, 3].
        matrix: K of the pinhole [3, 3].
        nearest: least depth [m].
        width, height: of the image [px].
        index: numbers of those points [n, or less used].
        pixels, depth: of those points [n, 2], [n].
    """
    count = 0
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if not z > nearest:  # nor what is not a number
            continue
        across = matrix[0, 0] * x / z + matrix[0, 1] * y / z + matrix[0, 2]
        down = matrix[1, 1] * y / z + matrix[1, 2]
        if across > -0.5 and across < width - 0.5 and down > -0.5 and down < height - 0.5:
            index[count], pixels[count, 0], pixels[count, 1], depth[count] = i, across, down, z
            count += 1
    return count


@PROJECTION.entry
def keep_better(number, points, index, pixels, occluded, patches, free, time, best, out):  # type: ignore[no-untyped-def]
    """Let a view show those points that it shows better than the views before it.

    Args:
        number: of the view.
        points: in the camera's frame [n, 3].
        index, pixels: of those that fall into the image [m], [m, 2].
        occluded: which of them are not seen [m].
        patches: x, y of the first patch, and side of a patch [px].
        free: patches that show the world [rows, columns].
        time: of the image, where the newest is the best; not a number where the most central is.
        best: cost of what shows each point so far [n].
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
        cost = -time if time == time else -z / far
        if cost < best[i]:
            best[i], shown[i], distance[i] = cost, number, far
            pixel[i, 0], pixel[i, 1], patch_row[i], patch_column[i] = across, down, r, c


@PROJECTION.entry
def gather_features(number, shown, row, column, image, out):  # type: ignore[no-untyped-def]
    """Put the features of the patches of the points that a view shows [n, F]; others are left as they are."""
    for i in range(len(shown)):
        if shown[i] == number:
            for k in range(image.shape[2]):
                out[i, k] = image[row[i], column[i], k]
