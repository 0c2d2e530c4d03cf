"""Coverage of a dataset's features on cells few enough to compute by hand."""

import numpy as np
import pytest

from offpiste.core.conventions import FEATURE_SETS
from offpiste.dataset import feature_coverage
from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.wheel_passes import find_passes

SETS = len(FEATURE_SETS)
NEAR, FAR = FEATURE_SETS.index("0"), FEATURE_SETS.index("10")


def cells_of(features: np.ndarray) -> Cells:
    """Cells with these features [D M F], valid where they are finite, seen from 7 m."""
    valid = np.isfinite(features).all(axis=2)
    known = np.where(valid, 7.0, np.nan).astype(np.float32)
    index = np.zeros((1, 4), np.int32)
    return Cells(index, features.astype(np.float16), valid, known, known)


def three_cells() -> Cells:
    """In hindsight at (0, 0), (10, 20), (0, 20); at 0 m by (3, 4), then lacking, then the same; at 10 m one cell."""
    features = np.full((SETS, 3, 2), np.nan)
    features[0] = (0, 0), (10, 20), (0, 20)
    features[NEAR, 0] = 3, 4
    features[NEAR, 2] = 0, 20
    features[FAR, 0] = 4, 4
    return cells_of(features)


def test_rates_count_cells_of_all_drives() -> None:
    rates = feature_coverage.valid_rates([three_cells()])
    np.testing.assert_allclose(rates[[0, NEAR, FAR]], (1, 2 / 3, 1 / 3))
    assert rates.sum() == pytest.approx(2)
    lacking = cells_of(np.full((SETS, 1, 2), np.nan))
    np.testing.assert_allclose(feature_coverage.valid_rates([three_cells(), lacking])[[0, NEAR]], (3 / 4, 2 / 4))
    both = [three_cells(), lacking]
    within = feature_coverage.valid_rates(both, feature_coverage.in_hindsight(both))
    np.testing.assert_allclose(within[[0, NEAR]], (1, 2 / 3))
    assert np.isnan(feature_coverage.valid_rates([cells_of(np.zeros((SETS, 0, 2)))])).all()


def test_differences_of_the_three_cells() -> None:
    span = feature_coverage.feature_range([three_cells()], (0.0, 100.0))
    np.testing.assert_allclose(span, (10, 20))
    found = feature_coverage.differences([three_cells()], span)
    whole = np.hypot(10, 20)
    assert found.length[0, NEAR] == pytest.approx((5 + 0) / 2 / whole)
    assert found.length[NEAR, FAR] == pytest.approx(1 / whole)
    np.testing.assert_allclose(found.length, found.length.T)
    np.testing.assert_allclose(found.feature[0, NEAR], (3 / 2 / 10, 4 / 2 / 20))
    np.testing.assert_allclose(found.neighbours()[NEAR - 1], (1 / 10, 0))
    assert found.count[0, NEAR] == found.count[NEAR, 0] == 2
    assert found.count[0, 0] == 3
    assert found.length[0, 0] == 0
    assert np.isnan(found.length[0, -1])


def test_what_lies_at_the_ends_of_a_drive_was_never_at_some_distances() -> None:
    """50 m straight ahead, one cell a metre, wheels at the pose point."""
    time = np.arange(51.0)
    xy = np.column_stack((time, np.zeros(51))) + 0.5
    wheels = np.repeat(xy[:, None], 4, axis=1)
    passes = find_passes(time, xy, wheels, resolution=1.0)
    reached = dict(zip(FEATURE_SETS, feature_coverage.within_reach(passes, time, xy, 1.0), strict=True))
    assert reached["hindsight"].all()
    np.testing.assert_array_equal(np.flatnonzero(reached["40"]), np.arange(35, 51))
    np.testing.assert_array_equal(np.flatnonzero(reached["20"]), np.arange(15, 51))
    # After first contact distances are negative, so the start of the drive was seen from behind but not its end.
    np.testing.assert_array_equal(np.flatnonzero(reached["-20"]), np.arange(0, 36))
    assert reached["0"].all()
