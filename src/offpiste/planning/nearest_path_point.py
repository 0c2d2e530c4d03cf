"""Nearest point of a path to each cell of a grid, and what the path holds there: compiled."""

import numpy as np
from jaxtyping import Float, Float32

from offpiste.compilation import PLANNING
from offpiste.threads import spread_kernel

BLOCK = 4
"""Side of a block [cells]; far from the path, its cells share their nearest point."""

NEAR = 6
"""Distance from the path at which blocks are far [sides of a block]. There a point half a diagonal beside the nearest
is 0.17 cells further; where another bend is as near, less than a diagonal."""

STRIDE = 8
"""Spacing of the points that are compared first [points]."""


def along_path(
    path: Float[np.ndarray, "P 2"],
    values: Float32[np.ndarray, "P V"],
    x: Float[np.ndarray, " nx"],
    y: Float[np.ndarray, " ny"],
) -> Float32[np.ndarray, "ny nx 1+V"]:
    """Distance to the nearest point of a path [m], and its values: near the path exact, else from the middle of blocks.

    Args:
        path: two points at least; quick where they are evenly spaced.
        x, y: of the columns and rows of cells, evenly spaced [m].
    """
    result = np.empty((len(y), len(x), 1 + values.shape[1]), np.float32)
    slack = STRIDE * float(np.linalg.norm(np.diff(path, axis=0), axis=1).max())
    resolution = float(x[1] - x[0]) if len(x) > 1 else 0.0
    spread_kernel(-(-len(y) // BLOCK), _fill, np.ascontiguousarray(path), values, slack, x, y, resolution, result)
    return result


@PLANNING.inlined
def _nearest(px: float, py: float, path: np.ndarray, begin: int, end: int, stride: int) -> tuple[int, float]:
    """Index of the nearest of every `stride`-th point, and its squared distance."""
    best, least = begin, np.inf
    for k in range(begin, end, stride):
        dx, dy = path[k, 0] - px, path[k, 1] - py
        squared = dx * dx + dy * dy
        if squared < least:
            best, least = k, squared
    return best, least


@PLANNING.inlined
def _within(px: float, py: float, path: np.ndarray, reach: float) -> tuple[int, int]:
    """Range of points in the strides that begin within reach."""
    begin, end = len(path), 0
    for k in range(0, len(path), STRIDE):
        dx, dy = path[k, 0] - px, path[k, 1] - py
        if dx * dx + dy * dy <= reach * reach:
            begin, end = min(begin, k), k + STRIDE
    return begin, min(end, len(path))


@PLANNING.entry
def _fill(
    first: int,
    last: int,
    path: np.ndarray,
    values: np.ndarray,
    slack: float,
    x: np.ndarray,
    y: np.ndarray,
    resolution: float,
    result: np.ndarray,
) -> None:
    """Fill rows of blocks `first` ... `last - 1`.

    Args:
        slack: largest distance of a point from where its stride begins [m].
    """
    half = (BLOCK - 1) / 2 * resolution
    for row in range(first, last):
        for column in range(0, len(x), BLOCK):
            px, py = x[column] + half, y[row * BLOCK] + half
            distance = np.sqrt(_nearest(px, py, path, 0, len(path), STRIDE)[1])
            near = distance < NEAR * BLOCK * resolution
            # A cell lies up to sqrt(2) half beside the middle, and what is nearest to it as far again.
            begin, end = _within(px, py, path, distance + slack + (3 * half if near else 0.0))
            best, _ = _nearest(px, py, path, begin, end, 1)
            for j in range(row * BLOCK, min((row + 1) * BLOCK, len(y))):
                for i in range(column, min(column + BLOCK, len(x))):
                    if near:
                        best, squared = _nearest(x[i], y[j], path, begin, end, 1)
                    else:
                        squared = (path[best, 0] - x[i]) ** 2 + (path[best, 1] - y[j]) ** 2
                    result[j, i, 0] = np.sqrt(squared)
                    for v in range(values.shape[1]):
                        result[j, i, 1 + v] = values[best, v]
