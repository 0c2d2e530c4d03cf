"""The first three components of a feature image as colours, beside the image it comes from (the paper's figure)."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from offpiste.files import write_whole
from offpiste.perception.patches import PatchGrid

PERCENTILES = (2.0, 98.0)
"""Of each component are drawn darkest and brightest."""


def colour_limits(
    components: Float[np.ndarray, "*P n"], mask: Bool[np.ndarray, "*P"] | None = None
) -> Float[np.ndarray, "2 3"]:
    """What is drawn darkest and brightest of each of the first three components.

    Args:
        components: of one image, or of all that are to be compared; NaN where there are none.
        mask: patches to judge by, e.g. ground.
    """
    chosen = components.reshape(-1, components.shape[-1]) if mask is None else components[mask]
    chosen = chosen[np.isfinite(chosen).all(axis=1), :3].astype(np.float64)
    limits = np.zeros((2, 3))
    if len(chosen):
        limits[:, : chosen.shape[1]] = np.percentile(chosen, PERCENTILES, axis=0)
    return limits


def colours(
    components: Float[np.ndarray, "*P n"], limits: Float[np.ndarray, "2 3"] | None = None
) -> UInt8[np.ndarray, "*P 3"]:
    """The first three components as RGB; grey for those that are lacking or constant, black where one is NaN."""
    low, high = colour_limits(components) if limits is None else limits
    values = np.zeros((*components.shape[:-1], 3))
    given = min(3, components.shape[-1])
    values[..., :given] = components[..., :given]
    known = np.isfinite(values).all(axis=-1, keepdims=True)
    width = high - low
    shade = np.where(width > 0, (np.where(known, values, 0.0) - low) / np.where(width > 0, width, 1.0), 0.5)
    return np.where(known, np.rint(255 * shade.clip(0, 1)), 0).astype(np.uint8)


def beside(
    image: UInt8[np.ndarray, "h w 3"], patches: UInt8[np.ndarray, "rows columns 3"], grid: PatchGrid
) -> UInt8[np.ndarray, "h w2 3"]:
    """An image and, right of it, its patches' colours in their places; the cropped edge is black."""
    right = np.zeros_like(image)
    right[grid.crop] = patches.repeat(grid.size, axis=0).repeat(grid.size, axis=1)
    return np.concatenate((image, right), axis=1)


def sheet(pictures: Sequence[UInt8[np.ndarray, "h w 3"]], *, columns: int = 2) -> UInt8[np.ndarray, "H W 3"]:
    """Pictures of one size side by side and below each other."""
    blank = [np.zeros_like(pictures[0])] * (-len(pictures) % columns)
    filled = [*pictures, *blank]
    rows = [np.concatenate(filled[start : start + columns], axis=1) for start in range(0, len(filled), columns)]
    return np.concatenate(rows, axis=0)


def write_png(path: Path, picture: UInt8[np.ndarray, "h w 3"]) -> None:
    """Write an RGB picture, whole or not at all."""
    done, data = cv2.imencode(".png", np.ascontiguousarray(picture[:, :, ::-1]))
    assert done, "OpenCV encodes every RGB image"
    write_whole(path, data.tofile)
