"""Motion compensation of scans, and rigid transforms."""

from typing import Final

import numpy as np
from jaxtyping import Float, Int

from offpiste.logs.measurements import Cloud, Lidar
from offpiste.logs.poses import Poses
from offpiste.native.compilation import MOTION

MOMENT = 1e-4  # resolution of the times of points, 2 mm at 20 m/s [s]
_MOST_TICKS: Final = 1e5  # longest span of a scan for counting, 10 s; longer ones are sorted [MOMENT]


def points_in_world(cloud: Cloud, lidar: Lidar, poses: Poses) -> Float[np.ndarray, "n 3"]:
    """Transform the points of a scan to the world by the vehicle's pose at the time of each [m]; NaN without a pose."""
    tick = np.round(cloud.times / MOMENT)
    ticks, which = distinct(tick)
    world_from_lidar = np.ascontiguousarray(poses.at(ticks * MOMENT) @ lidar.body_from_lidar)
    points, world = np.ascontiguousarray(cloud.points), np.empty((len(tick), 3))
    put_in_world(points, which, world_from_lidar, world)
    return world


def distinct(tick: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " k"], Int[np.ndarray, " n"]]:
    """Return `np.unique` of whole numbers and its inverse, by counting if their span is short."""
    first, last = tick.min(initial=np.inf), tick.max(initial=-np.inf)
    if not 0 <= last - first < _MOST_TICKS:
        return np.unique(tick, return_inverse=True)
    place, which = np.zeros(int(last - first) + 1, np.int64), np.empty(len(tick), np.int64)
    number_ticks(tick, first, place, which)
    return first + np.flatnonzero(place >= 0), which


@MOTION.entry
def number_ticks(tick, first, place, which):  # type: ignore[no-untyped-def]
    """Number the distinct ticks in ascending order.

    Args:
        tick: whole numbers from `first` to `first` + m - 1 [n].
        place: zeros on input; the number of each value, -1 for absent ones [m].
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
    """Transform each of n points by one of k matrices [k, 4, 4] into `world` [n, 3]."""
    for i in range(len(points)):
        matrix = world_from_lidar[which[i]]
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for axis in range(3):
            # NumPy's order of additions keeps datasets equal to the bit.
            turned = (matrix[axis, 0] * x + matrix[axis, 2] * z) + matrix[axis, 1] * y
            world[i, axis] = turned + matrix[axis, 3]


def transformed(points: Float[np.ndarray, "n 3"], matrix: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "n 3"]:
    """Apply a rigid transform to points."""
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def inverse(matrix: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Invert a rigid transform."""
    back = np.eye(4)
    back[:3, :3] = matrix[:3, :3].T
    back[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return back
