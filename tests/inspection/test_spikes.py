"""Isolated spikes, and signals that only look like some."""

import numpy as np
import pytest

from offpiste.inspection.spikes import find_spikes

TIME = np.arange(0, 60, 0.02)
SMOOTH = 150 + 100 * np.sin(TIME) + np.random.default_rng(0).standard_normal(len(TIME))


def test_spikes_are_found_where_they_are() -> None:
    values = SMOOTH.copy()
    at = [100, 900, 901, 2500]
    values[at] = 5000, -4000, -3500, 900
    assert np.flatnonzero(find_spikes(values)).tolist() == at


@pytest.mark.parametrize(
    "values",
    [
        SMOOTH,
        np.where(np.sin(5 * TIME) > 0.9, 1.0, 0.0),
        np.random.default_rng(2).standard_normal(3000) ** 3,
        np.round(SMOOTH / 20),
        np.clip(np.sin(20 * TIME), 0.9, 1),
    ],
    ids=["smooth", "switch", "rough ground", "quantised", "bumps"],
)
def test_what_is_no_spike(values: np.ndarray) -> None:
    assert not find_spikes(values).any()


def test_large_spikes_do_not_hide_smaller_ones() -> None:
    values = np.sin(np.arange(2000) / 20)
    large, small = np.arange(50, 1950, 130), np.arange(100, 1950, 130)
    values[large], values[small] = 300.0, -6.0
    assert np.flatnonzero(find_spikes(values)).tolist() == sorted([*large, *small])


@pytest.mark.parametrize("at", [0, -1])
def test_the_first_and_the_last_sample_may_be_spikes(at: int) -> None:
    values = np.sin(np.arange(500) / 20)
    values[at] = 30.0
    assert np.flatnonzero(find_spikes(values)).tolist() == [at % 500]


def test_dips_among_usual_values_are_no_spikes_beside_large_ones() -> None:
    """A wheel that locks for a sample comes to a speed that it has at other times."""
    values = SMOOTH.copy()
    at = np.arange(100, 2900, 140)
    values[at] = 4000.0
    dips = np.flatnonzero(SMOOTH > 245)[::12]
    values[dips] -= 130.0
    assert np.flatnonzero(find_spikes(values)).tolist() == at.tolist()
