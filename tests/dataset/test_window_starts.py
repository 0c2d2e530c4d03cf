"""Windows of ground that was never seen, by hand."""

import numpy as np
import pytest

from offpiste.core.conventions import FEATURE_SETS
from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.window_starts import enough_hindsight, seen_in_hindsight


def cells(index: list[list[int]], hindsight: list[bool], sets: int = len(FEATURE_SETS)) -> Cells:
    count = len(hindsight)
    valid = np.zeros((sets, count), bool)
    valid[0] = hindsight
    unknown = np.full((sets, count), np.nan, np.float32)
    return Cells(np.array(index, np.int32), np.zeros((sets, count, 1), np.float16), valid, unknown, unknown)


def test_share_of_the_wheels_on_seen_ground():
    found = seen_in_hindsight(cells([[0, 0, 0, 0], [0, 1, 1, 2], [-1, -1, 2, 2]], [True, False, True]))
    np.testing.assert_allclose(found, [1.0, 0.5, 0.5])


def test_windows_with_enough_of_it():
    seen = cells([[0] * 4] * 3 + [[1] * 4] * 3, [True, False])
    # Windows of two rows; the last one ends with the drive.
    np.testing.assert_array_equal(enough_hindsight(seen, 0.5, horizon=2), [True, True, True, False, False, False])
    np.testing.assert_array_equal(enough_hindsight(seen, 1.0, horizon=2), [True, True, False, False, False, False])


@pytest.mark.parametrize(
    ("given", "least"), [(None, 0.5), (cells([[0] * 4], [False]), 0.0), (cells([[0] * 4], [False], 1), 0.5)]
)
def test_nothing_is_left_out_without_feature_sets_or_where_all_is_wanted(given, least):
    assert enough_hindsight(given, least) is None
