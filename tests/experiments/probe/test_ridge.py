"""Linear probes against closed forms, on data whose answer is known."""

import numpy as np

from experiments.probe.ridge import PENALTIES, fit_ridge, score
from offpiste.evaluation.intervals import resampling

N = 4000


def linear(noise: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Features of several sizes, and 3 + f . (2, -1, 0) / their sizes with noise: variance 5 + noise^2."""
    rng = np.random.default_rng(seed)
    standard = rng.normal(size=(N, 3))
    y = 3 + standard @ np.array([2.0, -1.0, 0.0]) + noise * rng.normal(size=N)
    return standard * [1.0, 100.0, 0.01] + [0.0, 500.0, 1.0], y


def folds(n: int = N) -> np.ndarray:
    return np.arange(n) * 5 // n


def drawn(n: int = N, blocks: int = 40):
    return resampling(np.zeros(n, np.int64), np.arange(n) * blocks // n, 0)


def test_the_fit_is_the_textbooks() -> None:
    x, y = linear(noise=1.0)
    ridge = fit_ridge(x, y, folds(), penalties=(0.3,))
    standard = (x - x.mean(axis=0)) / x.std(axis=0)
    wanted = np.linalg.solve(standard.T @ standard + 0.3 * N * np.eye(3), standard.T @ (y - y.mean()))
    np.testing.assert_allclose(ridge.weights, wanted, rtol=1e-9)
    np.testing.assert_allclose(ridge.predict(x), y.mean() + standard @ wanted, rtol=1e-9)


def test_a_constant_feature_changes_nothing_even_where_it_varies_later() -> None:
    x, y = linear(noise=1.0)
    with_constant = np.column_stack((x, np.full(N, 7.0)))
    ridge = fit_ridge(with_constant, y, folds())
    later = with_constant.copy()
    later[:, 3] = 1e6
    np.testing.assert_allclose(ridge.predict(later), fit_ridge(x, y, folds()).predict(x), rtol=1e-9)


def test_features_that_say_nothing_are_penalised_until_little_is_left() -> None:
    rng = np.random.default_rng(3)
    x, y = rng.normal(size=(100, 60)), rng.normal(size=100)
    ridge = fit_ridge(x, y, folds(100))
    assert ridge.penalty >= 1.0
    free = fit_ridge(x, y, folds(100), penalties=(PENALTIES[0],))
    fresh, target = rng.normal(size=(N, 60)), rng.normal(size=N)
    assert score(target, ridge.predict(fresh), drawn()).r2 > score(target, free.predict(fresh), drawn()).r2 + 0.3
