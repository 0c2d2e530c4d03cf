"""Trees and bushes around the body, against plain NumPy over all of them."""

import inspect
from types import SimpleNamespace

import numpy as np
import pytest

from offpiste.simulation.vehicle.chassis import nearby_obstacles

LENGTH, WIDTH = 2.9, 1.6


def plain(trees, bushes, x, y, cos, sin):
    around = np.zeros(4)
    if len(trees.foot):
        gap = np.hypot(*(trees.foot[:, :2] - (x, y)).T) - trees.trunk_radius
        nearest = int(np.argmin(gap))
        if gap[nearest] < LENGTH:
            around[:3] = *trees.foot[nearest, :2], trees.trunk_radius[nearest]
    for foot, radius, drag in zip(bushes.foot, bushes.radius, bushes.drag, strict=True):
        dx, dy = foot[:2] - (x, y)
        beyond = np.abs((cos * dx + sin * dy, cos * dy - sin * dx)) - (LENGTH / 2, WIDTH / 2)
        around[3] += drag if np.hypot(*np.maximum(beyond, 0)) < radius else 0.0
    return around


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("count", [0, 1, 80])
def test_the_loop_finds_what_numpy_finds(seed: int, count: int):
    rng = np.random.default_rng([seed, count])
    feet = rng.uniform(-15, 15, (2, count, 3))
    trees = SimpleNamespace(foot=feet[0], trunk_radius=rng.uniform(0.1, 0.5, count))
    bushes = SimpleNamespace(foot=feet[1], radius=rng.uniform(0.2, 2, count), drag=rng.uniform(10, 500, count))
    (x, y), yaw = rng.uniform(-5, 5, 2), rng.uniform(-np.pi, np.pi)
    cos, sin = float(np.cos(yaw)), float(np.sin(yaw))
    world = SimpleNamespace(trees=trees, bushes=bushes)
    found = inspect.unwrap(nearby_obstacles)(world, x, y, cos, sin, LENGTH, WIDTH)
    np.testing.assert_allclose(found, plain(trees, bushes, x, y, cos, sin), rtol=1e-12)
    if count > 1 and seed == 0:
        assert found[2] > 0
