"""Windows against a slow loop over rows, the rows that no window may touch, and the speed at which windows start."""

import numpy as np
import pytest

from factories import circle_rows, dataset_in_memory
from offpiste.core.conventions import (
    FEATURE_SETS,
    HISTORY_STEPS,
    HORIZON_STEPS,
    MIN_EVALUATION_SPEED,
    min_evaluation_speed,
)
from offpiste.core.errors import DatasetError
from offpiste.dataset.features_under_wheels import Cells
from offpiste.dataset.resample import Rows
from offpiste.dataset.splits import PARTS
from offpiste.dataset.store import Dataset
from offpiste.dataset.window_starts import enough_hindsight
from offpiste.dataset.windows import Windows
from offpiste.rig.rig import load_rig, preset_names


def dataset(*drives: Rows) -> Dataset:
    return dataset_in_memory({f"drive {number}": rows for number, rows in enumerate(drives)}, "blocks:0.5,0.25,0.25")


TWO = dataset(circle_rows(2400, seed=1), circle_rows(2600, speed=3.0, yaw_rate=-0.4, seed=2))


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("start", ["causal", "smoothed"])
def test_gathered_windows_equal_a_slow_loop(part, start):
    windows = Windows(TWO, part, start=start)
    index = np.linspace(0, len(windows) - 1, 7).astype(int)
    batch = windows.gather(index)
    for b, i in enumerate(index):
        rows = TWO.drives[windows.drive[i]].rows
        t = windows.row_in_drive(np.array([i]))[0]
        begins = rows.state_causal if start == "causal" else rows.state
        turns = np.round(begins[t, 2] / (2 * np.pi))
        place = np.array([*begins[t, :2], 2 * np.pi * turns, 0, 0, 0])
        ahead = slice(t + 1, t + 1 + HORIZON_STEPS)
        np.testing.assert_allclose(batch.state[b], begins[t] - place, atol=1e-4)
        np.testing.assert_allclose(batch.target[b], rows.state[ahead] - place, atol=1e-4)
        np.testing.assert_allclose(batch.history.state[b], begins[t - HISTORY_STEPS : t] - place, atol=1e-4)
        np.testing.assert_array_equal(batch.history.control[b], rows.control[t - HISTORY_STEPS : t])
        np.testing.assert_array_equal(batch.control[b], rows.control[t : t + HORIZON_STEPS])
        np.testing.assert_array_equal(batch.target_actuators[b], rows.actuators[ahead])
        np.testing.assert_array_equal(batch.terrain.normal[b], rows.normal[0, t : t + HORIZON_STEPS])
        assert batch.terrain.latent.shape == (7, HORIZON_STEPS, 4, 0)


@pytest.mark.parametrize("chosen", [slice(3, 20, 4), [5, 2, 2], -1, np.arange(500) % 50 == 3])
def test_some_of_the_windows_share_memory(chosen):
    windows = Windows(TWO, "train", horizon=50)
    if isinstance(chosen, np.ndarray):
        chosen = np.resize(chosen, len(windows))
    some, index = windows[chosen], np.atleast_1d(np.arange(len(windows))[chosen])
    assert len(some) == len(index)
    batch, wanted = some.gather(np.arange(len(some))), windows.gather(index)
    assert (batch.state == wanted.state).all()
    assert (batch.target == wanted.target).all()
    assert batch.target.shape == (len(index), 50, 6)
    assert len(some.maps.snapped) == len(some)
    with pytest.raises(IndexError):
        windows[len(windows)]


@pytest.mark.parametrize("part", PARTS)
def test_no_window_touches_an_invalid_row_another_part_or_another_drive(part):
    broken = circle_rows(2400, seed=3)
    broken.valid[[100, 700, 701, 2350]] = False
    data = dataset(broken, circle_rows(2600, seed=4))
    windows = Windows(data, part)
    rows = windows.row_in_drive(np.arange(len(windows)))
    for number, drive in enumerate(data.drives):
        usable = drive.rows.valid & (drive.part == PARTS.index(part))
        mine = rows[windows.drive == number]
        wanted = [
            t
            for t in range(HISTORY_STEPS, len(usable) - HORIZON_STEPS)
            if usable[t - HISTORY_STEPS : t + HORIZON_STEPS + 1].all()
        ]
        assert mine.tolist() == wanted


def test_windows_start_above_the_speed_by_the_causal_estimate():
    rows = circle_rows(2400)
    rows.state_causal[:900, 3] = 1.0
    windows = Windows(dataset(rows), "train")
    assert windows.row_in_drive(np.arange(len(windows))).min() >= 900
    with pytest.raises(DatasetError, match=r"train part has no window of 5 s that starts above 9 m/s"):
        Windows(dataset(rows), "train", min_speed=9.0)


def test_windows_with_enough_of_it():
    valid, unknown = np.zeros((len(FEATURE_SETS), 2), bool), np.full((len(FEATURE_SETS), 2), np.nan, np.float32)
    valid[0, 0] = True
    index = np.repeat(np.array([[0], [1]], np.int32), 3, axis=0).repeat(4, axis=1)
    seen = Cells(index, np.zeros((*valid.shape, 1), np.float16), valid, unknown, unknown)
    # Windows of two rows; the last one ends with the drive.
    np.testing.assert_array_equal(enough_hindsight(seen, 0.5, horizon=2), [True, True, True, False, False, False])
    np.testing.assert_array_equal(enough_hindsight(seen, 1.0, horizon=2), [True, True, False, False, False, False])


def test_equal_froude_numbers_of_small_vehicles() -> None:
    assert {min_evaluation_speed(wheelbase) for wheelbase in (1.5, 2.06, 9.0)} == {MIN_EVALUATION_SPEED} == {1.5}
    wheelbases = np.array([0.05, 0.175, 0.5, 1.0, 1.5])
    speeds = np.array([min_evaluation_speed(float(wheelbase)) for wheelbase in wheelbases])
    np.testing.assert_allclose(speeds**2 / wheelbases, 1.5)
    slower = {name for name in preset_names() if min_evaluation_speed(load_rig(name).vehicle.wheelbase) < 1.5}
    assert slower == {"dart", "dart_filtered"}
