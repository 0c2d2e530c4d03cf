"""Masks of the vehicle itself in its cameras' images, which must not pass for ground."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool

from offpiste.core.errors import PerceptionError
from offpiste.logs.measurements import decoded_picture
from offpiste.perception.patch_grid import PatchGrid

MOST_OF_A_PATCH = 0.1
"""Largest share of the vehicle itself in a patch that is used."""


def mask_from_png(path: Path, width: int, height: int) -> Bool[np.ndarray, "height width"]:
    """Mask of the vehicle itself from a picture of the camera's size [px]: any colour but black.

    Raises:
        PerceptionError: no such picture, or one of another size.
    """
    content = np.fromfile(path, dtype=np.uint8) if path.is_file() else np.empty(0, np.uint8)
    picture = decoded_picture(content, grey=True)
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
    """Mask of the pixels inside polygons, whose corners (x, y) may lie outside the image [px].

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
    """Patches that show the world, not the vehicle itself."""
    return grid.share(own) <= MOST_OF_A_PATCH
