"""Pictures of points in images."""

import cv2
import numpy as np
from jaxtyping import Float, UInt8


def overlay(
    image: UInt8[np.ndarray, "h w 3"],
    pixels: Float[np.ndarray, "n 2"],
    distance: Float[np.ndarray, " n"],
    *,
    farthest: float = 40.0,
    radius: int = 1,
) -> UInt8[np.ndarray, "h w 3"]:
    """An RGB image with points drawn into it, the nearest last: red near, blue far.

    Args:
        distance: from the camera [m].
        farthest: is drawn in the last colour, in the logarithm of distance from 2 m on [m].
        radius: of a point [px].
    """
    share = np.log(np.clip(distance, 2, farthest) / 2) / np.log(farthest / 2)
    shade = np.clip(255 * (0.95 - 0.9 * share), 0, 255).astype(np.uint8)
    colours = cv2.applyColorMap(shade[:, None], cv2.COLORMAP_TURBO)[:, 0, ::-1]
    drawn = image.copy()
    for n in np.argsort(-distance):
        cv2.circle(drawn, tuple(np.rint(pixels[n]).astype(int).tolist()), radius, colours[n].tolist(), -1)
    return drawn
