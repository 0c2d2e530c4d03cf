"""Lone deep cells are pits; ditches, holes and drops are not."""

import numpy as np

from offpiste.inspection.map_health import find_pits


def ground():
    y, x = np.mgrid[:80, :80] * 0.2
    return 300.0 + 0.3 * x + 0.2 * np.sin(y)


def test_lone_deep_cells_are_pits():
    height = ground()
    for row, column, depth in ((10, 10, 0.8), (40, 40, 13.0), (40, 41, 9.0), (79, 0, 2.0)):
        height[row, column] -= depth
    expected = height < ground() - 0.5
    height[20, 20:30] = np.nan
    np.testing.assert_array_equal(find_pits(height), expected)
    assert expected.sum() == 4


def test_ditches_holes_and_drops_are_not():
    height = ground()
    height[30:34] -= 1.5  # a ditch, 0.8 m wide
    height[60:65, 50:55] -= 1.0  # a hole of 1 m
    height[:, 70:] -= 5.0
    height[10, 10] -= 0.3  # too shallow
    assert not find_pits(height).any()
    assert not find_pits(np.full((5, 5), np.nan)).any()
