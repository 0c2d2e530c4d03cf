import numpy as np
import pytest

from offpiste.evaluation.errors import Errors
from offpiste.evaluation.tables import pool, positions


def errors(windows: list[tuple[int, int]], value: float) -> Errors:
    drive, row = np.array(windows).T
    return Errors(drive, row, np.full((len(row), 5, 5), value), np.full(len(row), 10 * value))


def test_seeds_are_averaged_window_by_window() -> None:
    windows = [(0, 10), (0, 15), (1, 10)]
    both = pool([errors(windows, 1.0), errors(windows[::-1], 4.0)])
    assert list(zip(both.drive, both.row, strict=True)) == windows
    assert (both.values == 2.5).all()
    assert (both.loss == 25.0).all()


def test_folds_are_put_side_by_side_in_order() -> None:
    both = pool([errors([(0, 900), (1, 20)], 3.0), errors([(0, 100), (0, 105)], 1.0)])
    assert both.row.tolist() == [100, 105, 900, 20]
    assert both.drive.tolist() == [0, 0, 0, 1]
    assert both.distance().tolist() == [1.0, 1.0, 3.0, 3.0]


def test_folds_and_seeds_together() -> None:
    runs = [errors([(0, 1)], 1.0), errors([(0, 2)], 2.0), errors([(0, 1)], 3.0), errors([(0, 2)], 6.0)]
    assert pool(runs).distance().tolist() == [2.0, 4.0]


def test_a_window_that_one_run_fails_has_failed() -> None:
    both = pool([errors([(0, 1), (0, 2)], 1.0), errors([(0, 2)], np.inf)])
    assert both.failed[:, -1].tolist() == [False, True]


def test_positions_find_windows_and_refuse_strangers() -> None:
    among = errors([(0, 1), (0, 5), (2, 0)], 1.0)
    assert positions(errors([(2, 0), (0, 5)], 0.0), among).tolist() == [2, 1]
    with pytest.raises(AssertionError, match="not the same windows"):
        positions(errors([(1, 0)], 0.0), among)
