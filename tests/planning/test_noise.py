"""Noise against its stated moments and spectra."""

import numpy as np
import pytest
import torch

from factories import torch_threads
from offpiste.planning import noise
from offpiste.planning.noise import coloured, spectrum, threefry


def drawn(shape, seed=0, **options):
    return coloured(shape, torch.Generator().manual_seed(seed), torch.float64, **options)


def test_a_seed_repeats_on_any_number_of_threads_and_another_does_not():
    draws = []
    for count in (1, 3):
        with torch_threads(count):
            draws.append(drawn((100, 12, 2)))
    assert torch.equal(*draws)
    assert not torch.allclose(draws[0], drawn((100, 12, 2), seed=1))
    assert len(draws[0].flatten().unique()) == draws[0].numel(), "no part repeats another"


def test_random_numbers_are_those_that_the_authors_of_threefry_list():
    none, ones = threefry((0,) * 4, (0,) * 4), threefry((2**32 - 1,) * 4, (2**32 - 1,) * 4)
    assert [int(part) for part in none] == [0x9C6CA96A, 0xE17EAE66, 0xFC10ECD4, 0x5256A7D8]
    assert [int(part) for part in ones] == [0x2A881696, 0x57012287, 0xF6C7446E, 0xA16A6732]


@pytest.mark.parametrize(
    ("shape", "options"),
    [
        ((100, 12, 2), {}),
        ((33, 7, 3), {"period": 14, "exponent": 1.0}),
        ((5, 251, 1), {}),  # a period with a large prime factor
        ((40, 11, 2), {"period": 11, "highest": 3}),
        ((1, 1, 1), {}),
        ((65, 30, 1), {"period": 30}),
        ((3, 21, 4), {"period": 21}),
    ],
)
def test_the_library_draws_what_numpy_draws(shape, options, monkeypatch):
    found = coloured(shape, torch.Generator().manual_seed(3), **options)
    monkeypatch.setattr(noise, "library", lambda: None)
    wanted = coloured(shape, torch.Generator().manual_seed(3), **options)
    np.testing.assert_allclose(found, wanted, atol=4e-6)


def test_noise_does_not_depend_on_the_default_type():
    found, before = drawn((40, 12, 2)), torch.get_default_dtype()
    torch.set_default_dtype(torch.float64)
    try:
        assert torch.equal(drawn((40, 12, 2)), found)
    finally:
        torch.set_default_dtype(before)


def test_every_step_has_mean_0_and_variance_1_and_controls_are_independent():
    values = drawn((40_000, 16, 2))
    torch.testing.assert_close(values.mean(0), torch.zeros(16, 2).double(), atol=0.03, rtol=0)
    torch.testing.assert_close(values.var(0), torch.ones(16, 2).double(), atol=0.08, rtol=0)
    assert values.prod(dim=-1).mean(0).abs().max() < 0.05


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.5])
@pytest.mark.parametrize("steps", [32, 33])
def test_coloured_noise_has_the_stated_spectrum(exponent, steps):
    values = drawn((20_000, steps, 1), exponent=exponent, period=steps)[..., 0]
    power = torch.fft.rfft(values, dim=1).abs().square().mean(0)
    torch.testing.assert_close(power, spectrum(steps, exponent), rtol=0.05, atol=0)
    step = torch.arange(1, steps // 2 + 1)
    slope = torch.log(power[1:] / power[1]) / torch.log(step.double())
    torch.testing.assert_close(slope[1:], torch.full((len(step) - 1,), -exponent).double(), atol=0.05, rtol=0)


def test_frequencies_above_the_highest_have_no_power():
    values = drawn((20_000, 32, 1), exponent=1.0, period=32, highest=6)[..., 0]
    power = torch.fft.rfft(values, dim=1).abs().square().mean(0)
    torch.testing.assert_close(power[:7], spectrum(32, 1.0, 6), rtol=0.05, atol=0)
    assert power[7:].max() < 1e-8
    torch.testing.assert_close(values.var(0), torch.ones(32).double(), atol=0.08, rtol=0)


@pytest.mark.parametrize(("steps", "period"), [(0, None), (10, 9)])
def test_a_period_of_nothing_or_shorter_than_the_steps_is_refused(steps, period):
    with pytest.raises(ValueError, match="must be positive, and at least the number of steps"):
        drawn((4, steps, 2), period=period)
