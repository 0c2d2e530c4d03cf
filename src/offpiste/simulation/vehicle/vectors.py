"""Vectors in space as tuples of three numbers, for compiled code."""

import numpy as np

from offpiste.compilation import PHYSICS


@PHYSICS.entry
def dot(a, b):  # type: ignore[no-untyped-def]
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@PHYSICS.entry
def cross(a, b):  # type: ignore[no-untyped-def]
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@PHYSICS.entry
def add(a, b, scale):  # type: ignore[no-untyped-def]
    """The vector a + scale b."""
    return a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]


@PHYSICS.entry
def unit(a):  # type: ignore[no-untyped-def]
    """The vector at length 1."""
    scale = 1.0 / np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2] + 1e-300)
    return a[0] * scale, a[1] * scale, a[2] * scale


@PHYSICS.entry
def axes(w, x, y, z):  # type: ignore[no-untyped-def]
    """Forward, left and up of a body with the quaternion (w, x, y, z), MuJoCo's order, in the world frame."""
    forward = 1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)
    left = 2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)
    up = 2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)
    return forward, left, up


@PHYSICS.entry
def turned(v, forward, left, up):  # type: ignore[no-untyped-def]
    """A body-frame vector in the world frame."""
    return (
        v[0] * forward[0] + v[1] * left[0] + v[2] * up[0],
        v[0] * forward[1] + v[1] * left[1] + v[2] * up[1],
        v[0] * forward[2] + v[1] * left[2] + v[2] * up[2],
    )
