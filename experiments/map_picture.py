"""Picture of a terrain map from above: its features as colours, and its ground shaded, with obstacles."""

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from offpiste.mapping.terrain_map import TerrainLayers
from offpiste.report.feature_colours import colours

_SUN = np.array([-0.5, 0.45, 0.74])
"""Direction to the light: the upper left, as on maps."""
_OBSTACLE_HEIGHT = 0.3
"""Height above the ground from which something is drawn as an obstacle [m]."""


def map_picture(
    layers: TerrainLayers,
    around: Float[np.ndarray, " 2"],
    *,
    reach: float = 30.0,
    limits: Float[np.ndarray, "2 3"] | None = None,
    pixels: int = 4,
) -> UInt8[np.ndarray, "h w2 3"]:
    """Features as RGB, and right of them shaded ground with obstacles in green; y up, black where nothing is known.

    Args:
        around: x, y of the picture's centre, marked in red [m].
        reach: half the side of the picture [m].
        limits: limits of the colours (`report.feature_colours.colour_limits`); this map's own by default.
        pixels: side of a cell [px].
    """
    ny, nx = layers.elevation.shape
    first = np.clip(np.round((around - reach - layers.origin) / layers.resolution).astype(int), 0, [nx, ny])
    last = np.clip(np.round((around + reach - layers.origin) / layers.resolution).astype(int) + 1, 0, [nx, ny])
    window = slice(first[1], last[1]), slice(first[0], last[0])
    left, right = colours(layers.features[window], limits), _shaded(layers, window)
    column, row = np.round((around - layers.origin) / layers.resolution).astype(int) - first
    for half in (left, right):
        cv2.drawMarker(half, (int(column), int(row)), (255, 0, 0), cv2.MARKER_CROSS, 5)
    both = np.concatenate((left[::-1], np.full((len(left), 2, 3), 255, np.uint8), right[::-1]), axis=1)
    return both.repeat(pixels, axis=0).repeat(pixels, axis=1)


def _shaded(layers: TerrainLayers, window: tuple[slice, slice]) -> UInt8[np.ndarray, "h w 3"]:
    light = np.nan_to_num(layers.normal[window] @ (_SUN / np.linalg.norm(_SUN)), nan=0.7)
    grey = np.rint(230 * light.clip(0, 1)).astype(np.uint8)[..., None].repeat(3, axis=-1)
    height: Float[np.ndarray, "h w"] = np.nan_to_num(layers.obstacle_height[window])
    obstacle: Bool[np.ndarray, "h w"] = height > _OBSTACLE_HEIGHT
    share = (height[obstacle] / 2).clip(0, 1)[:, None]
    grey[obstacle] = np.rint((1 - share) * np.array([190, 230, 150]) + share * np.array([10, 80, 20])).astype(np.uint8)
    return np.where(layers.known[window][..., None], grey, 0).astype(np.uint8)
