"""Occlusion of sparse LiDAR points in a camera's view.

A z-buffer alone would let occluded points through between sparse points of the occluder, and one with larger cells
would drop ground up a slope behind nearer ground. A point counts as occluded if nearer points surround it: within a
small window, no gap between their directions is wider than `FREE` sectors. Nearer points of a plane all lie on one
side, so a plane never occludes itself. After Pintus et al., "Real-time rendering of massive unstructured raw point
clouds using screen-space operators", VAST 2011.
"""

from functools import cache
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float, UInt8

from offpiste.native.compilation import OCCLUSION

SECTORS: Final = 8
FREE: Final = 2
"""Widest gap between nearer points that still occludes a point [sectors]."""


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
    _put_nearest(np.ascontiguousarray(pixels), np.ascontiguousarray(depth), cell, row, column, nearest)
    window = max(1, int(np.ceil(reach / cell)))
    return np.asarray(_surrounded(nearest, row, column, depth, window, _sectors(window), relative, absolute))


@cache
def _sectors(window: int) -> UInt8[np.ndarray, "k k"]:
    """Return the sector of each cell of the window."""
    y, x = np.mgrid[-window : window + 1, -window : window + 1]
    return (np.round(np.arctan2(y, x) / (2 * np.pi) * SECTORS).astype(np.int64) % SECTORS).astype(np.uint8)


def _surrounded_loop(  # type: ignore[no-untyped-def]
    nearest, row, column, depth, window, sectors, relative, absolute
) -> Any:
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


def _put_nearest_loop(pixels, depth, cell, row, column, nearest) -> None:  # type: ignore[no-untyped-def]
    """Write the cell of each point and the smallest depth in each cell."""
    height, width = nearest.shape
    for i in range(len(depth)):
        column[i] = min(max(np.int64(np.floor((pixels[i, 0] + 0.5) / cell)), 0), width - 1)
        row[i] = min(max(np.int64(np.floor((pixels[i, 1] + 0.5) / cell)), 0), height - 1)
        nearest[row[i], column[i]] = min(nearest[row[i], column[i]], depth[i])


_put_nearest = OCCLUSION.entry(_put_nearest_loop)
_surrounded = OCCLUSION.entry(_surrounded_loop)
