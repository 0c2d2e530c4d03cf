"""Features under the wheels of windows, read in pieces from memory and from disk, against plain indexing."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from feature_datasets import dataset_with_features
from offpiste.core.errors import DatasetError
from offpiste.dataset.feature_sets import FeatureSetChoice, same_feature_set, set_number
from offpiste.dataset.features_under_wheels import Cells, CellTable, NormalsUnderWheels
from offpiste.dataset.ground_tables import ResidentCells, free_budget, ground_tables
from offpiste.dataset.windows import Windows

SETS, FEATURES = 3, 2


def drive(rng: np.random.Generator, rows: int, count: int) -> Cells:
    """A drive over `count` cells, with places that the map does not have, and some cells met again."""
    index = np.sort(rng.integers(-3, count, (rows, 4)), axis=0).clip(min=-1).astype(np.int32)
    index[rng.random((rows, 4)) < 0.1] = rng.integers(-1, count)
    features = rng.normal(size=(SETS, count, FEATURES)).astype(np.float16)
    valid = rng.random((SETS, count)) < 0.7
    far = rng.random((SETS, count)).astype(np.float32)
    return Cells(index, features, valid, far, far)


def plainly(cells: list[Cells], rows: np.ndarray, choice: FeatureSetChoice) -> tuple[np.ndarray, np.ndarray]:
    """Features and validity at each row and wheel; NaN and false where there is no cell."""
    first = np.cumsum([0, *(len(c.index) for c in cells)])
    features = np.full((*rows.shape, 4, FEATURES), np.nan)
    valid = np.zeros((*rows.shape, 4), bool)
    sets = np.broadcast_to(choice.features, rows.shape)
    for place in np.ndindex(*rows.shape, 4):
        number = int(np.searchsorted(first, rows[place[:2]], side="right")) - 1
        mine, chosen = cells[number], int(sets[place[:2]])
        cell = mine.index[rows[place[:2]] - first[number], place[2]]
        if cell >= 0:
            features[place] = mine.features[chosen, cell]
            valid[place] = mine.valid[chosen, cell]
    return features, valid


@pytest.mark.parametrize("table", [CellTable, ResidentCells])
@given(seed=st.integers(0, 10_000), kind=st.sampled_from(["one", "each", "steps"]))
def test_windows_find_what_plain_indexing_finds(table, seed, kind):
    rng = np.random.default_rng(seed)
    cells = [drive(rng, 40, 30), drive(rng, 25, 1), drive(rng, 30, 50)]
    start = np.array([n for n in (0, 3, 3, 34, 41, 58, 65, 80, 89) if rng.random() < 0.8] or [0])
    rows = start[:, None] + np.arange(6)
    shape = (len(rows), 6 if kind == "steps" else 1)
    choice = (
        same_feature_set(len(rows), 1)
        if kind == "one"
        else FeatureSetChoice(rng.integers(0, SETS, shape), np.zeros(len(rows), int))
    )
    under = table(cells, torch.device("cpu")).under(start, 6, choice, history=2)
    wanted, valid = plainly(cells, rows, choice)
    number = torch.cat((under.past, under.ahead), dim=1)
    assert under.past.shape[1] == 2
    np.testing.assert_array_equal(under.features[number].numpy(), wanted.astype(np.float32))
    np.testing.assert_array_equal(under.valid[number].numpy(), valid)
    assert len(torch.unique(number)) >= len(under.features) - 1, "cells that no wheel touches are not encoded"


def on_disk(array: np.ndarray, path) -> np.memmap:
    array.tofile(path)
    return np.memmap(path, dtype=array.dtype, mode="r", shape=array.shape)


@pytest.mark.parametrize("resident", [False, True])
@pytest.mark.parametrize("disk", [False, True])
def test_normals_of_a_window_are_of_its_set(tmp_path, disk, resident):
    rng = np.random.default_rng(1)
    arrays = [rng.normal(size=(SETS, rows, 4, 3)).astype(np.float32) for rows in (30, 20)]
    given_ = [on_disk(a, tmp_path / str(n)) for n, a in enumerate(arrays)] if disk else arrays
    normals, start = NormalsUnderWheels(given_, torch.device("cpu"), resident=resident), np.array([0, 24, 30, 44])
    whole = np.concatenate(arrays, axis=1)
    for sets in (rng.integers(0, SETS, 4), np.zeros(4, int)):
        found = normals.at(start, 6, sets).numpy()
        for window, first in enumerate(start):
            np.testing.assert_array_equal(found[window], whole[sets[window], first : first + 6])


def test_sets_have_names():
    assert [set_number(name, 8) for name in ("hindsight", "-20", "0", "40")] == [0, 1, 3, 7]
    assert set_number("hindsight", 1) == 0
    with pytest.raises(DatasetError, match="no feature set '15'"):
        set_number("15", 8)
    with pytest.raises(DatasetError, match="no set '10'"):
        set_number("10", 1)


def test_what_fits_is_resident_and_gives_the_same_batches(tmp_path):
    dataset = dataset_with_features(tmp_path / "data.zarr", rows=400)
    rows = [drive.rows for drive in dataset.drives]
    needed = sum(
        r.normal.nbytes + r.cells.features.nbytes + r.cells.valid.nbytes + 2 * r.cells.index.nbytes for r in rows
    )
    assert isinstance(ground_tables(dataset, torch.device("cpu"), needed - 1).cells, CellTable)
    ground = ground_tables(dataset, torch.device("cpu"), needed)
    assert isinstance(ground.cells, ResidentCells)
    kept = (ground.cells._index, ground.cells._valid, ground.cells._features, ground.normals._values)
    assert sum(part.nbytes for part in kept) == needed
    from_disk, from_device = Windows(dataset, "train"), Windows(dataset, "train", ground=ground)
    index, rng = np.array([0, 40, 7, 7, 90]), np.random.default_rng(0)
    choice = FeatureSetChoice(rng.integers(0, from_disk.sets, (5, 1)), rng.integers(0, from_disk.sets, 5))
    wanted, found = from_disk.gather(index, choice), from_device.gather(index, choice)
    assert torch.equal(found.terrain.normal, wanted.terrain.normal)
    assert torch.equal(found.history.terrain.known, wanted.history.terrain.known)
    for of_found, of_wanted in ((found.ground.past, wanted.ground.past), (found.ground.ahead, wanted.ground.ahead)):
        assert torch.equal(found.ground.valid[of_found], wanted.ground.valid[of_wanted])
        looks = found.ground.features[of_found], wanted.ground.features[of_wanted]
        torch.testing.assert_close(*looks, rtol=0, atol=0, equal_nan=True)
    starts = from_device.features_at_starts(), from_disk.features_at_starts()
    torch.testing.assert_close(*starts, rtol=0, atol=0, equal_nan=True)
    assert free_budget(torch.device("cpu")) == 0
