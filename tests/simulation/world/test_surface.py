import numpy as np
import pytest

from offpiste.simulation.world import surface

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
        assert surface.height(elevation, X0, Y0, STEP, x, y) == pytest.approx(a * x + b * y + 2.0, abs=1e-12)
        np.testing.assert_allclose(surface.normal(elevation, X0, Y0, STEP, x, y), expected, atol=1e-12)
    np.testing.assert_allclose(surface.normals_of(elevation, STEP), np.broadcast_to(expected, (NY, NX, 3)), atol=1e-12)


def test_inside_a_cell_the_surface_is_bilinear():
    elevation = np.array([[0.0, 1.0], [2.0, 5.0]])
    # 0 + u + 2 v + 2 u v at u = 1/4, v = 1/2, and its slopes 1 + 2 v, 2 + 2 u over 2 m
    assert surface.height(elevation, 0.0, 0.0, 2.0, 0.5, 1.0) == pytest.approx(0.25 + 1.0 + 0.25)
    n = surface.normal(elevation, 0.0, 0.0, 2.0, 0.5, 1.0)
    np.testing.assert_allclose([-n[0] / n[2], -n[1] / n[2]], [1.0, 1.25])


def test_the_compiled_reading_is_the_plain_one_also_beyond_the_border():
    rng = np.random.default_rng(1)
    elevation = rng.normal(size=(NY, NX)).astype(np.float32)
    properties = rng.normal(size=(NY, NX, 4)).astype(np.float32)
    places = _places(beyond=5.0)
    heights = [surface.height(elevation, X0, Y0, STEP, x, y) for x, y in places]
    np.testing.assert_allclose(heights, surface.read_grid(elevation, (X0, Y0), STEP, places), rtol=1e-6, atol=1e-6)
    out = np.empty(4)
    plain = surface.read_grid(properties, (X0, Y0), STEP, places)
    for (x, y), expected in zip(places, plain, strict=True):
        surface.properties_at(properties, X0, Y0, STEP, x, y, out)
        np.testing.assert_allclose(out, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("x", [-np.inf, np.inf, np.nan, 1e300])
def test_no_place_crashes(x):
    elevation = _plane(1.0, 2.0)
    assert np.isfinite(surface.height(elevation, X0, Y0, STEP, x, x))
    assert np.isfinite(surface.normal(elevation, X0, Y0, STEP, x, x)).all()
    assert surface.main_kind(np.ones((2, NY, NX)), X0, Y0, STEP, x, x) == 0


def test_the_main_kind_is_that_of_the_nearest_node():
    rng = np.random.default_rng(2)
    kinds = rng.dirichlet(np.ones(5), (NY, NX)).transpose(2, 0, 1)
    for x, y in _places():
        i, j = round((x - X0) / STEP), round((y - Y0) / STEP)
        assert surface.main_kind(kinds, X0, Y0, STEP, x, y) == kinds[:, j, i].argmax()
