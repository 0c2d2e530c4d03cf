import numpy as np
import pytest

from offpiste.simulation.world.noise import smooth_noise, smooth_step


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
