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

from offpiste.errors import PerceptionError
from offpiste.perception.camera import PinholeCamera
from offpiste.perception.motion_compensation import inverse, transformed
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
        for index, image in enumerate(features):
            mine = self.view == index
            result[mine] = image[self.row[mine], self.column[mine]]
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
    view, pixel, distance = np.full(n, -1), np.full((n, 2), np.nan), np.full(n, np.nan)
    row, column, best = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64), np.full(n, np.inf)
    for index, this in enumerate(views):
        points, model = transformed(points_world, inverse(this.world_from_camera)), this.camera.model
        result, at = project_to_pinhole(points, model)
        if settings.occlusion:
            focal_length = float(model.matrix[0, 0])
            occluded = occluded_points(
                at,
                points[result, 2],
                model.size,
                reach=focal_length * np.tan(np.deg2rad(settings.reach)),
                relative=settings.relative,
                absolute=settings.absolute,
            )
            result, at = result[~occluded], at[~occluded]
        r, c, inside = this.camera.grid.cells(at)
        inside &= this.camera.free[r, c]
        result, at, r, c = result[inside], at[inside], r[inside], c[inside]
        far = np.linalg.norm(points[result], axis=1)
        cost = -points[result, 2] / far if settings.rule == "centre" else np.full(len(result), -this.time)
        better = cost < best[result]
        chosen = result[better]
        best[chosen], view[chosen], distance[chosen] = cost[better], index, far[better]
        pixel[chosen], row[chosen], column[chosen] = at[better], r[better], c[better]
    return Projection(view, pixel, row, column, distance)


def project_to_pinhole(
    points_camera: Float[np.ndarray, "n 3"], pinhole: CameraModel
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 2"]]:
    """Indices of the points that fall into an image without distortion, and their places in it [px]."""
    matrix = pinhole.matrix
    ahead = np.flatnonzero(points_camera[:, 2] > NEAREST)  # false for NaN
    x, y, z = points_camera[ahead].T
    pixels = np.stack(
        (matrix[0, 0] * x / z + matrix[0, 1] * y / z + matrix[0, 2], matrix[1, 1] * y / z + matrix[1, 2]), axis=1
    )
    inside = ((pixels > -0.5) & (pixels < np.array(pinhole.size) - 0.5)).all(axis=1)
    return ahead[inside], pixels[inside]
