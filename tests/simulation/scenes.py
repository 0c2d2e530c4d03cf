"""Small worlds for tests of the sensors."""

import numpy as np

from offpiste.logs.ground_truth import GROUND_KINDS
from offpiste.simulation.sample import Motion, Pose
from offpiste.simulation.world.world import Bushes, Trees, World, WorldSettings
from synthetic_drive import bare_world


def world(
    *, size=40.0, resolution=0.5, slope=(0.0, 0.0), kind=lambda x, y: 0 * x, grass=0.0, **plants: object
) -> World:
    """A plane z = slope . (x, y), not square, of ground `kind(x, y)`, with its centre near the origin."""
    nx, ny = round(size / resolution) + 1, round(size / resolution) + 5
    x, y = -size / 2 + resolution * np.arange(nx), -size / 2 + resolution * np.arange(ny)[:, None]
    kinds = np.zeros((len(GROUND_KINDS), ny, nx))
    np.put_along_axis(kinds, np.broadcast_to(kind(x, y), (ny, nx)).astype(int)[None], 1.0, axis=0)
    settings = WorldSettings(seed=0, size=float(size), resolution=resolution)
    looks = {"settings": settings, "kinds": kinds, "grass_height": np.full((ny, nx), grass), **plants}
    return bare_world(slope[0] * x + slope[1] * y, (-size / 2, -size / 2), resolution, **looks)


def tree(x, y, *, radius=0.3, crown=1.5, height=6.0):
    return Trees(np.array([[x, y, 0.0]]), np.array([radius]), np.array([crown]), np.array([height]))


def bush(x, y, *, radius=0.6, height=0.8):
    return Bushes(np.array([[x, y, 0.0]]), np.array([radius]), np.array([height]), np.array([100.0]))


def motionless(pose: Pose) -> Motion:
    return Motion(np.array((0.0, 1.0)), np.tile(pose.position, (2, 1)), np.tile(pose.orientation, (2, 1)))
