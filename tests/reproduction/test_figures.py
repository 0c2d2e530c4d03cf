"""The ten windows that are drawn for every model."""

from pathlib import Path

from feature_datasets import dataset_with_features
from offpiste.dataset.windows import Windows
from offpiste.reproduction.figures import spaced_windows


def test_ten_windows_share_no_row(tmp_path: Path) -> None:
    dataset = dataset_with_features(tmp_path / "seen.zarr", ("test",) * 4, rows=1500)
    windows = Windows(dataset, "test")
    index = spaced_windows(windows)
    assert len(index) == 10
    row, drive = windows.row_in_drive(index), windows.drive[index]
    assert set(drive) == {0, 1, 2, 3}
    for i in range(10):
        for j in range(i):
            assert drive[i] != drive[j] or abs(row[i] - row[j]) > 260
