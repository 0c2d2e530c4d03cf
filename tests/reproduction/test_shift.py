"""Features from elsewhere: hand-worked rows, and maps read where another window starts."""

import numpy as np
import pytest
import torch

from feature_datasets import dataset_with_features
from offpiste.conventions import FEATURE_SETS
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics import MODELS
from offpiste.reproduction.gains import same_windows
from offpiste.reproduction.shift import ShiftedMap, further, shifted
from offpiste.training.build import vehicle_of
from offpiste.training.terrain_sources import encoded, map_terrain, on_map


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return dataset_with_features(tmp_path_factory.mktemp("data") / "seen.zarr")


def test_rows_further_along_the_path_by_hand() -> None:
    # 0, 3, 7 and 12 m along: 5 m on from 0 is first reached at 7, from 3 and 7 at 12; from 12 it goes back to 7.
    path = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0], [8.0, 4.0]])
    assert further(path, 5.0).tolist() == [2, 3, 3, 2]
    assert further(path, 0.0).tolist() == [0, 1, 2, 3]


def test_gaps_of_the_path_do_not_count() -> None:
    path = np.array([[0.0, 0.0], [np.nan, np.nan], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])
    assert further(path, 1.0).tolist() == [3, 3, 3, 4, 3]


def test_shifted_rows_have_the_cells_of_the_rows_further_on(dataset: Dataset) -> None:
    moved = shifted(dataset, 10.0)
    for before, after in zip(dataset.drives, moved.drives, strict=True):
        assert before.rows.cells is not None
        assert after.rows.cells is not None
        rows = further(before.rows.state[:, :2], 10.0)
        np.testing.assert_array_equal(after.rows.cells.index, before.rows.cells.index[rows])
        np.testing.assert_array_equal(after.rows.normal, before.rows.normal)
        along = np.hypot(*np.diff(before.rows.state[:, :2], axis=0).T).sum()
        assert 9.5 < np.abs(rows - np.arange(len(rows))).mean() / len(rows) * along < 10.5


def test_the_same_windows_are_found_where_more_are_kept(dataset: Dataset) -> None:
    few, all_of_them = Windows(dataset, "test"), Windows(shifted(dataset, 5.0), "test", horizon=100)
    assert len(few) < len(all_of_them)
    index = np.arange(0, len(few), 7)
    found = same_windows(few, index, all_of_them)
    np.testing.assert_array_equal(all_of_them.row_in_drive(found), few.row_in_drive(index))
    with pytest.raises(Exception, match="same windows"):
        same_windows(all_of_them, np.arange(len(all_of_them)), few)


def test_a_shifted_map_has_ahead_of_here_what_lies_ahead_there(dataset: Dataset) -> None:
    windows = Windows(dataset, "test")
    model = MODELS["df"](vehicle_of(dataset), seed=0)
    index = np.array([0, 40, 200])
    ground = ShiftedMap(windows, 8.0)
    other = ground._other[index]
    batch = encoded(model, windows.gather(index))
    _, source = ground(model, windows, index, batch)
    there, starts = map_terrain(model, windows, other), windows.gather(other).state
    for ahead in (0.0, 3.0):
        here_state, there_state = (
            torch.cat((s[:, :2] + ahead * torch.stack((s[:, 2].cos(), s[:, 2].sin()), 1), s[:, 2:]), 1)
            for s in (batch.state, starts)
        )
        torch.testing.assert_close(source.at(0, here_state).latent, there.at(0, there_state).latent)
    own = map_terrain(model, windows, index).at(0, batch.state)
    assert not torch.equal(source.at(0, batch.state).latent, own.latent)
    torch.testing.assert_close(source.at(0, batch.state).normal, own.normal)


def test_a_map_shifted_by_nothing_is_the_map(dataset: Dataset) -> None:
    windows, index = Windows(dataset, "test"), np.array([5, 300])
    model = MODELS["df"](vehicle_of(dataset), seed=0)
    batch = encoded(model, windows.gather(index))
    standard_model, source = on_map(model, windows, index, batch)
    moved, other = ShiftedMap(windows, 0.0)(model, windows, index, batch)
    torch.testing.assert_close(moved.history.terrain.latent, standard_model.history.terrain.latent)
    for state in batch.target[:, ::100].unbind(1):
        torch.testing.assert_close(other.at(0, state).latent, source.at(0, state).latent)
        torch.testing.assert_close(other.at(0, state).normal, source.at(0, state).normal)


def test_every_set_is_shifted(dataset: Dataset) -> None:
    windows, moved = Windows(dataset, "test"), Windows(shifted(dataset, 6.0), "test")
    index = np.array([3])
    row = further(dataset.drives[3].rows.state[:, :2], 6.0)[windows.row_in_drive(index)[0]]
    there = np.flatnonzero(windows.row_in_drive(np.arange(len(windows))) == row)
    for name in FEATURE_SETS:
        one = moved.with_feature_set(name).gather(same_windows(windows, index, moved)).ground
        two = windows.with_feature_set(name).gather(there).ground
        assert one is not None
        assert two is not None
        torch.testing.assert_close(one.features[one.ahead[0, 0]], two.features[two.ahead[0, 0]], equal_nan=True)
