"""Rows between a slower sensor's samples are parted from lost ones."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from offpiste.logs.empty_rows import between_samples


def _rows_of(rate: float, seconds: float = 30.0, table: float = 100.0) -> np.ndarray:
    """Which rows of a table hold no sample of a sensor of this rate [Hz]."""
    slot = np.floor(np.arange(0, seconds, 1 / table) * rate + 1e-9)
    return np.append(False, np.diff(slot) == 0)


@pytest.mark.parametrize("rate", [4.0, 10.0, 30.0, 37.0, 50.0, 66.0, 80.0])
def test_a_slower_sensor_leaves_rows_empty(rate: float) -> None:
    empty = _rows_of(rate)
    assert empty.mean() == pytest.approx(1 - rate / 100, abs=0.02)
    np.testing.assert_array_equal(between_samples(empty), empty)


@pytest.mark.parametrize("share", [0.05, 0.2, 0.5, 0.8])
def test_rows_that_are_lost_at_random_are_lost(share: float) -> None:
    empty = np.random.default_rng(0).random(5000) < share
    assert not between_samples(empty).any()


def test_what_a_slower_sensor_loses_is_no_row_between_its_samples() -> None:
    empty = _rows_of(20.0)
    lost = np.zeros(len(empty), bool)
    lost[1001:1100] = True
    np.testing.assert_array_equal(between_samples(empty | lost), empty & ~_run_around(empty | lost, 1050))


def test_one_run_or_few_are_lost() -> None:
    one = np.zeros(1000, bool)
    one[300:600] = True
    assert not between_samples(one).any()
    assert not between_samples(np.tile([False, True], 5)).any()
    assert between_samples(np.zeros(0, bool)).shape == (0,)


@given(st.lists(st.booleans(), max_size=300))
def test_only_empty_rows_lie_between_samples(rows: list[bool]) -> None:
    empty = np.array(rows, bool)
    assert not (between_samples(empty) & ~empty).any()


def _run_around(mask: np.ndarray, at: int) -> np.ndarray:
    begin, end = at, at
    while mask[begin - 1]:
        begin -= 1
    while mask[end + 1]:
        end += 1
    run = np.zeros(len(mask), bool)
    run[begin : end + 1] = True
    return run
