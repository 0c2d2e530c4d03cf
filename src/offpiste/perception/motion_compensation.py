"""Motion compensation of scans, and rigid transforms."""

from typing import Final

import numpy as np
from jaxtyping import Float, Int

from offpiste.logs.measurements import Cloud, Lidar
from offpiste.logs.poses import Poses
from offpiste.native.library import compiled

MOMENT = 1e-4  # resolution of the times of points, 2 mm at 20 m/s [s]
_MOST_TICKS: Final = 1e5  # longest span of a scan for counting, 10 s; longer ones are sorted [MOMENT]


def points_in_world(cloud: Cloud, lidar: Lidar, poses: Poses) -> Float[np.ndarray, "n 3"]:
    """Transform the points of a scan to the world by the vehicle's pose at the time of each [m]; NaN without a pose."""
    tick = np.round(cloud.times / MOMENT)
    ticks, which = distinct(tick)
    world_from_lidar = np.ascontiguousarray(poses.at(ticks * MOMENT) @ lidar.body_from_lidar)
    points, world = np.ascontiguousarray(cloud.points, np.float64).reshape(len(tick), 3), np.empty((len(tick), 3))
    put_in_world(points, which, world_from_lidar, len(world), world)
    return world


def distinct(tick: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " k"], Int[np.ndarray, " n"]]:
    """Return `np.unique` of whole numbers and its inverse, by counting if their span is short."""
    first, last = tick.min(initial=np.inf), tick.max(initial=-np.inf)
    if not 0 <= last - first < _MOST_TICKS:
        return np.unique(tick, return_inverse=True)
    place = (tick - first).astype(np.int64)
    present = np.zeros(int(last - first) + 1, bool)
    present[place] = True
    return first + np.flatnonzero(present), (np.cumsum(present) - 1).take(place)


@compiled("f8", "i8", "f8", int, "f8")
def put_in_world(points, which, world_from_lidar, count, world):  # type: ignore[no-untyped-def]
    """Transform each of `count` points by one of k matrices [k, 4, 4] into `world` [count, 3]."""
    matrix = world_from_lidar[which]
    world[:] = np.einsum("nij,nj->ni", matrix[:, :3, :3], points) + matrix[:, :3, 3]


def transformed(points: Float[np.ndarray, "n 3"], matrix: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "n 3"]:
    """Apply a rigid transform to points."""
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def inverse(matrix: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Invert a rigid transform."""
    back = np.eye(4)
    back[:3, :3] = matrix[:3, :3].T
    back[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return back
