"""Measures of the fusion rules on made-up cells with known answers, and a real drive of a few seconds."""

import numpy as np
import pytest

from experiments.fusion import MEASURES, Ridden, between_kinds, compare, medians, table_of
from offpiste.conventions import FEATURE_SETS
from offpiste.dataset.features_under_wheels import Cells

SETS = len(FEATURE_SETS)


def cells_of(features, valid=None):
    """Cells with the same features [M, F] in all sets."""
    sets = np.repeat(np.asarray(features, np.float16)[None], SETS, axis=0)
    valid = np.ones(sets.shape[:2], bool) if valid is None else valid
    nothing = np.zeros(valid.shape, np.float32)
    return Cells(np.zeros((1, 4), np.int32), sets, valid, nothing, nothing)


def by(rows, rule, name):
    (found,) = [row for row in rows if (row["rule"], row["feature_set"]) == (rule, name)]
    return found


def test_variance_between_kinds_by_hand():
    kind = np.array([0, 0, 1, 1])
    assert between_kinds(np.array([[0.0], [0.0], [2.0], [2.0]]), kind) == pytest.approx(1)
    assert between_kinds(np.array([[0.0], [2.0], [0.0], [2.0]]), kind) == pytest.approx(0)
    # Around the mean 3: -3, -1, 1, 3, squares sum to 20; the kinds' means -2 and 2 make 4 times 4 of it.
    assert between_kinds(np.array([[0.0], [2.0], [4.0], [6.0]]), kind) == pytest.approx(0.8)
    # A second feature without any difference between the kinds adds to the total alone.
    assert between_kinds(np.array([[0.0, 1], [2, -1], [4, -1], [6, 1]]), kind) == pytest.approx(16 / 24)
    assert np.isnan(between_kinds(np.ones((4, 2)), kind))
    assert np.isnan(between_kinds(np.zeros((0, 2)), kind[:0]))


def test_rules_are_compared_in_the_cells_that_all_of_them_have():
    """`latest` lacks the last cell at 20 m, which would spoil the kinds there."""
    valid = np.ones((SETS, 5), bool)
    far = FEATURE_SETS.index("20")
    valid[far, 4] = False
    reached = np.ones((SETS, 5), bool)
    reached[far, 0] = False
    features = [[0.0], [0.0], [2.0], [2.0], [2.0]]
    kind = np.array([0, 0, 1, 1, 0])
    drive = Ridden({"closest": cells_of(features), "latest": cells_of(features, valid)}, reached, kind)
    rows = compare(drive)
    assert len(rows) == 2 * SETS
    assert by(rows, "closest", "20")["valid"] == 1
    assert by(rows, "latest", "20")["valid"] == pytest.approx(3 / 4)
    for rule in ("closest", "latest"):
        assert by(rows, rule, "20")["kinds"] == pytest.approx(1)
        assert by(rows, rule, "hindsight")["kinds"] < 0.7
        assert by(rows, rule, "20")["difference"] == 0


def test_differences_are_to_hindsight_and_relative_to_the_range():
    cells = cells_of(np.linspace(0, 10, 101)[:, None])
    far = FEATURE_SETS.index("40")
    cells.features[far] += 2
    rows = compare(Ridden({"closest": cells}, np.ones((SETS, 101), bool), np.zeros(101, int)))
    # The range is from the 1st to the 99th percentile: 9.8.
    assert by(rows, "closest", "40")["difference"] == pytest.approx(2 / 9.8, rel=1e-2)
    assert by(rows, "closest", "30")["difference"] == 0


def test_medians_leave_out_drives_that_lack_a_value():
    rows = [
        {"drive": str(n), "rule": "closest", "feature_set": name, "valid": v, "difference": v, "kinds": v}
        for n, v in enumerate((0.2, np.nan, 0.4, 0.9))
        for name in FEATURE_SETS
    ]
    found = medians(rows)
    assert [row["valid"] for row in found] == [pytest.approx(0.4)] * SETS
    table = table_of(found, "median")
    assert table.row_count == len(MEASURES)
    assert all(np.isnan(row["kinds"]) for row in medians(rows[SETS : 2 * SETS]))
