"""Do edges of depth fall on edges of the image? Extrinsics and stamps that are right make them.

After Levinson and Thrun, "Automatic Online Calibration of Cameras and Lasers", RSS 2013, section III.
"""

from typing import Final

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

_CELL: Final = np.deg2rad(0.35)
"""Of the range image: the spacing of a LiDAR's columns or a little more [rad]."""
_APART: Final = 3
"""Neighbours are looked for as far as so many cells to either side: where no echo came back, there is none."""


def depth_edges(points_lidar: Float[np.ndarray, "n 3"], *, least: float = 1.0) -> Float[np.ndarray, " n"]:
    """How far each point stands before what is seen left or right of it, the square root of metres; 0 for most.

    Edges belong to the nearer side, and only edges across the turning direction count: along it a LiDAR is dense.

    Args:
        points_lidar: one scan in its sensor's frame.
        least: smaller steps are no edge [m].
    """
    distance = np.linalg.norm(points_lidar, axis=1)
    azimuth = np.arctan2(points_lidar[:, 1], points_lidar[:, 0])
    elevation = np.arcsin(np.clip(points_lidar[:, 2] / np.maximum(distance, 1e-9), -1, 1))
    columns = int(np.round(2 * np.pi / _CELL))
    column = np.floor(azimuth / (2 * np.pi) * columns).astype(np.int64) % columns
    row = np.floor((elevation + np.pi / 2) / _CELL).astype(np.int64)
    image = np.full((int(row.max(initial=0)) + 1, columns), np.nan)
    image[row, column] = distance
    step = np.zeros(len(distance))
    for side in (-1, 1):
        beside = np.full(len(distance), np.nan)
        for away in range(_APART, 0, -1):
            found = image[row, (column + side * away) % columns]
            beside = np.where(np.isfinite(found), found, beside)
        step = np.fmax(step, beside - distance)
    return np.sqrt(np.where(step > least, step, 0.0))


def image_edges(image: UInt8[np.ndarray, "h w 3"], *, blur: float = 2.0) -> Float32[np.ndarray, "h w"]:
    """How near each pixel is to upright edges of brightness, 1 on average.

    Args:
        blur: over which edges are felt [px].
    """
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.5)
    # Relative to the contrast around it: an edge in the shadow counts like one in the sun.
    gradient = np.abs(cv2.Sobel(smooth, cv2.CV_32F, 1, 0))
    gradient /= cv2.GaussianBlur(gradient, (0, 0), 40.0) + 0.5
    felt = cv2.GaussianBlur(gradient, (0, 0), blur)
    return np.asarray(felt / felt.mean(), np.float32)


def edge_score(
    edges: Float32[np.ndarray, "h w"], pixels: Float[np.ndarray, "n 2"], strength: Float[np.ndarray, " n"]
) -> float:
    """Mean of the image's edges at the points' pixels, weighted by their depth edges: 1 by chance, more if they agree.

    NaN without a depth edge.
    """
    used = strength > 0
    column, row = np.rint(pixels[used]).astype(np.int64).T
    total = strength[used].sum()
    return float((edges[row, column] * strength[used]).sum() / total) if total > 0 else float("nan")
