"""Dataset on disk: it is read as it was written, whole or not at all, and damage is named."""

from pathlib import Path

import numpy as np
import pytest
import zarr

from factories import circle_rows, small_rig, stored_dataset
from feature_datasets import dataset_with_features, with_snapshots
from offpiste.core.errors import DatasetError, OffpisteError
from offpiste.dataset import store
from offpiste.dataset.resample import Rows
from offpiste.dataset.splits import parse_split

SPLIT = parse_split("blocks:0.5,0.25,0.25")


def stored(tmp_path: Path, names: tuple[str, ...] = ("one", "two")) -> Path:
    rows = {name: circle_rows(2400, seed=number) for number, name in enumerate(names)}
    return stored_dataset(tmp_path / "data.zarr", rows, SPLIT, notes=("a note",)).path


def assert_same(found: Rows, wanted: Rows) -> None:
    for ours, theirs in zip(found.arrays().values(), wanted.arrays().values(), strict=True):
        np.testing.assert_array_equal(ours, theirs)
        assert ours.dtype == theirs.dtype
    np.testing.assert_array_equal(found.origin, wanted.origin)


def test_what_is_stored_is_read_back_as_it_was(tmp_path):
    dataset = store.open_dataset(stored(tmp_path))
    assert [drive.name for drive in dataset.drives] == ["one", "two"]
    for number, drive in enumerate(dataset.drives):
        rows = circle_rows(2400, seed=number)
        assert_same(drive.rows, rows)
        np.testing.assert_array_equal(drive.part, SPLIT.label(drive.name, rows.state[:, :2] + rows.origin))
        assert drive.notes == ("a note",)
    assert dataset.rig == small_rig()
    assert dataset.split == SPLIT


def test_folds_relabel_the_same_rows_without_snapshots(tmp_path):
    fold, dataset = parse_split("fold:0/3"), store.open_dataset(stored(tmp_path))
    again = dataset.relabelled(fold)
    assert again.split == fold
    assert again.drives[0].rows is dataset.drives[0].rows
    assert (again.drives[0].part != dataset.drives[0].part).any()
    kept = with_snapshots(dataset_with_features(tmp_path / "features.zarr"), tmp_path / "snapshots", [100])
    assert all(drive.snapshots is not None for drive in kept.drives)
    assert all(drive.snapshots is None for drive in kept.relabelled(fold).drives)


def test_an_interrupted_write_leaves_nothing(tmp_path, monkeypatch):
    path = stored(tmp_path, ("one",))
    before = sorted(p.name for p in path.iterdir())
    calls = []

    def interrupted(self, *args, **kwargs):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return create_array(self, *args, **kwargs)

    create_array = zarr.Group.create_array
    monkeypatch.setattr(zarr.Group, "create_array", interrupted)
    with pytest.raises(KeyboardInterrupt):
        store.add_drive(path, "two", circle_rows(2400), SPLIT, ())
    assert sorted(p.name for p in path.iterdir()) == before
    (path / ".two.partial").mkdir()  # as a killed process leaves it
    assert [d.name for d in store.open_dataset(path).drives] == ["one"]


def test_a_drive_is_not_overwritten_by_another_of_the_same_name(tmp_path):
    path = stored(tmp_path)
    with pytest.raises(DatasetError, match="already holds a drive 'one'"):
        store.add_drive(path, "one", circle_rows(600), SPLIT, ())


@pytest.mark.parametrize("key", ["state", "part", "normal"])
@pytest.mark.parametrize("left", [None, 0, -1])
def test_a_missing_or_cut_chunk_is_an_error_in_one_line(tmp_path, key, left):
    path = stored(tmp_path)
    (chunk,) = [file for file in (path / "two" / key / "c").rglob("*") if file.is_file()]
    content = chunk.read_bytes()
    chunk.unlink() if left is None else chunk.write_bytes(content[:left])
    with pytest.raises(DatasetError, match=rf"drive 'two' cannot be read.*{key}.*extract") as error:
        store.open_dataset(path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("file", ["zarr.json", "one/zarr.json", "one/state/zarr.json", "one/checksums.json"])
@pytest.mark.parametrize("damage", ["missing", "{", "folder"])
def test_damaged_metadata_are_an_error_that_names_the_file(tmp_path, file, damage):
    path = stored(tmp_path)
    (path / file).unlink()
    if damage == "folder":
        (path / file).mkdir()
    elif damage != "missing":
        (path / file).write_text(damage)
    with pytest.raises(DatasetError, match=rf"{file}.*(is damaged|is missing|has invalid metadata)"):
        store.open_dataset(path)


def test_what_is_no_dataset_is_an_error(tmp_path):
    for path in (tmp_path / "none.zarr", tmp_path):
        with pytest.raises(DatasetError, match="not a dataset"):
            store.open_dataset(path)
    store.create(tmp_path / "empty.zarr", small_rig(), SPLIT)
    with pytest.raises(DatasetError, match="holds no drive"):
        store.open_dataset(tmp_path / "empty.zarr")


def test_a_folder_of_something_else_is_not_taken_for_a_new_dataset(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(DatasetError, match="is a folder without a dataset; give another folder as --out"):
        store.create(tmp_path, small_rig(), SPLIT)
    assert [file.name for file in tmp_path.iterdir()] == ["notes.txt"]
    (tmp_path / "empty").mkdir()
    store.create(tmp_path / "empty", small_rig(), SPLIT)
    assert (tmp_path / "empty" / "zarr.json").exists()


@pytest.mark.parametrize("out", ["/proc/x.zarr", "/proc/x/y.zarr"])
def test_a_place_where_no_folder_can_be_made_is_an_error(out):
    with pytest.raises(OffpisteError, match=r"/proc(/x)?: nothing can be written there; give another folder"):
        store.create(Path(out), small_rig(), SPLIT)


@pytest.mark.parametrize("schema", [1, 99])
def test_another_schema_is_an_error(tmp_path, schema):
    path = stored(tmp_path)
    zarr.open_group(path, mode="a").attrs["schema"] = schema
    with pytest.raises(DatasetError, match=f"schema {schema}, .* extract it again"):
        store.open_dataset(path)


def test_all_zeros_are_stored_and_read(tmp_path):
    """Zarr leaves chunks of nothing but zeros out by default; here they could not be told from missing ones."""
    rows = circle_rows(600)
    rows.control[:] = 0
    (drive,) = stored_dataset(tmp_path / "data.zarr", {"still": rows}, SPLIT).drives
    assert (drive.rows.control == 0).all()
