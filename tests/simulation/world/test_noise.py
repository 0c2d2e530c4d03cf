import numpy as np
import pytest

from offpiste.simulation.world.noise import _VARIANCE, _spline, smooth_noise, smooth_step


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


def test_it_is_smooth_and_the_grain_says_how():
    x = np.arange(0, 400, 0.5)
    field = smooth_noise(np.random.default_rng(1), x, x, (5.0, 20.0))
    slope_y, slope_x = np.gradient(field, 0.5)
    assert slope_x.std() / slope_y.std() == pytest.approx(4, rel=0.2)
    assert np.abs(np.diff(slope_x, axis=1)).max() < 0.3  # continuous slope: no kinks at the knots


def test_smooth_step_by_hand_and_backwards():
    np.testing.assert_allclose(smooth_step(np.array([-1.0, 0.0, 0.5, 1.0, 2.0]), 0.0, 2.0), [0, 0, 0.15625, 0.5, 1])
    np.testing.assert_allclose(smooth_step(np.array([0.0, 2.0]), 2.0, 0.0), [1, 0])


def test_the_spline_is_summed_term_by_term():
    rng = np.random.default_rng(4)
    coefficients = rng.normal(size=(9, 12)).astype(np.float32)
    first_x, first_y = rng.integers(0, 9, 50), rng.integers(0, 6, 30)
    weight_x, weight_y = (rng.random((n, 4)).astype(np.float32) for n in (50, 30))
    field = np.empty((30, 50), np.float32)
    _spline(coefficients, first_x, weight_x, first_y, weight_y, np.empty(12, np.float32), field)
    rows = sum(weight_y[:, k, None] * coefficients[first_y + k] for k in range(4))
    expected = sum(weight_x[:, k] * rows[:, first_x + k] for k in range(4)) / np.float32(_VARIANCE)
    np.testing.assert_allclose(field, expected, rtol=1e-5, atol=1e-5)
