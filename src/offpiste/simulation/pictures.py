"""Pictures of what the sensors record."""

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from offpiste.simulation.camera import CameraSettings


def project(
    points_camera: Float[np.ndarray, "n 3"], settings: CameraSettings
) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """Pixels of the distorted image that points in the optical frame fall on, and whether they fall on it at all."""
    s = settings
    x, y, z = points_camera.T
    ahead = z > 0.1
    pixels = np.full((len(points_camera), 2), -1.0)
    if ahead.any():
        points = np.asarray(points_camera[ahead], float)
        pixels[ahead] = cv2.projectPoints(points, np.zeros(3), np.zeros(3), s.matrix, np.array(s.distortion))[0][:, 0]
    # Far outside the image the distortion polynomial folds points back into it.
    with np.errstate(divide="ignore", invalid="ignore"):
        far = np.hypot(x, y) / z > 1.2 * np.hypot(s.width, s.height) / sum(s.focal_length)
    inside = ((pixels > -0.5) & (pixels < np.array([s.width, s.height]) - 0.5)).all(axis=1)
    return pixels, ahead & ~far & inside


def overlay(
    image: UInt8[np.ndarray, "height width 3"],
    points_camera: Float[np.ndarray, "n 3"],
    settings: CameraSettings,
    *,
    farthest: float = 40.0,
) -> UInt8[np.ndarray, "height width 3"]:
    """An image with LiDAR points drawn into it, red near and blue far.

    Args:
        points_camera: in the camera's optical frame [m].
        farthest: distance that is drawn in the last colour [m].
    """
    pixels, seen = project(points_camera, settings)
    distance = np.linalg.norm(points_camera, axis=1)
    shade = np.clip(255 * (1 - distance / farthest), 0, 255).astype(np.uint8)
    colours = cv2.applyColorMap(shade[:, None], cv2.COLORMAP_TURBO)[:, 0, ::-1]
    drawn = image.copy()
    for n in np.flatnonzero(seen)[np.argsort(-distance[seen])]:
        cv2.circle(drawn, tuple(np.rint(pixels[n]).astype(int).tolist()), 1, colours[n].tolist(), -1)
    return drawn
