import numpy as np
import pytest

from offpiste.simulation.world import grids
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
    elevation = _plane(a, b, 2.0)
    expected = np.array([-a, -b, 1.0]) / np.sqrt(a * a + b * b + 1)
    for x, y in _places():
        assert grids.height(elevation, X0, Y0, STEP, x, y) == pytest.approx(a * x + b * y + 2.0, abs=1e-12)
    np.testing.assert_allclose(grids.normals_of(elevation, STEP), np.broadcast_to(expected, (NY, NX, 3)), atol=1e-12)


def test_inside_a_cell_the_surface_is_bilinear():
    elevation = np.array([[0.0, 1.0], [2.0, 5.0]])
    # 0 + u + 2 v + 2 u v at u = 1/4, v = 1/2
    assert grids.height(elevation, 0.0, 0.0, 2.0, 0.5, 1.0) == pytest.approx(0.25 + 1.0 + 0.25)


def test_the_compiled_reading_is_the_plain_one_also_beyond_the_border():
    rng = np.random.default_rng(1)
    elevation = rng.normal(size=(NY, NX)).astype(np.float32)
    properties = rng.normal(size=(NY, NX, 4)).astype(np.float32)
    places = _places(beyond=5.0)
    heights = [grids.height(elevation, X0, Y0, STEP, x, y) for x, y in places]
    np.testing.assert_allclose(heights, grids.read_grid(elevation, (X0, Y0), STEP, places), rtol=1e-6, atol=1e-6)
    out = np.empty(4)
    plain = grids.read_grid(properties, (X0, Y0), STEP, places)
    for (x, y), expected in zip(places, plain, strict=True):
        grids.properties_at(properties, X0, Y0, STEP, x, y, out)
        np.testing.assert_allclose(out, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("x", [-np.inf, np.inf, np.nan, 1e300])
def test_no_place_crashes(x):
    elevation = _plane(1.0, 2.0)
    assert np.isfinite(grids.height(elevation, X0, Y0, STEP, x, x))
    assert grids.main_kind(np.ones((2, NY, NX)), X0, Y0, STEP, x, x) == 0


def test_the_main_kind_is_that_of_the_nearest_node():
    rng = np.random.default_rng(2)
    kinds = rng.dirichlet(np.ones(5), (NY, NX)).transpose(2, 0, 1)
    for x, y in _places():
        i, j = round((x - X0) / STEP), round((y - Y0) / STEP)
        assert grids.main_kind(kinds, X0, Y0, STEP, x, y) == kinds[:, j, i].argmax()


def test_mean_zero_and_variance_one():
    x, y = np.arange(0, 300, 1.0), np.arange(0, 200, 1.0)
    field = smooth_noise(np.random.default_rng(0), x, y, 4.0)
    assert field.shape == (200, 300)
    assert field.mean() == pytest.approx(0, abs=0.05)
    assert field.std() == pytest.approx(1, abs=0.05)


def test_the_same_place_has_the_same_value_at_every_resolution():
    fine, coarse = np.arange(0, 60.25, 0.25), np.arange(0, 60.5, 0.5)
    a = smooth_noise(np.random.default_rng(3), fine, fine, 7.0)
    b = smooth_noise(np.random.default_rng(3), coarse, coarse, 7.0)
    np.testing.assert_allclose(a[::2, ::2], b, atol=1e-5)
