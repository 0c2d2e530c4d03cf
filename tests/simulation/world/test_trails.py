import numpy as np
import pytest
from scipy.spatial import cKDTree

from offpiste.simulation.world import terrain


@pytest.fixture(scope="module", params=[(0, 320.0), (1, 320.0), (2, 120.0), (3, 60.0)])
def network(request):
    seed, size = request.param
    return terrain.make_trails(np.random.default_rng(seed), size), size


def test_a_circle_has_the_curvature_of_its_radius():
    angle = np.linspace(0, 2 * np.pi, 20000, endpoint=False)
    circle = terrain.resample(12 * np.stack((np.cos(angle), np.sin(angle)), axis=1), 0.5)
    np.testing.assert_allclose(terrain.curvature(circle), 1 / 12, rtol=0.005)
    np.testing.assert_allclose(terrain.curvature(circle[::-1]), -1 / 12, rtol=0.005)


def test_distance_to_a_square():
    square = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    places = np.array([[5.0, -3.0], [5.0, 2.0], [13.0, 14.0], [100.0, 0.0]])
    np.testing.assert_allclose(terrain.distance_to_trails((square,), places), [3, 2, 5, terrain.NEAR], atol=1e-3)


def test_trails_stay_inside_and_can_be_driven(network):
    loops, size = network
    for loop in loops:
        assert np.abs(loop).max() <= size / 2 - terrain.MARGIN + 1e-6
        steps = np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=1)
        np.testing.assert_allclose(steps, terrain.SPACING, rtol=0.1)  # evenly spaced, and the loop closes
        if size >= 120:
            assert 1 / np.abs(terrain.curvature(loop)).max() > 8


def test_bends_vary(network):
    loops, size = network
    if size < 300:
        pytest.skip("short loops are all bend")
    radius = 1 / np.abs(np.concatenate([terrain.curvature(loop) for loop in loops]))
    assert np.percentile(radius, 5) < 20
    assert np.percentile(radius, 50) < 60
    assert sum(map(len, loops)) * terrain.SPACING > 1500


def test_the_network_is_connected(network):
    loops, _ = network
    reached, waiting = [loops[0]], list(loops[1:])
    while waiting:
        near = [loop for loop in waiting if cKDTree(np.concatenate(reached)).query(loop)[0].min() < terrain.SPACING]
        assert near
        reached += near
        waiting = [loop for loop in waiting if not any(loop is other for other in near)]
