"""The vehicle as its own cameras and LiDARs see it: a side-by-side made of a few boxes."""

from typing import Final

import numpy as np
from jaxtyping import Float

from offpiste.simulation.rendering.meshes import box_mesh
from offpiste.simulation.rendering.scene import Hits, Scene, cast_rays

BOXES: Final[dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]]] = {
    "chassis": ((-1.25, -0.45, -0.05), (1.30, 0.45, 0.25)),
    "hood": ((0.55, -0.42, 0.25), (1.48, 0.42, 0.62)),
    "left fender": ((0.70, 0.42, 0.42), (1.42, 0.78, 0.52)),
    "right fender": ((0.70, -0.78, 0.42), (1.42, -0.42, 0.52)),
    "left rear fender": ((-1.35, 0.50, 0.42), (-0.65, 0.76, 0.52)),
    "right rear fender": ((-1.35, -0.76, 0.42), (-0.65, -0.50, 0.52)),
    "cargo bed": ((-1.40, -0.50, 0.25), (-0.62, 0.50, 0.60)),
    "seats": ((-0.50, -0.60, 0.25), (0.10, 0.60, 0.75)),
    "left front post": ((0.50, 0.62, 0.40), (0.56, 0.68, 1.46)),
    "right front post": ((0.50, -0.68, 0.40), (0.56, -0.62, 1.46)),
    "left rear post": ((-0.58, 0.62, 0.40), (-0.52, 0.68, 1.46)),
    "right rear post": ((-0.58, -0.68, 0.40), (-0.52, -0.62, 1.46)),
    "roof": ((-0.60, -0.70, 1.46), (0.58, 0.70, 1.50)),
    "front left wheel": ((0.67, 0.54, -0.36), (1.39, 0.79, 0.36)),
    "front right wheel": ((0.67, -0.79, -0.36), (1.39, -0.54, 0.36)),
    "rear left wheel": ((-1.39, 0.54, -0.36), (-0.67, 0.79, 0.36)),
    "rear right wheel": ((-1.39, -0.79, -0.36), (-0.67, -0.54, 0.36)),
}
"""Lowest and highest corner in the body frame [m]; its origin is the pose point, between the wheels' centres.

Wheelbase, track, tyres and roof are those of side_by_side.toml; the rest is drawn to fit. Wheels neither
steer nor bounce.
"""


def body_boxes() -> Float[np.ndarray, "n 2 3"]:
    """`BOXES` as one array, for shadows."""
    return np.array(list(BOXES.values()), np.float32)


def body_hits(origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]) -> Hits:
    """Hits on the vehicle itself of rays given in the body frame: constant, so cast once."""
    return cast_rays(Scene([box_mesh(body_boxes())], threads=1), origins, directions)
