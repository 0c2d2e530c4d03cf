"""What is said before any log is read."""

from pathlib import Path

import pytest

from factories import small_rig
from log_messages import logged
from offpiste.dataset import extract
from offpiste.dataset.extract import make_dataset
from offpiste.errors import DatasetError


def made(out: Path, split: str, patch: pytest.MonkeyPatch) -> list[str]:
    patch.setattr(extract, "run_all", lambda *arguments: [])
    with logged() as said, pytest.raises(DatasetError, match="holds no drive"):
        make_dataset(["one.csv"], small_rig(), out, split=split)
    return said


def test_a_part_that_stays_empty_is_warned_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert made(tmp_path / "whole.zarr", "blocks:0.7,0.1,0.2", monkeypatch) == []
    assert made(tmp_path / "train.zarr", "blocks:1,0,0", monkeypatch) == [
        "warning: the split blocks:1,0,0 leaves nothing for validation and test: models cannot be trained or judged"
    ]
    assert made(tmp_path / "both.zarr", "blocks:0.8,0.2,0", monkeypatch) == [
        "warning: the split blocks:0.8,0.2,0 leaves nothing for test: models cannot be judged"
    ]


def test_another_split_or_other_features_are_named_with_both(tmp_path: Path) -> None:
    from offpiste.dataset.store_validation import MADE_BY, refuse_unlike

    found = dict.fromkeys(MADE_BY, 1) | {
        "split": "blocks:0.7,0.1,0.2",
        "features": ["pca_0", "pca_1", "pca_2", "pca_3"],
    }
    refuse_unlike(tmp_path, found, dict(found))
    for key, other, both in (
        ("split", "fold:0/5", "it has blocks:0.7,0.1,0.2, asked for is fold:0/5"),
        ("features", [], r"it has pca_0, pca_1, pca_2, … \(4\), asked for is none"),
        ("pca", None, "it has 1, asked for is none"),
    ):
        with pytest.raises(DatasetError, match=f"another {key}: {both}"):
            refuse_unlike(tmp_path, found, found | {key: other})
    moved = {"split": "drives:one.txt", "split_drives": [["one", "train"]]}
    refuse_unlike(tmp_path, found | moved, found | moved | {"split": "drives:/there/one.txt"})
    with pytest.raises(DatasetError, match="another split_drives"):
        refuse_unlike(tmp_path, found | moved, found | moved | {"split_drives": [["one", "test"]]})
    with pytest.raises(DatasetError, match="another rig; choose"):
        refuse_unlike(tmp_path, found, found | {"rig": {}})
