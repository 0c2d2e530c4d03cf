"""Noise against its stated moments and spectra."""

from functools import partial

import pytest
import torch

from offpiste.planning.noise import coloured, covariance, gaussian, lifted, spectrum

NOISES = [gaussian, coloured, lifted]


def drawn(noise, shape, seed=0, **options):
    return noise(shape, torch.Generator().manual_seed(seed), torch.float64, **options)


@pytest.mark.parametrize("noise", NOISES)
def test_a_seed_repeats_and_another_does_not(noise):
    shape = (5, 12, 2)
    assert drawn(noise, shape).shape == shape
    assert torch.equal(drawn(noise, shape), drawn(noise, shape))
    assert not torch.allclose(drawn(noise, shape), drawn(noise, shape, seed=1))


def test_samples_are_the_same_on_any_number_of_threads():
    draws, threads = [], torch.get_num_threads()
    for count in (1, 3):
        torch.set_num_threads(count)
        draws.append(drawn(coloured, (100, 12, 2)))
    torch.set_num_threads(threads)
    assert torch.equal(*draws)
    assert len(draws[0].flatten().unique()) == draws[0].numel(), "no part repeats another"


@pytest.mark.parametrize("noise", [gaussian, coloured])
def test_every_step_has_mean_0_and_variance_1(noise):
    values = drawn(noise, (40_000, 16, 1))[..., 0]
    torch.testing.assert_close(values.mean(0), torch.zeros(16).double(), atol=0.03, rtol=0)
    torch.testing.assert_close(values.var(0), torch.ones(16).double(), atol=0.08, rtol=0)


@pytest.mark.parametrize("noise", NOISES)
def test_controls_are_independent(noise):
    a, b = drawn(noise, (20_000, 4, 2)).unbind(-1)
    assert (a * b).mean(0).abs().max() < 0.05


def test_gaussian_steps_are_independent():
    values = drawn(gaussian, (40_000, 3, 1))[..., 0]
    assert (torch.corrcoef(values.T) - torch.eye(3)).abs().max() < 0.02


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.5])
@pytest.mark.parametrize("steps", [32, 33])
def test_coloured_noise_has_the_stated_spectrum(exponent, steps):
    values = drawn(coloured, (20_000, steps, 1), exponent=exponent, period=steps)[..., 0]
    power = torch.fft.rfft(values, dim=1).abs().square().mean(0)
    torch.testing.assert_close(power, spectrum(steps, exponent), rtol=0.05, atol=0)
    step = torch.arange(1, steps // 2 + 1)
    slope = torch.log(power[1:] / power[1]) / torch.log(step.double())
    torch.testing.assert_close(slope[1:], torch.full((len(step) - 1,), -exponent).double(), atol=0.05, rtol=0)


@pytest.mark.parametrize(
    "noise",
    [
        gaussian,
        coloured,
        partial(coloured, exponent=1.0, period=10),
        partial(coloured, exponent=0.5, period=31),
        lifted,
        partial(lifted, noise=partial(coloured, exponent=1.0)),
    ],
)
def test_covariance_is_that_of_the_noise_drawn(noise):
    values, wanted = drawn(noise, (40_000, 10, 1))[..., 0], covariance(noise, 10)
    # The deviation of an estimated covariance: sqrt((c_ij^2 + c_ii c_jj) / samples).
    deviation = torch.sqrt((wanted.square() + torch.outer(wanted.diag(), wanted.diag())) / len(values))
    assert ((torch.cov(values.T) - wanted).abs() / deviation).max() < 4.5
    assert torch.linalg.eigvalsh(wanted).min() > 0


def test_covariance_of_coloured_noise_of_hand_worked_spectrum():
    # Frequencies 0, 1, 2 of a period of 4, of powers 1, 1, 1 / 2: 1 + 2 cos(pi lag / 2) + cos(pi lag) / 2 of 3.5.
    wanted = torch.tensor([3.5, 0.5, -0.5, 0.5]).double() / 3.5
    torch.testing.assert_close(covariance(partial(coloured, exponent=1.0, period=4), 4)[0], wanted)


def test_a_covariance_that_cannot_be_inverted_is_refused():
    assert torch.linalg.cond(covariance(coloured, 250)) < 250**2 * 2
    with pytest.raises(ValueError, match="exponent 5 over 500 steps has no exact inverse"):
        covariance(partial(coloured, exponent=5.0), 250)


def test_exponent_0_is_white():
    covariance = torch.cov(drawn(coloured, (40_000, 6, 1), exponent=0.0)[..., 0].T)
    assert (covariance - torch.eye(6)).abs().max() < 0.03


def test_nothing_above_the_highest_frequency():
    values = drawn(coloured, (20_000, 32, 1), exponent=1.0, period=32, highest=6)[..., 0]
    power = torch.fft.rfft(values, dim=1).abs().square().mean(0)
    torch.testing.assert_close(power[:7], spectrum(32, 1.0, 6), rtol=0.05, atol=0)
    assert power[7:].max() < 1e-20
    torch.testing.assert_close(values.var(0), torch.ones(32).double(), atol=0.08, rtol=0)


def test_a_period_shorter_than_the_steps_is_refused():
    with pytest.raises(ValueError, match="at least as many"):
        drawn(coloured, (1, 10, 1), period=9)


def test_lifted_noise_grows_like_a_random_walk():
    values = drawn(lifted, (40_000, 25, 1))[..., 0]
    torch.testing.assert_close(values.var(0), torch.arange(1, 26).double() / 25, atol=0, rtol=0.05)
    torch.testing.assert_close(values.diff(dim=1).std(0), torch.full((24,), 0.2).double(), atol=0, rtol=0.05)


def test_lifted_noise_is_the_sum_of_the_noise_that_it_is_given():
    noise = partial(coloured, exponent=1.0)
    values = drawn(partial(lifted, noise=noise), (3, 4, 2))
    torch.testing.assert_close(values.diff(dim=1) * 2, drawn(noise, (3, 4, 2))[:, 1:])
