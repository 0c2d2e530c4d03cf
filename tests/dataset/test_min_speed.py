"""Minimum speed of window starts by the wheelbase."""

from pathlib import Path

import numpy as np
import pytest

from factories import circle_rows, small_rig
from offpiste.core.conventions import MIN_EVALUATION_SPEED, min_evaluation_speed
from offpiste.core.errors import DatasetError
from offpiste.dataset.splits import parse_split
from offpiste.dataset.store import add_drive, create, open_dataset
from offpiste.dataset.windows import Windows
from offpiste.rig.edits import Edit, edited
from offpiste.rig.rig import load_rig, preset_names


@pytest.mark.parametrize("wheelbase", [1.5, 2.06, 2.14, 2.5, 9.0])
def test_full_size_vehicles_start_above_one_and_a_half(wheelbase: float) -> None:
    assert min_evaluation_speed(wheelbase) == MIN_EVALUATION_SPEED == 1.5


def test_equal_froude_numbers_below() -> None:
    wheelbases = np.array([0.05, 0.175, 0.5, 1.0, 1.5])
    speeds = np.array([min_evaluation_speed(float(wheelbase)) for wheelbase in wheelbases])
    np.testing.assert_allclose(speeds**2 / wheelbases, 1.5)
    slower = {name for name in preset_names() if min_evaluation_speed(load_rig(name).vehicle.wheelbase) < 1.5}
    assert slower == {"dart", "dart_filtered"}


def dataset_of(path: Path, wheelbase: float) -> Path:
    """A circle at 1 m/s by a vehicle of that wheelbase."""
    wheels = [[wheelbase, 0.1], [wheelbase, -0.1], [0.0, 0.1], [0.0, -0.1]]
    rig, split = edited(small_rig(), [Edit("vehicle.wheel_positions", wheels)]), parse_split("blocks:1.0,0.0,0.0")
    create(path, rig, split)
    rows = circle_rows(400)
    speed = float(np.hypot(*rows.state_causal[0, 3:5]))
    rows.state_causal[:, 3:5] /= speed
    add_drive(path, "circle", rows, split, ())
    return path


def test_the_dataset_says_where_its_windows_start(tmp_path: Path) -> None:
    small = open_dataset(dataset_of(tmp_path / "small.zarr", 0.175))
    assert small.min_speed == pytest.approx(0.5123, abs=1e-4)
    assert len(Windows(small, "train")) > 0
    with pytest.raises(DatasetError, match=r"starts above 1\.2 m/s"):
        Windows(small, "train", min_speed=1.2)
    large = open_dataset(dataset_of(tmp_path / "large.zarr", 2.0))
    with pytest.raises(DatasetError, match=r"starts above 1\.5 m/s"):
        Windows(large, "train")
