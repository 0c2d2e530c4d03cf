"""Compiled check of points; its reference in NumPy is in tests/logs."""

import numpy as np

from offpiste.native.compilation import CLOUDS, FUSED_CLOUDS


@FUSED_CLOUDS.inlined
def along(row, x, y, z):  # type: ignore[no-untyped-def]
    """Return the coordinate of a point along an axis, which is a row of a transform."""
    return (x * row[0] + y * row[1] + z * row[2]) + row[3]


@CLOUDS.entry
def mark_usable(points, nearest, furthest, body_from_lidar, low, high, usable):  # type: ignore[no-untyped-def]
    """Mark points [n, 3] that are finite, within range [m], and outside the vehicle's box (NaN if it has none)."""
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        distance = np.sqrt((x * x + y * y) + z * z)
        usable[i] = distance > 0 and distance >= nearest and distance <= furthest and distance < np.inf
        own = True
        for axis in range(3):
            place = along(body_from_lidar[axis], x, y, z)
            own = own and place >= low[axis] and place <= high[axis]
        usable[i] = usable[i] and not own
