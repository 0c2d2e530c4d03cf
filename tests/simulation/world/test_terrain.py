"""The heightfield: trails carved into it, and the network of trails."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from offpiste.simulation.world import terrain
from offpiste.simulation.world.terrain import carve_trails
from offpiste.simulation.world.world import find_world_preset


@pytest.fixture(scope="module", params=[(0, 320.0), (2, 120.0), (3, 60.0)])
def network(request):
    seed, size = request.param
    return terrain.make_trails(np.random.default_rng(seed), size), size


def test_a_circle_has_the_curvature_of_its_radius():
    angle = np.linspace(0, 2 * np.pi, 20000, endpoint=False)
    circle = terrain.resample(12 * np.stack((np.cos(angle), np.sin(angle)), axis=1), 0.5)
    np.testing.assert_allclose(terrain.curvature(circle), 1 / 12, rtol=0.005)
    np.testing.assert_allclose(terrain.curvature(circle[::-1]), -1 / 12, rtol=0.005)


def test_distances_of_a_grid_are_those_of_its_nodes(network):
    loops, size = network
    x, y = np.arange(-size / 2, size / 2, 0.7), np.arange(-0.4 * size, 0.6 * size, 1.1)  # some of it beyond the trails
    grid = terrain.trail_distance_grid(loops, x, y)
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    lines = np.concatenate([terrain.resample(loop, 0.1) for loop in loops])
    away = np.minimum(cKDTree(lines).query(places)[0], terrain.NEAR)
    np.testing.assert_array_equal(grid.ravel(), away.astype(np.float32))
    assert 0 < (grid < terrain.NEAR).mean() < 1


def test_trails_stay_inside_and_can_be_driven(network):
    loops, size = network
    for loop in loops:
        assert np.abs(loop).max() <= size / 2 - terrain.MARGIN + 1e-6
        steps = np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=1)
        np.testing.assert_allclose(steps, terrain.SPACING, rtol=0.1)  # evenly spaced, and the loop closes
        if size >= 120:
            assert 1 / np.abs(terrain.curvature(loop)).max() > 8


def test_the_network_is_connected(network):
    loops, _ = network
    reached, waiting = [loops[0]], list(loops[1:])
    while waiting:
        near = [loop for loop in waiting if cKDTree(np.concatenate(reached)).query(loop)[0].min() < terrain.SPACING]
        assert near
        reached += near
        waiting = [loop for loop in waiting if not any(loop is other for other in near)]


@pytest.mark.parametrize("axis", [0, 1])
def test_a_straight_trail_across_a_slope_is_level(axis):
    step = 0.5
    x = y = np.arange(-40, 40 + step, step)
    hillside = (0.2 * (x[None, :] if axis == 0 else y[:, None]) + np.zeros((len(y), len(x)))).astype(np.float32)
    along = np.linspace(-30, 30, 121)
    line = np.stack((np.zeros(121), along) if axis == 0 else (along, np.zeros(121)), axis=1)
    distance = terrain.trail_distance_grid((line,), x, y)
    carved = carve_trails(np.random.default_rng(0), find_world_preset("mojave"), x, y, hillside, (line,), distance)
    middle = carved[80] if axis == 0 else carved[:, 80]
    sides = np.abs(x) <= 1.5
    assert np.ptp(middle[sides]) < 0.15  # 0.6 m before; ruts and roughness are left
    far = np.abs(x) > 9
    np.testing.assert_allclose(middle[far], 0.2 * x[far], atol=0.3)
