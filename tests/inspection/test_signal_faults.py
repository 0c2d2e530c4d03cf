"""Faults within single signals, and signals that only look like them."""

import numpy as np
import pytest

from offpiste.inspection.signal_faults import counts_degrees, find_spikes, find_wrap

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


@pytest.mark.parametrize(("period", "scale"), [(65536.0, 100.0), (6553.6, 10.0), (655.36, 1.0)])
def test_wraps_of_sixteen_bits_in_runs(period: float, scale: float) -> None:
    counts = np.round((SMOOTH - 80) * scale) / 10
    wrap = find_wrap(np.where(counts < 0, counts + period, counts))
    assert wrap is not None
    assert wrap.period == period
    assert counts.max() < wrap.above < counts.min() + period


def test_a_pedal_that_idles_below_zero_wraps_most_of_the_time() -> None:
    rng = np.random.default_rng(2)
    pressed = np.clip(3000 * np.sin(TIME / 5), 0, None) * (np.sin(TIME / 3) > 0.6)
    counts = np.round(pressed - 150 + 40 * rng.standard_normal(len(TIME)))
    assert (counts < 0).mean() > 0.7
    wrap = find_wrap(np.where(counts < 0, counts + 65536, counts) / 10)
    assert wrap is not None
    assert wrap.period == 6553.6


@pytest.mark.parametrize(
    "values",
    [
        np.where(np.random.default_rng(3).random(3000) < 0.02, 0.0, 6550.0 + SMOOTH / 100),
        SMOOTH,
        np.linspace(0, 65535, 3000),
        np.where(np.sin(TIME) > 0, 6500.0, 0.0),
        np.abs(SMOOTH) * 40,
        np.random.default_rng(1).uniform(0, 6553, 3000),
    ],
    ids=["dropouts", "smooth", "counter", "switch", "engine", "noise"],
)
def test_what_is_no_wrap(values: np.ndarray) -> None:
    assert find_wrap(values) is None


@pytest.mark.parametrize(
    ("latitude", "longitude", "counted"),
    [
        (481_500_000, 115_800_000, True),
        (-338_600_000, 1_512_100_000, True),
        (0, 0, False),
        (48.15, 11.58, False),
        (481_500_000.5, 115_800_000, False),
        (981_500_000, 115_800_000, False),
        (np.nan, 115_800_000, False),
    ],
    ids=["north", "south", "no fix", "degrees", "no integer", "no latitude", "unknown"],
)
def test_degrees_that_are_counted(latitude: float, longitude: float, counted: bool) -> None:
    before_the_fix = np.zeros(5)
    places = (np.concatenate((before_the_fix, np.full(20, each))) for each in (latitude, longitude))
    assert counts_degrees(*places) is counted
