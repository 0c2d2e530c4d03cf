"""Spreads: their growth, their inputs, their fit to drawn errors, and the bivariate t against numerical integration."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import integrate, stats
from torch.nn import functional

from factories import VEHICLE
from offpiste.core.state import Terrain, Trajectory
from offpiste.uncertainty.calibration import area_under_curve, crps
from offpiste.uncertainty.fit import Residuals, fit_factor, fit_network
from offpiste.uncertainty.spread import (
    INTERVAL,
    MOTION,
    Spread,
    errors_in_heading,
    inputs_of,
    negative_log_likelihood,
    probability_within,
    radius,
    spread_inputs,
    states_at_moments,
)

MOMENTS = 25


def test_it_grows_as_worked_by_hand_and_does_not_look_ahead():
    spread = Spread(1)
    with torch.no_grad():
        spread.layers[2].weight.zero_()
        spread.layers[2].bias.copy_(torch.tensor([0.3, -1.0]))
    scale = spread(torch.zeros(1, MOMENTS, 1))[0]
    rate, begin = (float(functional.softplus(torch.tensor(value))) for value in (0.3, -2.0))
    first = math.sqrt(begin**2 + rate**2 * INTERVAL) * INTERVAL
    second = first + math.sqrt(begin**2 + 2 * rate**2 * INTERVAL) * INTERVAL
    assert scale[:2, 0].tolist() == pytest.approx([first, second])
    torch.manual_seed(0)
    spread, inputs = Spread(3), torch.randn(4, MOMENTS, 3)
    later = inputs.clone()
    later[:, 10:] += 5
    one, other = spread(inputs), spread(later)
    assert (one.diff(dim=1) > 0).all()
    assert torch.equal(one[:, :10], other[:, :10])
    assert not torch.allclose(one[:, 10:], other[:, 10:])


def moments(seed: int = 0, turned: float = 0.0) -> tuple[torch.Tensor, torch.Tensor, Terrain]:
    """Random moments, in a world that is turned about the vertical."""
    generator = torch.Generator().manual_seed(seed)

    def normal(*size: int) -> torch.Tensor:
        return torch.randn(*size, generator=generator, dtype=torch.float64)

    state, lean = normal(5, MOMENTS, 6), 0.2 * normal(5, MOMENTS, 4, 2)
    up = torch.cat((lean, torch.ones_like(lean[..., :1])), dim=-1)
    up = up / up.norm(dim=-1, keepdim=True)
    cos, sin = math.cos(turned), math.sin(turned)
    turn = torch.tensor([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]], dtype=torch.float64)
    state[..., 2] += turned
    known = torch.rand(5, MOMENTS, 4, generator=generator) < 0.7
    control = normal(5, MOMENTS, len(VEHICLE.control_columns))
    return state, control, Terrain(up @ turn.T, known, normal(5, MOMENTS, 4, 2))


def test_inputs_depend_neither_on_the_orientation_of_the_world_nor_on_absent_commands():
    one, other = (spread_inputs(VEHICLE, *moments(turned=angle)) for angle in (0.0, 1.1))
    assert one.shape[-1] == inputs_of(VEHICLE, 2)
    torch.testing.assert_close(one, other)
    lacking, given = replace(VEHICLE, control=VEHICLE.control[:-1]), moments()
    given[1][..., -1] = torch.nan
    assert torch.isfinite(spread_inputs(lacking, *given)).all()


def test_uphill_is_positive_and_unknown_ground_is_level():
    state = torch.zeros(1, 1, 6)
    lean = torch.tensor([-0.6, 0.0, 0.8]).expand(1, 1, 4, 3)
    for known, along, unknown in ((True, 0.6, 0.0), (False, 0.0, 1.0)):
        terrain = Terrain(lean, torch.full((1, 1, 4), known), torch.zeros(1, 1, 4, 0))
        control = torch.zeros(1, 1, len(VEHICLE.control_columns))
        read = dict(zip(MOTION, spread_inputs(VEHICLE, state, control, terrain)[0, 0].tolist(), strict=False))
        assert read["slope_along"] == pytest.approx(along)
        assert read["unknown"] == unknown


def test_errors_are_along_and_across_the_predicted_heading():
    predicted = torch.zeros(1, 250, 6)
    predicted[..., 2] = math.pi / 2
    target = predicted.clone()
    target[..., 0], target[..., 1] = 1.0, 3.0
    assert errors_in_heading(predicted, target)[0, -1].tolist() == pytest.approx([3.0, -1.0], abs=1e-6)
    steps = torch.arange(1.0, 251).reshape(1, 250, 1).expand(1, 250, 6)
    moments = states_at_moments(torch.zeros(1, 6), Trajectory(steps, steps[..., :4]))
    assert moments[0, :, 0].tolist() == [0, *range(10, 250, 10)], "the start, and not the end"


def test_the_scales_of_drawn_errors_are_recovered():
    rng = np.random.default_rng(0)
    rough = rng.integers(0, 2, 3000).astype(np.float32)
    growth = np.linspace(0.2, 5, MOMENTS) ** 1.5
    true = (0.1 + 0.4 * rough)[:, None] * growth
    error = torch.from_numpy((true[..., None] * rng.standard_t(6, (3000, MOMENTS, 2))).astype(np.float32))
    inputs = torch.from_numpy(rough)[:, None, None].expand(-1, MOMENTS, 1).clone()
    spread = Spread(1)
    fit_network(spread, Residuals(inputs, error), rng, steps=600, batch=256, learning_rate=1e-2)
    found = spread(torch.tensor([0.0, 1.0])[:, None, None].expand(2, MOMENTS, 1))[:, -1, 0]
    wanted = torch.tensor([0.1, 0.5]) * float(growth[-1])
    torch.testing.assert_close(found, wanted, rtol=0.15, atol=0)
    fit_factor(spread, Residuals(inputs, 2 * error))
    assert float(spread.factor) == pytest.approx(2, rel=0.1)


FREEDOM = 4.5
SCALE = torch.tensor([0.5, 2.0], dtype=torch.float64)


@pytest.mark.parametrize("probability", [0.5, 0.95])
def test_the_likelihood_equals_scipys_and_regions_contain_their_share(probability: float):
    errors = torch.tensor([[0.0, 0.0], [0.3, -1.0], [-4.0, 9.0]], dtype=torch.float64)
    density = torch.exp(-negative_log_likelihood(errors, SCALE.expand(3, 2), torch.tensor(FREEDOM)))
    theirs = stats.multivariate_t(shape=np.diag(SCALE.numpy() ** 2), df=FREEDOM)
    np.testing.assert_allclose(density, theirs.pdf(errors.numpy()), rtol=1e-6)
    reach = radius(probability, FREEDOM)
    assert probability_within(np.array(reach**2), FREEDOM) == pytest.approx(probability)
    drawn = stats.multivariate_t(shape=np.diag(SCALE.numpy() ** 2), df=FREEDOM, seed=0).rvs(200_000)
    squared = np.square(drawn / SCALE.numpy()).sum(axis=-1)
    assert (squared <= reach**2).mean() == pytest.approx(probability, abs=0.004)


@pytest.mark.parametrize("error", [0.7, -6.0])
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
