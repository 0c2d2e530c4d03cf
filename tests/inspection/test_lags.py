"""Gain, sign and delay estimated together, and their uncertainties."""

import numpy as np
import pytest
from simulated import rig

from offpiste.inspection.lags import LAGS, LagFit, check_delay, fit_lags, jackknife


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


def test_one_lag_is_a_plain_partial_regression() -> None:
    random = np.random.default_rng(0)
    x, base = random.standard_normal(400), random.standard_normal((400, 3))
    y = 1.3 * x + base @ [0.5, -2.0, 1.0] + 0.1 * random.standard_normal(400)
    fit = fit_lags(y, base, x[None], np.zeros(1), np.ones(400, bool))
    assert fit is not None
    expected = np.linalg.lstsq(np.column_stack((x, base)), y, rcond=None)[0][0]
    assert fit.gain[0] == pytest.approx(expected, rel=1e-3)


def test_glitches_hardly_move_it() -> None:
    random = np.random.default_rng(1)
    source = _wave(random, 1500)
    target = source + 0.05 * random.standard_normal(1500)
    target[700:706] = 1e4
    fit = fit_lags(target, np.zeros((1500, 0)), _lagged(source), LAGS, np.ones(1500, bool))
    assert fit is not None
    assert abs(fit.delay(fit.best())[0]) < 0.02


def test_each_block_is_left_out_as_if_it_had_not_been_driven() -> None:
    random = np.random.default_rng(4)
    source, base = _wave(random, 1000), random.standard_normal((1000, 2))
    source[200:300] *= 30  # a block that outweighs all others
    target = source + base @ [0.3, -0.2] + 0.1 * random.standard_normal(1000)
    rows = np.arange(1000) >= 40
    fit = fit_lags(target, base, _lagged(source), LAGS, rows)
    assert fit is not None
    assert fit.left_out.shape == (10, len(LAGS))
    for block in range(10):
        other = fit_lags(target, base, _lagged(source), LAGS, rows & (np.arange(1000) // 100 != block))
        assert other is not None
        np.testing.assert_allclose(fit.left_out[block], other.r, atol=1e-3)  # glitches are weighed anew
        np.testing.assert_allclose(fit.gain_left_out[block], other.gain, atol=2e-3)


def test_a_block_without_which_nothing_varies_is_not_left_out() -> None:
    random = np.random.default_rng(4)
    source = np.where(np.arange(1000) // 100 == 5, 1e4 * random.standard_normal(1000), 0.0)
    rows = np.abs(np.arange(1000) - 550) < 400
    fit = fit_lags(source, np.zeros((1000, 0)), source[None], np.zeros(1), rows)
    assert fit is not None
    assert len(fit.left_out) == 8


def test_the_jackknife_of_a_mean_is_its_standard_error() -> None:
    values = np.random.default_rng(2).standard_normal(50)
    left_out = (values.sum() - values) / 49
    assert jackknife(left_out) == pytest.approx(values.std(ddof=1) / np.sqrt(50))
    assert jackknife(left_out[:1]) == np.inf


@pytest.mark.parametrize(("spread", "found"), [(0.002, 1), (0.05, 0)])
def test_a_delay_counts_where_all_blocks_agree_that_it_explains_more(spread: float, found: int) -> None:
    """0.09 of the variance more, by blocks that differ little or much."""
    before = -0.3
    r = np.where(np.isclose(LAGS, before), 0.5, np.where(np.abs(LAGS - before) < 0.16, 0.48, 0.4))
    blocks = 1 + spread * np.random.default_rng(5).standard_normal((20, 1)) * (LAGS < -0.08)
    fit = LagFit(LAGS, r, r, 1000, r * blocks, r * blocks)
    findings = check_delay("brake", fit, (-0.07, 0.5), rig(), usual=0.06, clear=0.3)
    assert [f.what for f in findings] == ["is stamped after the motion that it causes"] * found
