"""Windows whose ground was seen all along, against a slow loop."""

from pathlib import Path

import numpy as np
import pytest

from offpiste.dataset.windows import Windows
from offpiste.evaluation.errors import Errors
from offpiste.reproduction.figures import spread_out
from offpiste.reproduction.results import valid_throughout
from seen_drives import seen_dataset


@pytest.mark.parametrize("name", ["hindsight", "20"])
def test_valid_throughout_equals_a_slow_loop(name: str, tmp_path: Path) -> None:
    dataset = seen_dataset(tmp_path / "seen.zarr", ("test", "test"), rows=420)
    for drive in dataset.drives:
        drive.rows.cells.valid[:] = True
        drive.rows.cells.valid[5, 40:60] = False
        drive.rows.cells.valid[0, 500] = False
        drive.rows.cells.index[380, 2] = -1
    drive, row = np.repeat([0, 1], 150), np.tile(np.arange(10, 160), 2)
    windows = Errors(drive, row, np.zeros((300, 5, 5)), np.zeros(300))
    found = valid_throughout(dataset, name, windows)
    for i in range(0, 300, 7):
        cells = dataset.drives[drive[i]].rows.cells
        under = cells.index[row[i] - 10 : row[i] + 250]
        number = {"hindsight": 0, "20": 5}[name]
        assert found[i] == all(c >= 0 and cells.valid[number, c] for c in under.ravel())
    assert 0 < found.sum() < 300


def test_ten_windows_share_no_row(tmp_path: Path) -> None:
    dataset = seen_dataset(tmp_path / "seen.zarr", ("test",) * 4, rows=1500)
    windows = Windows(dataset, "test")
    index = spread_out(windows)
    assert len(index) == 10
    row, drive = windows.row_in_drive(index), windows.drive[index]
    assert set(drive) == {0, 1, 2, 3}
    for i in range(10):
        for j in range(i):
            assert drive[i] != drive[j] or abs(row[i] - row[j]) > 260
