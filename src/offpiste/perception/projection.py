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
from jaxtyping import Bool, Float, Int

from offpiste.core.errors import PerceptionError
from offpiste.native.library import compiled
from offpiste.perception.camera import PinholeCamera
from offpiste.perception.motion_compensation import inverse
from offpiste.rig.camera import CameraModel

SECTORS: Final = 8
FREE: Final = 2  # widest gap between nearer points that still occludes a point [sectors]
NEAREST = 0.2  # smallest depth of projected points [m]
_CELL: Final = 2  # size of a cell of the z-buffer [px]


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
            shown = np.flatnonzero(self.view == number)
            place = self.row[shown] * image.shape[1] + self.column[shown]
            result[shown] = image.reshape(-1, image.shape[2]).take(place, axis=0)
        return result


@np.errstate(invalid="ignore", over="ignore", divide="ignore")  # of points that are not finite
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
    best, world = np.full(n, np.inf), np.asarray(points_world, np.float64).T
    for number, this in enumerate(views):
        model, grid, free = this.camera.model, this.camera.grid, this.camera.free
        camera_from_world = inverse(this.world_from_camera)
        points = camera_from_world[:3, :3] @ world + camera_from_world[:3, 3:]
        index, pixels = project_to_pinhole(points.T, model)
        x, y, z = points.take(index, axis=1)
        visible = ~occluded_points(
            pixels,
            z,
            model.size,
            reach=float(model.matrix[0, 0]) * np.tan(np.deg2rad(settings.reach)),
            relative=settings.relative,
            absolute=settings.absolute,
        )
        column, row = np.floor((pixels.T + 0.5 - np.array(grid.offset)[:, None]) / grid.size).astype(np.int64)
        visible &= (column >= 0) & (row >= 0) & (column < free.shape[1]) & (row < free.shape[0])
        visible[visible] = free[row[visible], column[visible]]
        distance = np.sqrt((x * x + y * y) + z * z)
        cost = -z / distance
        better = np.flatnonzero(visible & (cost < best[index]))
        chosen = index[better]
        best[chosen], out.view[chosen], out.distance[chosen] = cost[better], number, distance[better]
        out.pixel[chosen, 0], out.pixel[chosen, 1] = pixels.T.take(better, axis=1)
        out.row[chosen], out.column[chosen] = row[better], column[better]
    return out


def project_to_pinhole(
    points_camera: Float[np.ndarray, "n 3"], pinhole: CameraModel
) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m 2"]]:
    """Return indices and pixels of the points inside an image without distortion."""
    points, matrix, (width, height) = np.asarray(points_camera, np.float64).T, pinhole.matrix, pinhole.size
    ahead = np.flatnonzero(points[2] > NEAREST)  # also drops NaN
    x, y, z = points.take(ahead, axis=1)  # several times faster than an index
    across = matrix[0, 0] * x / z + matrix[0, 1] * y / z + matrix[0, 2]
    down = matrix[1, 1] * y / z + matrix[1, 2]
    inside = np.flatnonzero((across > -0.5) & (across < width - 0.5) & (down > -0.5) & (down < height - 0.5))
    return ahead[inside], np.stack((across[inside], down[inside])).T


def occluded_points(
    pixels: Float[np.ndarray, "n 2"],
    depth: Float[np.ndarray, " n"],
    size: tuple[int, int],
    *,
    reach: float,
    relative: float = 0.06,
    absolute: float = 0.3,
) -> Bool[np.ndarray, " n"]:
    """Return the mask of occluded points.

    Args:
        pixels: x, y of points inside the image [px].
        depth: along the optical axis, positive [m].
        size: width and height of the image [px].
        reach: half of the window with occluding points, about the spacing of a LiDAR's rings [px].
        relative, absolute: occluding points are nearer by more than relative * depth + absolute [m].
    """
    if not len(pixels):
        return np.zeros(0, dtype=bool)
    window = _window(max(1, int(np.ceil(reach / _CELL))))
    rows, columns = window.shape
    width, height = (length // _CELL + 1 for length in size)
    # An empty margin, so that no window leaves the z-buffer.
    nearest = np.full((height + rows - 1, width + columns - 1), np.inf)
    last = np.array([[width - 1], [height - 1]])
    column, row = np.clip(np.floor((pixels.T + 0.5) / _CELL).astype(np.int64), 0, last)
    first = row * nearest.shape[1] + column
    np.minimum.at(nearest.reshape(-1), first + rows // 2 * (nearest.shape[1] + 1), depth)
    found = np.empty(len(depth), np.int64)
    limit = depth - (relative * depth + absolute)
    find_nearer(nearest, nearest.shape[1], first, limit, len(depth), window, rows, columns, found)
    return _SURROUNDED[found]


_CELLS: Final = 8
"""Cells of a z-buffer that a processor compares at once."""
_ALL: Final = 2**SECTORS - 1
"""Bits of all sectors."""


@cache
def _window(reach: int) -> Int[np.ndarray, "k m"]:
    """Return the bit of each cell's sector, those of all sectors at the centre, and 0 where a cell is too far away.

    Args:
        reach: radius of the window [cells].
    """
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    sector = np.round(np.arctan2(y, x) / (2 * np.pi) * SECTORS).astype(np.int64) % SECTORS
    bits = np.where(x * x + y * y <= reach * reach, 1 << sector, 0)
    bits[reach, reach] = _ALL
    return np.pad(bits, ((0, 0), (0, -len(bits) % _CELLS)))


def _surrounded(bits: int) -> bool:
    """Return whether no gap between sectors is too wide, given the bits of those with nearer points."""
    around = bits | bits << SECTORS
    wide = (1 << FREE + 1) - 1
    return all(around >> first & wide for first in range(SECTORS))


_SURROUNDED: Final = np.array([_surrounded(bits) for bits in range(_ALL + 1)])


@compiled("f8", int, "i8", "f8", int, "i8", int, int, "i8")
def find_nearer(nearest, stride, first, limit, count, window, rows, columns, found):  # type: ignore[no-untyped-def]
    """Write the bits of all cells in the windows of points that are nearer than a limit.

    Args:
        nearest: z-buffer, whose rows have `stride` cells [m].
        first: first cell of the window of each of `count` points in `nearest`.
        limit: of each point [m].
        window: bits of each cell [rows, columns].
        found: output [count].
    """
    found[:] = 0
    for row, column in np.argwhere(window):
        nearer = nearest.reshape(-1)[first + (row * stride + column)] < limit
        found[nearer] |= window[row, column]
