"""Rows between a slower sensor's samples are parted from lost ones; stamps increase, and cost the fewest rows."""

from itertools import combinations
from time import process_time

import numpy as np
import pytest

from offpiste.logs.channel import between_samples, brought_together, increasing


def _rows_of(rate: float, seconds: float = 30.0, table: float = 100.0) -> np.ndarray:
    """Which rows of a table hold no sample of a sensor of this rate [Hz]."""
    slot = np.floor(np.arange(0, seconds, 1 / table) * rate + 1e-9)
    return np.append(False, np.diff(slot) == 0)


@pytest.mark.parametrize("rate", [4.0, 10.0, 30.0, 37.0, 50.0, 66.0, 80.0])
def test_a_slower_sensor_leaves_rows_empty(rate: float) -> None:
    empty = _rows_of(rate)
    assert empty.mean() == pytest.approx(1 - rate / 100, abs=0.02)
    np.testing.assert_array_equal(between_samples(empty), empty)


@pytest.mark.parametrize("apart", [0.003, -0.003, 0.02])
def test_parts_in_rows_of_their_own_are_brought_together(apart: float) -> None:
    each = 0.05 * np.arange(100)
    time, parts = np.concatenate([each, each + apart]), np.full((200, 2), np.nan)
    parts[:100, 0], parts[100:, 1] = each, -each
    order = np.argsort(time)
    found = brought_together(time[order], parts[order])
    whole = np.isfinite(found).all(axis=1)
    if abs(apart) > 0.01:
        assert not whole.any()
        return
    np.testing.assert_array_equal(found[whole], np.column_stack([each, -each]))
    assert np.isnan(found[~whole]).all()
    np.testing.assert_array_equal(time[order][whole], each)


def test_rows_that_hold_all_parts_are_left_as_they_are() -> None:
    time, values = 0.005 * np.arange(100), np.random.default_rng(0).normal(size=(100, 2))
    values[::3, 0], values[1::3, 1] = np.nan, np.nan
    np.testing.assert_array_equal(brought_together(time, values), values)


@pytest.mark.parametrize("share", [0.05, 0.2, 0.5, 0.8])
def test_rows_that_are_lost_at_random_are_lost(share: float) -> None:
    empty = np.random.default_rng(0).random(5000) < share
    assert not between_samples(empty).any()


def test_what_a_slower_sensor_loses_is_no_row_between_its_samples() -> None:
    empty, lost = _rows_of(20.0), np.zeros(3000, bool)
    lost[1001:1100] = True
    found = between_samples(empty | lost)
    assert not found[lost].any()
    np.testing.assert_array_equal(found[:990], empty[:990])


def test_one_run_or_few_are_lost() -> None:
    one = np.zeros(1000, bool)
    one[300:600] = True
    assert not between_samples(one).any()
    assert not between_samples(np.tile([False, True], 5)).any()
    assert between_samples(np.zeros(0, bool)).shape == (0,)


def test_one_stamp_in_the_future_and_one_in_the_past_cost_a_row_each():
    time = np.arange(100.0)
    time[30] += 1e6
    time[60] -= 1e6
    assert np.flatnonzero(~increasing(time)).tolist() == [30, 60]


def test_of_a_clock_that_was_set_back_the_rows_before_are_kept():
    time = np.append(np.arange(60.0), np.arange(50.0, 100.0))
    assert np.flatnonzero(~increasing(time)).tolist() == list(range(60, 70))


@pytest.mark.parametrize("seed", range(20))
def test_as_many_rows_are_kept_as_can_be(seed):
    time = np.random.default_rng(seed).integers(0, 12, size=12).astype(float)
    kept = increasing(time)
    assert (np.diff(time[kept]) > 0).all()
    rows = range(len(time))
    most = max(n for n in rows if any((np.diff(time[list(some)]) > 0).all() for some in combinations(rows, n)))
    assert kept.sum() == most


def test_rows_in_disorder_take_no_square_of_their_number():
    time = np.arange(2e5) + np.random.default_rng(0).normal(0, 3, size=200_000)
    began = process_time()
    assert increasing(time).any()
    assert process_time() - began < 10
