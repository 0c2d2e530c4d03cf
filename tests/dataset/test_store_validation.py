"""Resumption of a dataset with the same settings only."""

from pathlib import Path

import pytest

from factories import RIG, small_rig
from offpiste.core.errors import DatasetError
from offpiste.dataset.map_snapshots import SnapshotSettings
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import create
from offpiste.dataset.store_validation import MADE_BY, refuse_unlike
from offpiste.mapping.pipeline import MapSettings
from offpiste.mapping.replay import MapperSettings
from offpiste.mapping.voxel_map import VoxelSettings
from offpiste.rig.rig import load_rig
from sensor_bags import SENSORS

FINER = MapperSettings(map=MapSettings(VoxelSettings(size=0.1)))


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
    ):
        with pytest.raises(DatasetError, match=f"another {key}: {both}"):
            refuse_unlike(tmp_path, found, found | {key: other})
    moved = {"split": "drives:one.txt", "split_drives": [["one", "train"]]}
    refuse_unlike(tmp_path, found | moved, found | moved | {"split": "drives:/there/one.txt"})
    with pytest.raises(DatasetError, match="another split_drives"):
        refuse_unlike(tmp_path, found | moved, found | moved | {"split_drives": [["one", "test"]]})
    with pytest.raises(DatasetError, match="another rig; choose"):
        refuse_unlike(tmp_path, found, found | {"rig": {}})


@pytest.mark.parametrize(
    ("snapshots", "mapper", "said"),
    [
        (SnapshotSettings(0.5), MapperSettings(0.0), "keyframe_metres: it has 0.5, wanted is 0.0"),
        (SnapshotSettings(2.0), MapperSettings(), "snapshot_seconds: it has 0.5, wanted is 2.0"),
        (SnapshotSettings(0.5, min_speed=0.0), MapperSettings(), "snapshot_speed: it has 1.5, wanted is 0.0"),
        (SnapshotSettings(0.5, latency=0.0), MapperSettings(), "latency: it has 0.1, wanted is 0.0"),
        (SnapshotSettings(0.5, most=9), MapperSettings(), "snapshot_settings: it has none, wanted is most 9"),
        (SnapshotSettings(0.5), FINER, "map_settings: it has none, wanted is map.voxels.size 0.1"),
    ],
)
def test_an_extraction_of_visual_features_is_resumed_with_the_same_settings(
    tmp_path: Path, snapshots: SnapshotSettings, mapper: MapperSettings, said: str
) -> None:
    def begin(snapshots: SnapshotSettings, mapper: MapperSettings) -> None:
        create(
            tmp_path / "d.zarr", small_rig(), parse_split("blocks:0.7,0.1,0.2"), ("p",), "pca", 0.5, snapshots, mapper
        )
        (tmp_path / "d.zarr" / "drive").mkdir(exist_ok=True)

    begin(SnapshotSettings(0.5), MapperSettings())
    begin(SnapshotSettings(0.5, min_speed=1.5), MapperSettings(map=MapSettings(VoxelSettings(threads=7))))
    with pytest.raises(DatasetError, match=f"already holds a dataset with another {said}; choose another --out"):
        begin(snapshots, mapper)


def test_masks_are_the_same_where_they_show_the_same_wherever_they_lie(tmp_path: Path) -> None:
    def begun(name: str, folder: str, content: bytes) -> None:
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / "mask.png").write_bytes(content)
        text = (RIG + SENSORS).replace('info = "/info"', 'info = "/info"\nmask = "mask.png"')
        (tmp_path / folder / "rig.toml").write_text(text)
        create(tmp_path / name, load_rig(tmp_path / folder / "rig.toml"), parse_split("blocks:0.7,0.1,0.2"))
        (tmp_path / name / "drive").mkdir(exist_ok=True)

    begun("one.zarr", "a", b"a mask")
    begun("one.zarr", "b", b"a mask")
    with pytest.raises(DatasetError, match=r"one\.zarr: already holds a dataset with another mask of a camera; choose"):
        begun("one.zarr", "c", b"another")
