"""The vehicle in its own pictures: its pose, its paint, and the shadow that it throws."""

from typing import NamedTuple

import numpy as np

from offpiste.compilation import RAYS

SHADOW_REACH = 8.0
"""Distance from the vehicle up to which its shadow is drawn [m]."""


class Vehicle(NamedTuple):
    """The vehicle in a picture.

    Attributes:
        position, rotation: `world_from_body`.
        sun: direction to it in the body frame, not exactly along an axis.
        shadow: boxes that throw shadows, after a box around all of them [n, 2, 3], in the body frame.
        paint: colour of each box [m, 3].
    """

    position: np.ndarray
    rotation: np.ndarray
    sun: np.ndarray
    shadow: np.ndarray
    paint: np.ndarray


@RAYS.inlined
def meets(boxes, b, px, py, pz, ix, iy, iz):  # type: ignore[no-untyped-def]
    """Whether a ray from p meets a box; i: over its direction (slab test, Kay and Kajiya, SIGGRAPH 1986)."""
    x0, x1 = (boxes[b, 0, 0] - px) * ix, (boxes[b, 1, 0] - px) * ix
    y0, y1 = (boxes[b, 0, 1] - py) * iy, (boxes[b, 1, 1] - py) * iy
    z0, z1 = (boxes[b, 0, 2] - pz) * iz, (boxes[b, 1, 2] - pz) * iz
    enter = max(max(min(x0, x1), min(y0, y1)), max(min(z0, z1), 0.0))
    return enter < min(min(max(x0, x1), max(y0, y1)), max(z0, z1))


@RAYS.inlined
def sunlit(vehicle, x, y, z):  # type: ignore[no-untyped-def]
    """0 where the vehicle keeps the sun off a place in the world frame, else 1."""
    position, rotation, sun = vehicle.position, vehicle.rotation, vehicle.sun
    bx, by, bz = x - position[0], y - position[1], z - position[2]
    if bx * bx + by * by >= SHADOW_REACH * SHADOW_REACH:
        return 1.0
    px = rotation[0, 0] * bx + rotation[1, 0] * by + rotation[2, 0] * bz
    py = rotation[0, 1] * bx + rotation[1, 1] * by + rotation[2, 1] * bz
    pz = rotation[0, 2] * bx + rotation[1, 2] * by + rotation[2, 2] * bz
    ix, iy, iz = 1 / sun[0], 1 / sun[1], 1 / sun[2]
    if meets(vehicle.shadow, 0, px, py, pz, ix, iy, iz):
        for b in range(1, len(vehicle.shadow)):
            if meets(vehicle.shadow, b, px, py, pz, ix, iy, iz):
                return 0.0
    return 1.0
