"""The bivariate t: against numerical integration, sampling and brute force."""

import itertools

import numpy as np
import pytest
import torch
from scipy import integrate, stats

from offpiste.uncertainty.student import (
    area_under_curve,
    crps,
    negative_log_likelihood,
    probability_within,
    radius,
    squared_distance,
)

FREEDOM = 4.5
SCALE = torch.tensor([0.5, 2.0], dtype=torch.float64)


def density(x: float, y: float) -> float:
    error = torch.tensor([x, y], dtype=torch.float64)
    return float(torch.exp(-negative_log_likelihood(error, SCALE, torch.tensor(FREEDOM))))


def test_the_likelihood_is_scipys():
    theirs = stats.multivariate_t(shape=np.diag(SCALE.numpy() ** 2), df=FREEDOM)
    for x, y in ((0.0, 0.0), (0.3, -1.0), (-4.0, 9.0)):
        assert density(x, y) == pytest.approx(theirs.pdf([x, y]), rel=1e-6)


@pytest.mark.parametrize("probability", [0.5, 0.8, 0.95])
def test_regions_hold_their_share(probability: float):
    reach = radius(probability, FREEDOM)
    assert probability_within(np.array(reach**2), FREEDOM) == pytest.approx(probability)
    drawn = stats.multivariate_t(shape=np.diag(SCALE.numpy() ** 2), df=FREEDOM, seed=0).rvs(200_000)
    squared = squared_distance(torch.from_numpy(drawn), SCALE.expand(200_000, 2)).numpy()
    assert (squared <= reach**2).mean() == pytest.approx(probability, abs=0.004)


@pytest.mark.parametrize("error", [0.0, 0.7, -6.0])
def test_crps_is_the_integral_of_squared_differences(error: float):
    scale = 1.3

    def difference(x: float) -> float:
        return float(stats.t.cdf(x / scale, FREEDOM) - (x >= error)) ** 2

    below, _ = integrate.quad(difference, -np.inf, error)
    above, _ = integrate.quad(difference, error, np.inf)
    assert crps(np.array(error), np.array(scale), FREEDOM) == pytest.approx(below + above, rel=1e-6)


def test_the_area_under_the_curve_counts_pairs():
    rng = np.random.default_rng(0)
    score, positive = rng.integers(0, 5, 60).astype(float), rng.random(60) < 0.3
    pairs = list(itertools.product(score[positive], score[~positive]))
    wanted = np.mean([1.0 if a > b else 0.5 if a == b else 0.0 for a, b in pairs])
    assert area_under_curve(score, positive) == pytest.approx(wanted)
    assert np.isnan(area_under_curve(score, np.zeros(60, bool)))
