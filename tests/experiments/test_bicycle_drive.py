from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from offpiste.dataset.extract import extract_rows
from offpiste.experiments.bicycle_drive import Noise, ground_height, ground_normal, simulate_drive, write_drive
from offpiste.logs import read_drive
from offpiste.rig import load_rig


def test_the_same_seed_gives_the_same_drive_and_another_seed_another() -> None:
    first, same, other = (simulate_drive(4.0, seed) for seed in (3, 3, 4))
    assert all(np.array_equal(first[name], same[name]) for name in first)
    assert not np.allclose(first["x"], other["x"])


def test_normals_are_those_of_the_ground() -> None:
    xy = np.random.default_rng(0).uniform(-50, 50, (20, 2))
    normal = ground_normal(xy)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1)
    step = 1e-4 * np.array([[0.6, 0.8]])
    rise = (ground_height(xy + step) - ground_height(xy - step)) / 2e-4
    np.testing.assert_allclose(-(normal[:, :2] @ [0.6, 0.8]) / normal[:, 2], rise, atol=1e-5)


def test_the_log_is_read_back_as_the_motion_that_was_simulated(tmp_path: Path) -> None:
    write_drive(tmp_path / "drive.parquet", 20.0, 1)
    truth = simulate_drive(20.0, 1, Noise(position=0.0, heading=0.0, actuator=0.0))
    rows = extract_rows(read_drive(tmp_path / "drive.parquet", load_rig("bicycle")))
    at = np.searchsorted(truth["time"], rows.time + 1e-6) - 1
    place = np.stack((truth["x"], truth["y"]), axis=1)[at]
    np.testing.assert_allclose((rows.state[:, :2] + rows.origin)[rows.valid], place[rows.valid], atol=0.05)
    np.testing.assert_allclose(rows.control[rows.valid, 2], truth["steer"][at][rows.valid], atol=1e-6)
    assert rows.valid.mean() > 0.97
    # Positions are the integral of the velocities: no unit, frame or delay is off.
    driven = np.hypot(*np.diff(place, axis=0).T).sum()
    assert rows.distance == pytest.approx(driven, rel=0.02)


def test_the_file_is_whole_or_absent(tmp_path: Path) -> None:
    write_drive(tmp_path / "drive.parquet", 1.0, 0)
    assert pq.read_table(tmp_path / "drive.parquet").num_rows == 50
    assert [f.name for f in tmp_path.iterdir()] == ["drive.parquet"]
