"""Resumption of a dataset with the same settings only."""

from pathlib import Path

import pytest

from factories import RIG, small_rig
from offpiste.core.errors import DatasetError
from offpiste.dataset.map_snapshots import SnapshotSettings
from offpiste.dataset.splits import Split, parse_split, write_drives
from offpiste.dataset.store import create
from offpiste.mapping.pipeline import MapSettings
from offpiste.mapping.replay import MapperSettings
from offpiste.mapping.voxel_map import VoxelSettings
from offpiste.rig.rig import load_rig
from sensor_bags import SENSORS

FINER = MapperSettings(map=MapSettings(VoxelSettings(size=0.1)))
USUAL = {
    "rig": small_rig(),
    "split": parse_split("blocks:0.7,0.1,0.2"),
    "features": ("one", "two", "three", "four"),
    "pca": "pca",
    "min_hindsight": 0.5,
    "snapshots": SnapshotSettings(0.5),
    "mapper": MapperSettings(),
}


def begin(folder: Path, **settings: object) -> None:
    """Create a dataset of one drive, or resume it."""
    create(folder / "d.zarr", **settings)
    (folder / "d.zarr" / "drive").mkdir(exist_ok=True)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rig": small_rig().without_slope()}, "rig;"),
        ({"split": parse_split("fold:0/5")}, "split: it has blocks:0.7,0.1,0.2, wanted is fold:0/5;"),
        ({"features": ()}, r"features: it has one, two, three, … \(4\), wanted is none;"),
        ({"pca": None}, "pca: it has pca, wanted is none;"),
        ({"mapper": MapperSettings(0.0)}, "keyframe_metres: it has 0.5, wanted is 0.0;"),
        ({"mapper": FINER}, "map_settings: it has none, wanted is map.voxels.size 0.1;"),
        ({"snapshots": SnapshotSettings(2.0)}, "snapshot_seconds: it has 0.5, wanted is 2.0;"),
        ({"snapshots": SnapshotSettings(0.5, min_speed=0.0)}, "snapshot_speed: it has 1.5, wanted is 0.0;"),
        ({"snapshots": SnapshotSettings(0.5, latency=0.0)}, "latency: it has 0.1, wanted is 0.0;"),
        ({"snapshots": SnapshotSettings(0.5, most=9)}, "snapshot_settings: it has none, wanted is most 9;"),
    ],
)
def test_an_extraction_is_resumed_with_the_same_settings_only(tmp_path: Path, changes: dict, said: str) -> None:
    begin(tmp_path, **USUAL)
    threads = MapperSettings(map=MapSettings(VoxelSettings(threads=7)))
    begin(tmp_path, **USUAL | {"snapshots": SnapshotSettings(0.5, min_speed=1.5), "mapper": threads})
    with pytest.raises(DatasetError, match=rf"already holds a dataset with another {said} choose another --out"):
        begin(tmp_path, **USUAL | changes)


def test_parts_of_drives_count_and_not_the_file_that_names_them(tmp_path: Path) -> None:
    def split(name: str, part: str) -> Split:
        return parse_split(write_drives(tmp_path / name, [("drive", part)]))

    for name in ("one.txt", "two.txt"):
        begin(tmp_path, rig=small_rig(), split=split(name, "train"))
    with pytest.raises(DatasetError, match="another split_drives; choose"):
        begin(tmp_path, rig=small_rig(), split=split("one.txt", "test"))


def test_masks_are_the_same_where_they_show_the_same_wherever_they_lie(tmp_path: Path) -> None:
    def masked(folder: str, content: bytes) -> dict:
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "mask.png").write_bytes(content)
        text = (RIG + SENSORS).replace('info = "/info"', 'info = "/info"\nmask = "mask.png"')
        (tmp_path / folder / "rig.toml").write_text(text)
        return USUAL | {"rig": load_rig(tmp_path / folder / "rig.toml")}

    for folder in ("a", "b"):
        begin(tmp_path, **masked(folder, b"a mask"))
    with pytest.raises(DatasetError, match=r"d\.zarr: already holds a dataset with another mask of a camera; choose"):
        begin(tmp_path, **masked("c", b"another"))
