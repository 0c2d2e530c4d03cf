"""A spinning LiDAR over a height field: rays are followed in small steps."""

from collections.abc import Callable

import numpy as np

Heights = Callable[[np.ndarray, np.ndarray], np.ndarray]


def spinning_scan(
    heights: Heights, sensor: np.ndarray, *, rings: int, columns: int, furthest: float, seed: int = 0
) -> np.ndarray:
    """Points of one revolution over ground of a given height at x, y [m], with noise of 2 cm along the rays."""
    elevation = np.deg2rad(np.linspace(-30, 4, rings))
    azimuth = np.linspace(-np.pi, np.pi, columns, endpoint=False)
    slope, turn = (grid.ravel() for grid in np.meshgrid(np.tan(elevation), azimuth, indexing="ij"))
    east, north = np.cos(turn), np.sin(turn)
    result = np.full(len(slope), np.nan)
    open_rays = np.arange(len(slope))
    step = 0.05
    for away in np.arange(1.0, furthest, step):
        x, y = sensor[0] + away * east[open_rays], sensor[1] + away * north[open_rays]
        hit = sensor[2] + away * slope[open_rays] < heights(x, y)
        result[open_rays[hit]] = away - step / 2
        open_rays = open_rays[~hit]
        if not len(open_rays):
            break
    seen = np.isfinite(result)
    rays = np.stack((east, north, slope), axis=1)[seen]
    unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    away = result[seen] * np.linalg.norm(rays, axis=1)
    away += np.random.default_rng(seed).normal(0, 0.02, len(away))
    return sensor + unit * away[:, None]


def with_detours(points: np.ndarray, sensor: np.ndarray, share: float, rng: np.random.Generator):
    """Points of which a share is moved along the rays to 0.7 to 13 m below their true places, and the mask of these.

    Only rays that point down by 2 degrees or more have detours.
    """
    rays = points - sensor
    steep = np.flatnonzero(rays[:, 2] < -0.035 * np.linalg.norm(rays[:, :2], axis=1))
    chosen = rng.choice(steep, min(int(np.ceil(share * len(points))), len(steep)), replace=False)
    deeper = rng.uniform(0.7, 13.0, len(chosen))
    result = points.copy()
    result[chosen] += rays[chosen] * (deeper / -rays[chosen, 2])[:, None]
    ghosts = np.zeros(len(points), bool)
    ghosts[chosen] = True
    return result, ghosts
