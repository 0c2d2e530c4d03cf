"""Estimators of lags and of sensor misalignments against known answers."""

import numpy as np
import pytest

from offpiste.calibration.misfit import PRIOR, Pair, fit_misfit, turned
from offpiste.inspection.lags import LAGS, fit_lags, jackknife


def _wave(random: np.random.Generator, count: int) -> np.ndarray:
    return np.convolve(random.standard_normal(count + 40), np.hanning(21) / 10, "same")[20:-20]


def _lagged(signal: np.ndarray) -> np.ndarray:
    rows = np.rint(LAGS / 0.05).astype(int)
    at = np.arange(len(signal))[None] - rows[:, None]
    return np.where((at >= 0) & (at < len(signal)), signal[np.clip(at, 0, len(signal) - 1)], np.nan)


@pytest.mark.parametrize(("gain", "delay"), [(2.0, 0.3), (-0.7, -0.45), (1.0, 0.0)])
def test_gain_sign_and_delay_come_out_together_within_their_errors(gain: float, delay: float) -> None:
    random = np.random.default_rng(3)
    source = _wave(random, 2000)
    drag = _wave(random, 2000)
    target = gain * np.roll(source, round(delay / 0.05)) + 0.5 * drag + 0.2 * random.standard_normal(2000)
    fit = fit_lags(target, drag[:, None], _lagged(source), LAGS, np.ones(2000, bool))
    assert fit is not None
    best = fit.best()
    estimate, sigma = fit.delay(best)
    assert abs(estimate - delay) < 4 * sigma + 0.01
    assert sigma < 0.03
    assert abs(fit.gain[best] - gain) < 4 * fit.gain_sigma(best)
    assert fit.gain_sigma(best) < 0.1 * abs(gain)


def test_the_jackknife_of_a_mean_is_its_standard_error() -> None:
    values = np.random.default_rng(2).standard_normal(50)
    left_out = (values.sum() - values) / 49
    assert jackknife(left_out) == pytest.approx(values.std(ddof=1) / np.sqrt(50))
    assert jackknife(left_out[:1]) == np.inf


TRUE = np.array([0.02, -0.03, 0.01, 0.05])


def pairs(parameters, *, seed=0, count=20, rows=50, noise=1e-3, blind=(), outliers=0.0):
    """Residuals that vanish at TRUE."""
    rng, made = np.random.default_rng(seed), []
    for _ in range(count):
        slope = rng.standard_normal((rows, 4))
        slope[:, list(blind)] = 0
        residual = slope @ (parameters - TRUE) + noise * rng.standard_normal(rows)
        residual[: int(outliers * rows)] += 5.0
        made.append(Pair(residual, slope))
    return made


def test_finds_what_was_planted_within_its_own_uncertainty():
    errors = []
    for seed in range(30):
        found = fit_misfit(lambda p, seed=seed: pairs(p, seed=seed))
        errors.append((found.parameters - TRUE) / found.sigma)
    spread = np.std(errors, axis=0)
    assert ((spread > 0.3) & (spread < 1.3)).all()  # it may say too much, and hardly too little
    assert found.pairs == 20
    np.testing.assert_allclose(found.scale, 1e-3, rtol=0.1)


def test_a_fifth_of_outliers_does_not_move_it():
    found = fit_misfit(lambda p: pairs(p, outliers=0.2))
    np.testing.assert_allclose(found.parameters, TRUE, atol=5e-4)


def test_what_the_data_do_not_show_stays_as_uncertain_as_the_prior():
    found = fit_misfit(lambda p: pairs(p, blind=(0, 3)))
    np.testing.assert_allclose(found.parameters[[0, 3]], 0, atol=1e-9)
    np.testing.assert_allclose(found.sigma[[0, 3]], PRIOR[[0, 3]], rtol=1e-6)
    np.testing.assert_allclose(found.parameters[[1, 2]], TRUE[[1, 2]], atol=5e-4)


def test_a_mounting_turns_about_the_axes_of_the_body_where_it_is():
    given = np.eye(4)
    given[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]  # x of the sensor looks to the left
    given[:3, 3] = 1, 2, 3
    matrix = turned(given, np.array([0, 0, np.pi / 2, 0.1]))
    np.testing.assert_allclose(matrix[:3, 0], [-1, 0, 0], atol=1e-12)  # now back
    np.testing.assert_allclose(matrix[:3, 3], [1, 2, 3])
