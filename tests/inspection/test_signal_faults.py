"""Faults within single signals, and signals that only look like them."""

import numpy as np
import pytest

from offpiste.inspection.signal_faults import degrees_each, find_spikes, find_wrap

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
    ("latitude", "longitude", "each"),
    [
        (481_500_000, 115_800_000, 1e-7),
        (-338_600_000, 1_512_100_000, 1e-7),
        (0, 0, 1),
        (48.15, 11.58, 1),
        (1.35, 103.8, 1),
        (0.84, 0.2, np.rad2deg(1)),
        (-0.59, 2.6, np.rad2deg(1)),
        (481_500_000.5, 115_800_000, 1),
        (981_500_000, 115_800_000, 1),
        (np.nan, 115_800_000, 1),
    ],
    ids=[
        *("north", "south", "no fix", "degrees", "Singapore", "radians", "radians in the south"),
        *("no integer", "no latitude", "unknown"),
    ],
)
def test_what_one_of_a_latitude_is_in_degrees(latitude: float, longitude: float, each: float) -> None:
    before_the_fix = np.zeros(5)
    places = (np.concatenate((before_the_fix, np.full(20, value))) for value in (latitude, longitude))
    assert degrees_each(*places) == pytest.approx(each)
