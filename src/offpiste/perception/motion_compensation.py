"""Motion compensation: points from the moments of their measurement to the world, and rigid transforms."""

import numpy as np
from jaxtyping import Float

from offpiste.logs.measurements import Cloud, Lidar
from offpiste.logs.poses import Poses

MOMENT = 1e-4
"""Time within which points share a pose [s]: 2 mm at 20 m/s."""


def points_in_world(cloud: Cloud, lidar: Lidar, poses: Poses) -> Float[np.ndarray, "n 3"]:
    """Points of a scan in the world, each by the vehicle's pose at its own moment [m]; NaN where that is unknown.

    Exact to `MOMENT` for exact poses.
    """
    ticks, which = np.unique(np.round(cloud.times / MOMENT), return_inverse=True)
    world_from_lidar = poses.at(ticks * MOMENT) @ lidar.body_from_lidar
    # Points come in columns of one moment: a rotation a moment, looked up, costs less than a loop over moments.
    rotation, shift = world_from_lidar[which, :3, :3], world_from_lidar[which, :3, 3]
    return np.einsum("nij,nj->ni", rotation, cloud.points) + shift


def transformed(points: Float[np.ndarray, "n 3"], matrix: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "n 3"]:
    """Points moved by a rigid transform, e.g. `camera_from_world`."""
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def inverse(matrix: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """Inverse of a rigid transform."""
    back = np.eye(4)
    back[:3, :3] = matrix[:3, :3].T
    back[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return back
