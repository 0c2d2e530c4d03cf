"""Rates, losses and gaps of stamps that are made up."""

import numpy as np
import pytest

from offpiste.inspection.timing import timing


def test_timing_of_even_stamps() -> None:
    seen = timing(np.arange(0, 10, 0.02), max_gap=0.5)
    assert seen.rate == pytest.approx(50)
    assert (seen.repeated, seen.backward, seen.gaps) == (0, 0, ())
    assert seen.lost == 0
    assert seen.jitter < 1e-6


def test_timing_of_bunches_counts_all_samples() -> None:
    seen = timing(np.repeat(np.arange(0, 10, 0.04), 2), max_gap=0.5)
    assert seen.rate == pytest.approx(50, rel=0.02)
    assert seen.lost == 0


def test_timing_of_periods_that_alternate_counts_all_samples() -> None:
    time = np.cumsum(np.tile([0.10, 0.10, 0.11], 50))
    assert timing(time, max_gap=0.5).rate == pytest.approx(1 / 0.1033, rel=0.005)


@pytest.mark.parametrize(("rate", "step"), [(30, 0.01), (40, 0.01), (70, 0.005), (15, 0.01)])
def test_stamps_in_steps_of_a_clock_are_no_losses(rate: float, step: float) -> None:
    time = np.round(np.arange(0, 60, 1 / rate) / step) * step
    assert timing(time, max_gap=0.5).lost == 0
