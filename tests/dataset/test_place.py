"""Datasets in an object store, on a real S3 server: equal to local ones, with whole drives only."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import fsspec
import pytest
from fsspec.implementations.memory import MemoryFile

from object_stores import s3_server
from offpiste.core.cache import VARIABLE
from offpiste.core.checksums import CHECKSUMS
from offpiste.core.errors import DatasetError, OffpisteError
from offpiste.core.object_store import opened
from offpiste.dataset.merge import merge_datasets
from offpiste.dataset.place import drive_names
from offpiste.dataset.store import open_dataset
from offpiste.inspection.extract import extract
from offpiste.rig.rig import load_rig
from shared_drives import blind_drives

RIG = load_rig("proving_ground")
SPLIT = "blocks:0.6,0.2,0.2"
STORE = "s3://bucket/sets/dataset.zarr"
OUT = Path(STORE)


def put(file: Path, url: str) -> None:
    with opened(url) as (files, root):
        files.put_file(str(file), root)


def remove(url: str) -> None:
    with opened(url) as (files, root):
        if found := files.find(root):
            files.rm(found)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Three logs, here and in the bucket, and their dataset."""
    folder = tmp_path_factory.mktemp("place")
    logs = blind_drives(folder)
    extract(logs, RIG, folder / "whole.zarr", split=SPLIT)
    with s3_server("bucket"):
        for log in logs:
            put(log, f"s3://bucket/logs/{log.name}")
        yield folder


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """An empty cache folder, and an empty dataset."""
    monkeypatch.setenv(VARIABLE, str(tmp_path / "cache"))
    yield
    remove(STORE)


def content(path: Path) -> dict[str, bytes]:
    return {str(file.relative_to(path)): file.read_bytes() for file in path.rglob("*") if file.is_file()}


def test_from_and_to_a_store_it_is_the_dataset_that_is_made_here(folder: Path) -> None:
    made = extract(["s3://bucket/logs/*.mcap"], RIG, OUT, split=SPLIT, processes=2)
    assert content(made.path) == content(folder / "whole.zarr")
    assert drive_names(OUT) == ["drive-0", "drive-1", "drive-2"]


def test_it_resumes_and_a_drive_that_was_half_uploaded_is_made_again(folder: Path, caplog) -> None:
    logs = sorted(folder.glob("*.mcap"))
    extract(logs, RIG, OUT, split=SPLIT)
    remove(f"{STORE}/drive-1/{CHECKSUMS}")
    put(logs[0], f"{STORE}/drive-1/left-over")
    assert drive_names(OUT) == ["drive-0", "drive-2"]
    assert [drive.name for drive in open_dataset(OUT).drives] == ["drive-0", "drive-2"]
    made = extract(logs, RIG, OUT, split=SPLIT)
    assert content(made.path) == content(folder / "whole.zarr")


def test_logs_that_all_fail_leave_nothing(tmp_path: Path, folder: Path) -> None:
    (tmp_path / "bad.mcap").write_bytes(b"no log" * 100)
    put(tmp_path / "bad.mcap", "s3://bucket/logs/bad/bad.mcap")
    with pytest.raises(OffpisteError, match=r"s3://bucket/logs/bad/bad\.mcap"):
        extract(["s3://bucket/logs/bad/bad.mcap"], RIG, OUT, split=SPLIT)
    with opened(STORE) as (files, root):
        assert files.find(root) == []


def test_the_copy_follows_the_store(folder: Path, tmp_path: Path) -> None:
    extract(sorted(folder.glob("*.mcap")), RIG, OUT, split=SPLIT)
    copy = open_dataset(OUT).path
    shutil.rmtree(copy / "drive-2")
    (copy / "drive-9").mkdir()
    remove(f"{STORE}/drive-0")
    assert [drive.name for drive in open_dataset(OUT).drives] == ["drive-1", "drive-2"]
    with pytest.raises(DatasetError, match=r"s3://bucket/none\.zarr: not a dataset"):
        open_dataset("s3://bucket/none.zarr")


def test_names_that_lead_out_of_a_dataset_are_no_drives(folder: Path, tmp_path: Path) -> None:
    store = fsspec.filesystem("memory").store
    for name in ("..", ".hidden", "drive"):
        store[f"/b/dataset.zarr/{name}/{CHECKSUMS}"] = MemoryFile(data=b"{}")
    assert drive_names(Path("memory://b/dataset.zarr")) == ["drive"]


def test_shards_in_a_store_are_merged_here(folder: Path, tmp_path: Path) -> None:
    logs = sorted(folder.glob("*.mcap"))
    parts = [Path(f"s3://bucket/sets/dataset.zarr/part-{number}") for number in (1, 2)]
    for number, part in enumerate(parts, 1):
        extract(logs, RIG, part, split=SPLIT, shard=(number, 2))
    merge_datasets(parts, tmp_path / "merged.zarr")
    assert content(tmp_path / "merged.zarr") == content(folder / "whole.zarr")
