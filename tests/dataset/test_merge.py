"""Merging of shards: the same bytes as one process, and refusals."""

import shutil
from pathlib import Path

import pytest

from cluster import content
from offpiste.core.checksums import CHECKSUMS
from offpiste.core.errors import DatasetError, OffpisteError
from offpiste.core.parallel import parse_shard
from offpiste.dataset.merge import merge_datasets
from offpiste.dataset.store import drive_names
from offpiste.inspection.extract import extract
from offpiste.rig.rig import load_rig
from shared_drives import blind_drives

RIG = load_rig("proving_ground")
SPLIT = "blocks:0.6,0.2,0.2"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three logs, their dataset, and two shards of it."""
    folder = tmp_path_factory.mktemp("shards")
    logs = blind_drives(folder)
    extract(logs, RIG, folder / "whole.zarr", split=SPLIT)
    # In another order: which shard a log is in follows from its name.
    for number in (1, 2):
        extract(logs[::-1], RIG, folder / f"{number}.zarr", split=SPLIT, shard=(number, 2))
    return folder


@pytest.fixture
def shards(folder: Path, tmp_path: Path) -> list[Path]:
    """Copies of the shards."""
    return [Path(shutil.copytree(folder / f"{number}.zarr", tmp_path / f"{number}.zarr")) for number in (1, 2)]


def test_merged_shards_are_what_one_process_makes_also_after_an_interruption(folder, shards, tmp_path):
    assert [drive_names(shard) for shard in shards] == [["drive-0", "drive-2"], ["drive-1"]]
    out = tmp_path / "merged" / "dataset.zarr"
    dataset = merge_datasets(shards, out)
    assert [drive.name for drive in dataset.drives] == ["drive-0", "drive-1", "drive-2"]
    assert content(out) == content(folder / "whole.zarr")
    shutil.rmtree(out / "drive-2")
    (out / ".drive-2.abc.partial").mkdir()
    merge_datasets(shards, out)
    assert content(out) == content(folder / "whole.zarr")
    assert not list(out.glob(".*"))


def test_what_does_not_fit_together_is_refused(folder, shards, tmp_path):
    out = tmp_path / "d.zarr"
    with pytest.raises(DatasetError, match="1 dataset to merge; name two or more"):
        merge_datasets(shards[:1], out)
    with pytest.raises(DatasetError, match=r"drive 'drive-0' is in .*1.zarr, too"):
        merge_datasets([*shards, folder / "whole.zarr"], out)
    with pytest.raises(DatasetError, match="not a dataset"):
        merge_datasets([*shards, tmp_path], out)
    extract([folder / "drive-1.mcap"], RIG, tmp_path / "other.zarr", split="blocks:0.5,0.25,0.25")
    with pytest.raises(DatasetError, match="another split"):
        merge_datasets([shards[0], tmp_path / "other.zarr"], out)
    assert not out.exists()


def test_a_drive_without_checksums_is_another_drive(shards, tmp_path):
    out = tmp_path / "d.zarr"
    merge_datasets(shards, out)
    (out / "drive-1" / CHECKSUMS).unlink()
    with pytest.raises(DatasetError, match="contains another drive 'drive-1' than"):
        merge_datasets(shards, out)


def test_a_damaged_shard_is_found_before_anything_is_merged(shards, tmp_path):
    (chunk,) = [file for file in (shards[1] / "drive-1" / "state").rglob("c/*/*") if file.is_file()]
    damaged = bytearray(chunk.read_bytes())
    damaged[len(damaged) // 2] ^= 4
    chunk.write_bytes(damaged)
    with pytest.raises(DatasetError, match=r"drive-1.*nothing was merged"):
        merge_datasets(shards, tmp_path / "d.zarr")
    assert not (tmp_path / "d.zarr").exists()


@pytest.mark.parametrize("text", ["0/2", "3/2", "1", "a/2", "1/2/3", "²/3"])
def test_no_shard(text):
    with pytest.raises(OffpisteError, match="is not a shard; give K/N with K from 1 to N"):
        parse_shard(text)


def test_more_shards_than_logs(folder, tmp_path):
    assert parse_shard("2/2") == (2, 2)
    with pytest.raises(DatasetError, match="1 logs have no shard 2/2; give fewer shards"):
        extract([folder / "drive-0.mcap"], RIG, tmp_path / "d.zarr", shard=(2, 2))
