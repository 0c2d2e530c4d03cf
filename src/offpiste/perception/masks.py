"""What sensors see of their own vehicle, and must not take for ground: pixels of cameras, points of LiDARs."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float

from offpiste.errors import PerceptionError
from offpiste.perception.patch_grid import PatchGrid

MOST_OF_A_PATCH = 0.1
"""A patch with a larger share of the vehicle's own body is not used."""


def mask_from_png(path: Path, width: int, height: int) -> Bool[np.ndarray, "height width"]:
    """The vehicle's own body, painted in any colour but black in a picture of a camera's size [px].

    Raises:
        PerceptionError: no such picture, or one of another size.
    """
    content = np.fromfile(path, dtype=np.uint8) if path.is_file() else np.empty(0, np.uint8)
    picture = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE) if len(content) else None
    if picture is None:
        raise PerceptionError("no picture to mask a camera with", where=path, how="give a PNG of the camera's size")
    if picture.shape != (height, width):
        raise PerceptionError(
            f"a mask of {picture.shape[1]}x{picture.shape[0]} for a camera of {width}x{height}",
            where=path,
            how="paint it on an image of that camera",
        )
    return picture > 0


def mask_from_polygons(
    polygons: Sequence[Sequence[tuple[float, float]]], width: int, height: int
) -> Bool[np.ndarray, "height width"]:
    """The pixels inside polygons, whose corners (x, y) may lie outside the image [px].

    Raises:
        PerceptionError: a polygon of fewer than three corners.
    """
    mask = np.zeros((height, width), dtype=np.uint8)
    for polygon in polygons:
        if len(polygon) < 3:
            raise PerceptionError(
                f"a mask's polygon of {len(polygon)} corners", how="give three corners (x, y) or more"
            )
        corners = np.rint(np.asarray(polygon, dtype=np.float64)).astype(np.int32)
        # Each polygon on its own: filled together, they would cancel out where they overlap.
        cv2.fillPoly(mask, [corners], 1)
    return mask.astype(bool)


def free_patches(own: Bool[np.ndarray, "height width"], grid: PatchGrid) -> Bool[np.ndarray, "rows columns"]:
    """Patches that show the world and not the vehicle itself."""
    return grid.share(own) <= MOST_OF_A_PATCH


def outside_body(
    points_body: Float[np.ndarray, "n 3"], low: tuple[float, float, float], high: tuple[float, float, float]
) -> Bool[np.ndarray, " n"]:
    """Points that do not lie in the box around the vehicle, in the body frame [m]; false for NaN."""
    inside = ((points_body >= np.array(low)) & (points_body <= np.array(high))).all(axis=1)
    return ~inside & np.isfinite(points_body).all(axis=1)


def within_range(points_lidar: Float[np.ndarray, "n 3"], nearest: float, furthest: float) -> Bool[np.ndarray, " n"]:
    """Points whose distance from the sensor lies between these [m]; false for NaN."""
    distance = np.linalg.norm(points_lidar, axis=1)
    return (distance >= nearest) & (distance <= furthest)
