"""A dataset is resumed only as it was begun; what differs is named with both values."""

from pathlib import Path

import msgspec
import pytest

from factories import small_rig
from offpiste.dataset.store_validation import MADE_BY, refuse_unlike
from offpiste.errors import DatasetError


def test_another_split_or_other_features_are_named_with_both(tmp_path: Path) -> None:
    found = dict.fromkeys(MADE_BY, 1) | {
        "split": "blocks:0.7,0.1,0.2",
        "features": ["pca_0", "pca_1", "pca_2", "pca_3"],
    }
    refuse_unlike(tmp_path, found, dict(found))
    for key, other, both in (
        ("split", "fold:0/5", "it has blocks:0.7,0.1,0.2, wanted is fold:0/5"),
        ("features", [], r"it has pca_0, pca_1, pca_2, … \(4\), wanted is none"),
        ("pca", None, "it has 1, wanted is none"),
        ("latency", 0.2, "it has 1, wanted is 0.2"),
    ):
        with pytest.raises(DatasetError, match=f"another {key}: {both}"):
            refuse_unlike(tmp_path, found, found | {key: other})
    moved = {"split": "drives:one.txt", "split_drives": [["one", "train"]]}
    refuse_unlike(tmp_path, found | moved, found | moved | {"split": "drives:/there/one.txt"})
    with pytest.raises(DatasetError, match="another split_drives"):
        refuse_unlike(tmp_path, found | moved, found | moved | {"split_drives": [["one", "test"]]})
    with pytest.raises(DatasetError, match="another rig; choose"):
        refuse_unlike(tmp_path, found, found | {"rig": {}})


def test_keys_of_rigs_that_are_younger_than_a_dataset_do_not_make_it_another(tmp_path: Path) -> None:
    now = msgspec.to_builtins(small_rig())
    channels = {name: {k: v for k, v in source.items() if k != "values"} for name, source in now["channels"].items()}
    before = now | {"channels": channels}
    found = dict.fromkeys(MADE_BY, 1)
    assert before != now
    refuse_unlike(tmp_path, found | {"rig": before}, found | {"rig": now})
    with pytest.raises(DatasetError, match="another rig"):
        refuse_unlike(tmp_path, found | {"rig": before}, found | {"rig": now | {"name": "other"}})
