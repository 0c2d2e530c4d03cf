"""Grids, height fields and trails of worlds."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from offpiste.native.library import entry
from offpiste.simulation.world import grids, terrain
from offpiste.simulation.world.grids import smooth_noise

X0, Y0, STEP = -3.0, 7.0, 0.5
NX, NY = 13, 9  # not square: swapped axes fall off the grid


def _plane(a, b, c=0.0):
    x, y = X0 + STEP * np.arange(NX), Y0 + STEP * np.arange(NY)
    return a * x[None, :] + b * y[:, None] + c


def _places(n=200, seed=0, beyond=0.0):
    rng = np.random.default_rng(seed)
    low = np.array([X0, Y0]) - beyond
    high = np.array([X0 + STEP * (NX - 1), Y0 + STEP * (NY - 1)]) + beyond
    return rng.uniform(low, high, (n, 2))


@pytest.mark.parametrize(("a", "b"), [(1.0, 0.0), (0.0, 1.0), (0.3, -0.7)])
def test_a_plane_is_read_exactly(a, b):
    elevation, places = _plane(a, b, 2.0), _places()
    expected = np.array([-a, -b, 1.0]) / np.sqrt(a * a + b * b + 1)
    heights = grids.read_grid(elevation, (X0, Y0), STEP, places)
    np.testing.assert_allclose(heights, a * places[:, 0] + b * places[:, 1] + 2.0, atol=1e-12)
    np.testing.assert_allclose(grids.normals_of(elevation, STEP), np.broadcast_to(expected, (NY, NX, 3)), atol=1e-12)


def test_the_library_reads_the_ground_as_many_places_are_read():
    read = entry("read_ground", "f8", "f8", int, int, float, float, float, "f8", int, "f8", "f8")
    rng = np.random.default_rng(1)
    elevation, properties = rng.normal(size=(NY, NX)), rng.normal(size=(NY, NX, 4))
    places = np.concatenate((_places(beyond=5.0), [[np.nan, np.nan], [np.inf, -np.inf], [1e300, -1e300]]))
    heights, found = np.empty(len(places)), np.empty((len(places), 4))
    read(elevation, properties, NY, NX, X0, Y0, STEP, places, len(places), heights, found)
    for result, grid in ((heights, elevation), (found, properties)):
        np.testing.assert_allclose(result, grids.read_grid(grid, (X0, Y0), STEP, places), rtol=1e-12, atol=1e-12)
        at_nan = grids.read_grid(grid, (X0, Y0), STEP, np.array([[np.nan, Y0 + STEP], [X0 + STEP, np.nan]]))
        np.testing.assert_array_equal(at_nan, [grid[1, 0], grid[0, 1]])


def test_the_main_kind_is_that_of_the_nearest_node():
    kinds = np.zeros((3, NY, NX))
    kinds[1, :, 4:], kinds[2, 5:, 4:] = 0.6, 0.6  # where tied, the first
    kinds[2, 7:] = 0.7
    places = np.array([[3.4, 0.0], [3.6, 6.4], [3.6, 6.6], [1e300, np.inf], [np.nan, np.nan]]) * STEP + [X0, Y0]
    assert grids.main_kinds(kinds, (X0, Y0), STEP, places).tolist() == [0, 1, 2, 2, 0]


def test_noise_has_mean_0_and_variance_1_and_does_not_depend_on_the_resolution():
    x, y = np.arange(0, 300, 1.0), np.arange(0, 201, 1.0)
    field = smooth_noise(np.random.default_rng(0), x, y, 4.0)
    assert field.shape == (201, 300)
    assert field.mean() == pytest.approx(0, abs=0.05)
    assert field.std() == pytest.approx(1, abs=0.05)
    fine = smooth_noise(np.random.default_rng(0), np.arange(0, 299.5, 0.5), np.arange(0, 200.5, 0.5), 4.0)
    np.testing.assert_allclose(fine[::2, ::2], field, atol=1e-5)


@pytest.fixture(scope="module", params=[(0, 320.0), (2, 120.0), (3, 60.0)])
def network(request):
    seed, size = request.param
    return terrain.make_trails(np.random.default_rng(seed), size), size


def test_distances_of_a_grid_are_those_of_its_nodes(network):
    loops, size = network
    x, y = np.arange(-size / 2, size / 2, 0.7), np.arange(-0.4 * size, 0.6 * size, 1.1)  # some of it beyond the trails
    grid = terrain.trail_distance_grid(loops, x, y)
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    lines = np.concatenate([terrain.resample(loop, 0.1) for loop in loops])
    away = np.minimum(cKDTree(lines).query(places)[0], terrain.NEAR)
    np.testing.assert_array_equal(grid.ravel(), away.astype(np.float32))
    assert 0 < (grid < terrain.NEAR).mean() < 1


def test_ground_slumps_until_no_step_is_too_high():
    before = np.random.default_rng(0).normal(size=(20, 31)).astype(np.float32)
    after = before.copy()
    terrain._slump(after, *after.shape, 0.25)
    assert (after <= before).all()
    assert after.min() == before.min()
    for axis in (0, 1):
        assert 0.2 < np.abs(np.diff(after, axis=axis)).max() < 0.25 + 1e-4
    assert np.abs(after[1:, 1:] - after[:-1, :-1]).max() < 0.25 * np.sqrt(2) + 1e-4


def test_trails_stay_inside_and_can_be_driven(network):
    loops, size = network
    for loop in loops:
        assert np.abs(loop).max() <= size / 2 - terrain.MARGIN + 1e-6
        steps = np.linalg.norm(np.roll(loop, -1, axis=0) - loop, axis=1)
        np.testing.assert_allclose(steps, terrain.SPACING, rtol=0.1)  # evenly spaced, and the loop closes
        if size >= 120:
            assert 1 / np.abs(terrain.curvature(loop)).max() > 8
