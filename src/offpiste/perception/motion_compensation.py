"""Motion compensation: points from the moments of their measurement to the world, and rigid transforms."""

from typing import Final

import numpy as np
from jaxtyping import Float, Int

from offpiste.logs.measurements import Cloud, Lidar
from offpiste.logs.poses import Poses
from offpiste.native.compilation import MOTION

MOMENT = 1e-4
"""Time within which points share a pose [s]: 2 mm at 20 m/s."""
_MOST_TICKS: Final = 1e5
"""Span of the moments of a scan, above which they are sorted [MOMENT]: 10 s."""


def points_in_world(cloud: Cloud, lidar: Lidar, poses: Poses) -> Float[np.ndarray, "n 3"]:
    """Points of a scan in the world, each by the vehicle's pose at its own moment [m]; NaN where that is unknown.

    Exact to `MOMENT` for exact poses.
    """
    tick = np.round(cloud.times / MOMENT)
    ticks, which = distinct(tick)
    world_from_lidar = np.ascontiguousarray(poses.at(ticks * MOMENT) @ lidar.body_from_lidar)
    points, world = np.ascontiguousarray(cloud.points), np.empty((len(tick), 3))
    put_in_world(points, which, world_from_lidar, world)
    return world


def distinct(tick: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " k"], Int[np.ndarray, " n"]]:
    """`np.unique` of whole numbers with its inverse; by counting where they lie close together, as in a scan."""
    first, last = tick.min(initial=np.inf), tick.max(initial=-np.inf)
    if not 0 <= last - first < _MOST_TICKS:
        return np.unique(tick, return_inverse=True)
    place, which = np.zeros(int(last - first) + 1, np.int64), np.empty(len(tick), np.int64)
    number_ticks(tick, first, place, which)
    return first + np.flatnonzero(place >= 0), which


@MOTION.entry
def number_ticks(tick, first, place, which):  # type: ignore[no-untyped-def]
    """Assign consecutive indices to the distinct ticks, in ascending order.

    Args:
        tick: whole numbers from `first` on, none of which lies beyond the end of `place` [n].
        place: zeros; the number of each, -1 of those that there are not [m].
        which: number of each tick [n].
    """
    for i in range(len(tick)):
        place[int(tick[i] - first)] = 1
    count = 0
    for k in range(len(place)):
        if place[k] == 1:
            place[k] = count
            count += 1
        else:
            place[k] = -1
    for i in range(len(tick)):
        which[i] = place[int(tick[i] - first)]


@MOTION.entry
def put_in_world(points, which, world_from_lidar, world):  # type: ignore[no-untyped-def]
    """Move points, each by a transform of its own.

    Args:
        points: [n, 3].
        which: number of the transform of each [n].
        world_from_lidar: [k, 4, 4].
        world: where they go [n, 3].
    """
    for i in range(len(points)):
        matrix = world_from_lidar[which[i]]
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for axis in range(3):
            # In the order in which NumPy's vectors add: datasets stay the same to the bit.
            turned = (matrix[axis, 0] * x + matrix[axis, 2] * z) + matrix[axis, 1] * y
            world[i, axis] = turned + matrix[axis, 3]


def transformed(points: Float[np.ndarray, "n 3"], matrix: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "n 3"]:
    """Points moved by a rigid transform, e.g. `camera_from_world`."""
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def inverse(matrix: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Inverse of a rigid transform."""
    back = np.eye(4)
    back[:3, :3] = matrix[:3, :3].T
    back[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return back
