"""Vectors of lanes against NumPy."""

import numba
import numpy as np
import pytest

from offpiste.dynamics.kernels.layout import LANES
from offpiste.dynamics.kernels.vectors import WIDTH, clamp, load, read_fours, store

f4 = np.float32


@numba.njit
def combine(a, b, factor, result):
    one = f4(1)
    total = f4(0)
    for i in range(0, len(a), WIDTH):
        x, y = load(a, i), load(b, i)
        total = factor * x
        total += (x - y) * (x + y) / (one + y * y)
        store(result, i, total)


@numba.njit
def clamp_all(a, low, high, result):
    for i in range(0, len(a), WIDTH):
        store(result, i, clamp(load(a, i), low, high))


def test_arithmetic():
    a, b = np.random.default_rng(0).normal(size=(2, 4 * WIDTH)).astype(f4)
    result = np.zeros_like(a)
    combine(a, b, f4(0.3), result)
    np.testing.assert_allclose(result, 0.3 * a + (a - b) * (a + b) / (1 + b * b), rtol=1e-5, atol=1e-6)


def test_clamping():
    a = np.linspace(-3, 3, 2 * WIDTH, dtype=f4)
    a[5:9] = np.inf, -np.inf, 1, np.nan
    result = np.zeros_like(a)
    clamp_all(a, f4(-1), f4(2), result)
    np.testing.assert_array_equal(np.delete(result, 8), np.delete(np.clip(a, -1, 2), 8))
    assert result[8] in (-1, 2), "what is not a number becomes one of the ends"


@numba.njit
def read(numbers, index, shift, outside, rows):
    read_fours(numbers, index, shift, outside, rows)


@pytest.mark.parametrize("shift", [0, 3])
def test_fours_are_those_of_each_lane(shift):
    draw = np.random.default_rng(shift)
    numbers, outside = draw.normal(size=5000).astype(f4), draw.normal(size=shift + 4).astype(f4)
    index = draw.integers(-900, 5000 - shift - 3, LANES).astype(np.int32)
    index[:4] = -1, 0, 5000 - shift - 4, np.iinfo(np.int32).min
    rows = np.zeros(4 * LANES, f4)
    read(numbers, index, shift, outside, rows)
    e = np.arange(shift, shift + 4)[:, None]
    inside = numbers[np.maximum(index, 0) + e]
    np.testing.assert_array_equal(rows.reshape(4, LANES), np.where(index >= 0, inside, outside[e]))


checked = numba.njit(boundscheck=True)


@checked
def read_checked(numbers, index, outside, rows):
    read_fours(numbers, index, 1, outside, rows)


@checked
def move_checked(a, at, b, to):
    store(b, to, load(a, at))


def test_bounds_are_checked_where_numba_checks_them():
    numbers, index, rows = np.zeros(100, f4), np.full(LANES, 95, np.int32), np.zeros(4 * LANES, f4)
    read_checked(numbers, index, numbers, rows)
    index[7] = 96
    with pytest.raises(IndexError):
        read_checked(numbers, index, numbers, rows)
    index[7] = 95
    for wrong in (
        (numbers, index, numbers[:4], rows),
        (numbers, index, numbers, rows[1:]),
        (numbers, index[1:], numbers, rows),
    ):
        with pytest.raises(IndexError):
            read_checked(*wrong)
    a = np.zeros(WIDTH + 1, f4)
    move_checked(a, 1, a, 0)
    for at, to in ((2, 0), (0, 2), (-1, 0)):
        with pytest.raises(IndexError):
            move_checked(a, at, a, to)
