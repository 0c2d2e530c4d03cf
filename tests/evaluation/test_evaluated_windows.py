from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from factories import RIG, circle_rows
from offpiste.dataset.splits import Split
from offpiste.dataset.store import Dataset, StoredDrive
from offpiste.evaluation.evaluated_windows import EvaluatedWindows, share_driven_in_training
from offpiste.rig.rig import parse_rig

SPLIT = Split("all", "drives", drives=(("line", "test"),))


def line(parts: dict[str, slice], *, rows: int = 1000, shift: tuple[float, float] = (0.0, 0.0)) -> StoredDrive:
    """5 m/s along x: row r is at 0.1 r metres."""
    part = np.full(rows, -1, dtype=np.int8)
    for name, where in parts.items():
        part[where] = ("train", "validation", "test").index(name)
    drive = circle_rows(rows, speed=5.0, yaw_rate=1e-6)
    return StoredDrive("line", replace(drive, origin=np.array(shift)), part, ())


def dataset(*drives: StoredDrive) -> Dataset:
    return Dataset(Path("nowhere"), parse_rig(RIG, where="test"), SPLIT, drives)


def test_a_path_after_training_was_not_driven_in_training() -> None:
    drive = line({"train": slice(0, 400), "test": slice(600, 1000)})
    assert share_driven_in_training(dataset(drive)) == 0.0


def test_a_path_driven_before_was_driven_in_training_wherever_the_drives_origins_are() -> None:
    trained = line({"train": slice(0, 500)}, shift=(0.0, 0.0))
    again = replace(line({"test": slice(0, 1000)}), name="again")
    moved = replace(again, rows=replace(again.rows, origin=np.array([10.0, 4.0])))
    # Test runs from x = 10 to 109.9 m, 4 m beside training, which ends at 49.9 m: near until 49.9 + 3 m.
    assert share_driven_in_training(dataset(trained, moved)) == pytest.approx(0.43, abs=0.005)
    aside = replace(again, rows=replace(again.rows, origin=np.array([10.0, 6.0])))
    assert share_driven_in_training(dataset(trained, aside)) == 0.0


def test_standing_still_is_no_path() -> None:
    drive = line({"train": slice(0, 300), "test": slice(300, 1000)})
    drive.rows.state[300:350, 3] = 0.0  # near training, but no metre is driven there
    assert share_driven_in_training(dataset(drive)) == pytest.approx(0.0, abs=1e-3)


def test_nothing_trained_and_nothing_tested() -> None:
    assert share_driven_in_training(dataset(line({"test": slice(0, 1000)}))) == 0.0
    assert np.isnan(share_driven_in_training(dataset(line({"train": slice(0, 1000)}))))


def test_speed_and_distance_of_windows() -> None:
    drive = line({"test": slice(0, 1000)})
    drive.rows.state[:100, 3] = np.nan
    drive.rows.state[500:, 3] = 10.0
    drive.rows.state_causal[300, 3:5] = (3.0, 4.0)
    windows = EvaluatedWindows(dataset(drive), np.zeros(3, dtype=int), np.array([100, 300, 400]))
    assert windows.driven_distance[[0, 2]] == pytest.approx([25.0, 0.02 * (100 * 5 + 150 * 10)])
    assert windows.start_speed[1] == pytest.approx(5.0)
    assert windows.at_start("control").shape == (3, 3)


def test_the_step_between_windows_is_what_it_is_where_only_some_are_evaluated() -> None:
    # Windows with a snapshot: 20 to 30 rows apart, and none between drives.
    drive, row = np.repeat([0, 1], 4), np.array([5, 25, 45, 75, 1000, 1020, 1045, 1065])
    empty = dataset(line({}))
    assert EvaluatedWindows(empty, drive, row).usual_step(5) == 20
    assert EvaluatedWindows(empty, drive[[0, 4]], row[[0, 4]]).usual_step(5) == 5
