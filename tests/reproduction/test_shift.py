"""Features from elsewhere: hand-worked rows, and maps read where another window starts."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from feature_datasets import dataset_with_features
from offpiste.core.conventions import FEATURE_SETS
from offpiste.core.errors import RunError
from offpiste.dataset.store import Dataset
from offpiste.dataset.windows import Windows
from offpiste.dynamics import MODELS
from offpiste.reproduction.results import HINDSIGHT, MAP, errors_of, same_windows
from offpiste.reproduction.runs import evaluation_windows
from offpiste.reproduction.shift import ShiftedMap, other_ground, shift_gains, shifted
from offpiste.training.config import TrainConfig
from offpiste.training.prediction import encoded, map_terrain, on_map
from offpiste.training.run import Run, Stretch, load_run, save_run, vehicle_of


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return dataset_with_features(tmp_path_factory.mktemp("data") / "seen.zarr")


def untrained(dataset: Dataset, model: str, folder: Path) -> Run:
    """A run of a model as it begins."""
    config = TrainConfig(model=model)
    save_run(folder, MODELS[model](vehicle_of(dataset, config), seed=0), config, dataset, torch.ones(5))
    return load_run(folder)


def test_other_ground_by_hand() -> None:
    # 5 m in a straight line: from (0, 0) the third; from (3, 0) the last; the last two find it behind them.
    path = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0], [8.0, 4.0]])
    assert other_ground(path, 5.0).tolist() == [2, 3, 3, 2]
    assert other_ground(path, 0.0).tolist() == [0, 1, 2, 3]
    assert other_ground(path, 9.0).tolist() == [-1, -1, -1, -1]


def test_rows_without_a_place_have_no_other_ground_and_are_none() -> None:
    path = np.array([[0.0, 0.0], [np.nan, np.nan], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])
    assert other_ground(path, 1.0).tolist() == [2, -1, 3, 4, 3]


def test_laps_and_standstills_lead_nowhere() -> None:
    angle = np.linspace(0, 20 * np.pi, 3000)
    laps = 20 * np.column_stack((np.cos(angle), np.sin(angle)))  # 1250 m driven, 40 m wide
    assert (other_ground(laps, 50.0) == -1).all()
    assert (other_ground(laps, 39.0) >= 0).all()


def test_other_ground_agrees_with_brute_force() -> None:
    rng = np.random.default_rng(0)
    path = np.cumsum(rng.normal(0, 1, (300, 2)), axis=0)
    path[100:130] = path[100]  # stands
    path[200:220] = np.nan
    apart = np.hypot(*(path[:, None] - path).transpose(2, 0, 1))
    found = other_ground(path, 8.0)
    for row, far in enumerate(apart >= 8.0):
        ahead, behind = np.flatnonzero(far[row:]) + row, np.flatnonzero(far[:row])
        assert found[row] == (ahead[0] if len(ahead) else behind[-1] if len(behind) else -1)
    assert {-1} < set(found)


def test_shifted_rows_have_the_cells_of_rows_so_far_away(dataset: Dataset) -> None:
    moved = shifted(dataset, 10.0)
    for before, after in zip(dataset.drives, moved.drives, strict=True):
        assert before.rows.cells is not None
        assert after.rows.cells is not None
        place = before.rows.state[:, :2].astype(float)
        rows = other_ground(place, 10.0)
        far = rows >= 0
        np.testing.assert_array_equal(after.rows.cells.index[far], before.rows.cells.index[rows[far]])
        assert (after.rows.cells.index[~far] == -1).all()
        np.testing.assert_array_equal(after.rows.normal, before.rows.normal)
        assert (np.hypot(*(place[rows[far]] - place[far]).T) >= 10.0).all()


def test_windows_without_ground_so_far_away_are_left_out_of_all_that_is_compared(tmp_path: Path) -> None:
    dataset = dataset_with_features(tmp_path / "dataset.zarr", rows=6000, yaw_rate=0.025)  # half a round
    runs = {model: [untrained(dataset, model, tmp_path / f"{model}-0")] for model in ("b", "df")}
    windows = Windows(dataset, "test")
    mine = evaluation_windows(windows, MAP, 25)
    place, every = windows.places(mine).numpy(), windows.places(np.arange(len(windows))).numpy()
    apart = np.hypot(*(place[:, None] - every).transpose(2, 0, 1)).max(axis=1)
    metres = 0.8 * apart.max()
    options = {"stride": 25, "scale": torch.ones(5), "kept": tmp_path / "kept", "metres": metres}
    found = shift_gains(dataset, runs, **options)
    on_map, recorded = found.ground
    assert (on_map.windows, on_map.used) == (len(mine), int((apart >= metres).sum()))
    assert 0 < on_map.used < on_map.windows
    assert metres <= on_map.metres[0] <= on_map.metres[1] <= on_map.metres[2] < metres + 2.0
    assert 0 < recorded.used < recorded.windows
    for gain in found.gains:
        assert gain.n == (on_map if gain.lookup == "map" else recorded).used
    as_recorded, moved, own = found.gains[:3]
    assert own.distance.mean == pytest.approx(as_recorded.error_m / moved.error_m - 1)
    assert shift_gains(dataset, runs, **options).gains == found.gains
    assert f"have ground at least {metres:.0f} m away" in found.about


def test_too_few_windows_with_other_ground_are_none(tmp_path: Path, dataset: Dataset) -> None:
    runs = {model: [untrained(dataset, model, tmp_path / f"{model}-0")] for model in ("b", "df")}
    found = shift_gains(dataset, runs, stride=25, scale=torch.ones(5), kept=tmp_path / "kept", metres=50.0)
    assert not found.gains
    assert [one.used for one in found.ground] == [0, 0]
    assert "on the map: none, since only 0 of " in found.about


def test_errors_of_other_windows_are_not_taken_for_these(tmp_path: Path, dataset: Dataset) -> None:
    run, windows = untrained(dataset, "b", tmp_path / "b-0"), Windows(dataset, "test")
    first, other = (
        errors_of(run, windows, np.array(index), HINDSIGHT, scale=torch.ones(5), kept=tmp_path / "kept")
        for index in ([0, 50], [20, 50, 100])
    )
    assert (len(first.row), len(other.row)) == (2, 3)
    assert other.loss[1] == first.loss[1]
    kept = {"index": np.array([20, 50, 100]), "kept": tmp_path / "kept"}
    doubled = errors_of(run, windows, reading=HINDSIGHT, scale=torch.full((5,), 2.0), **kept)
    assert np.all(doubled.loss < other.loss), "the loss is in other units"


def test_errors_on_windows_that_a_run_was_trained_on_are_refused(tmp_path: Path, dataset: Dataset) -> None:
    run, windows, index = untrained(dataset, "b", tmp_path / "b-0"), Windows(dataset, "test"), np.array([0, 50])
    options = {"scale": torch.ones(5), "kept": tmp_path / "kept"}
    assert len(errors_of(run, windows, index, HINDSIGHT, **options).row) == 2
    informed = replace(run, seen=(Stretch(windows.drive_names[windows.drive[0]], 0.0, 60.0),))
    with pytest.raises(RunError, match=r"b-0: was trained on 18 s of the test part of drive"):
        errors_of(informed, windows, index, HINDSIGHT, **options)
    assert len(errors_of(run, Windows(dataset, "validation"), index, HINDSIGHT, **options).row) == 2


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
    ground = ShiftedMap(windows, 4.0)
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
    row = other_ground(dataset.drives[3].rows.state[:, :2], 6.0)[windows.row_in_drive(index)[0]]
    there = np.flatnonzero(windows.row_in_drive(np.arange(len(windows))) == row)
    for name in FEATURE_SETS:
        one = moved.with_feature_set(name).gather(same_windows(windows, index, moved)).ground
        two = windows.with_feature_set(name).gather(there).ground
        assert one is not None
        assert two is not None
        torch.testing.assert_close(one.features[one.ahead[0, 0]], two.features[two.ahead[0, 0]], equal_nan=True)


def test_errors_of_a_run_trained_again_in_its_folder_are_its_own(tmp_path: Path, dataset: Dataset) -> None:
    windows, kept = Windows(dataset, "test"), tmp_path / "kept"
    losses = []
    for number in range(2):
        run = untrained(dataset, "parametric", tmp_path / "parametric-0")
        with torch.no_grad():
            for value in run.dynamics.parameters():
                value += 0.1 * number
        losses.append(errors_of(run, windows, np.array([0, 50]), HINDSIGHT, scale=torch.ones(5), kept=kept).loss)
    assert not np.allclose(*losses)
