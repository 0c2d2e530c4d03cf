"""Which points of a cloud are of use: a compiled loop; the same in plain NumPy is in tests/logs."""

import numpy as np

from offpiste.native.compilation import CLOUDS, FUSED_CLOUDS


@FUSED_CLOUDS.inlined
def along(row, x, y, z):  # type: ignore[no-untyped-def]
    """Coordinate of a point along an axis, which is a row of a transform."""
    return (x * row[0] + y * row[1] + z * row[2]) + row[3]


@CLOUDS.entry
def mark_usable(points, nearest, furthest, body_from_lidar, low, high, usable):  # type: ignore[no-untyped-def]
    """Mark points that are finite, within range, and not on the vehicle itself.

    Args:
        points: [n, 3].
        nearest, furthest: range [m].
        body_from_lidar: [4, 4].
        low, high: corners of the vehicle itself in the body's frame [3]; not numbers where they are not known.
        usable: of each point [n].
    """
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        distance = np.sqrt((x * x + y * y) + z * z)
        usable[i] = distance > 0 and distance >= nearest and distance <= furthest and distance < np.inf
        own = True
        for axis in range(3):
            place = along(body_from_lidar[axis], x, y, z)
            own = own and place >= low[axis] and place <= high[axis]
        usable[i] = usable[i] and not own
