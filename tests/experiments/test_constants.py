"""Constants of made-up bicycles, and a rear axle whose place is known."""

import numpy as np
import pytest
import torch

from experiments.constants import Constants, constants_table, rear_axle, rear_axle_table
from offpiste.dynamics.bicycle import BicycleConstants
from offpiste.errors import OffpisteError
from tests.factories import VEHICLE


def turning(length, slip, n=400):
    """Rows of a vehicle whose rear axle moves where it points, less a slip in proportion to r vx²."""
    rng = np.random.default_rng(0)
    vx, yaw_rate = rng.uniform(2, 9, n), rng.uniform(-0.5, 0.5, n)
    vy = length * yaw_rate - slip * yaw_rate * vx**2
    return np.stack([np.zeros(n), np.zeros(n), np.zeros(n), vx, vy, yaw_rate], axis=1)


def test_the_rear_axle_is_where_it_was_put():
    state = turning(1.7, 0.02)
    state[::7] = np.nan
    with_slip, without, rows = rear_axle(state, 1.5, np.inf)
    assert with_slip == pytest.approx(1.7)
    assert without < 1.5
    assert 0 < rows < 400
    assert rear_axle(turning(1.7, 0.0), 1.5, np.inf)[:2] == pytest.approx((1.7, 1.7))


def test_too_few_turning_rows_say_nothing():
    state = turning(1.7, 0.02, n=30)
    assert np.isnan(rear_axle(state, 1.5, np.inf)[0])
    assert "| above 8 | 0 | nan | nan |" in rear_axle_table(state[state[:, 3] < 8])


def test_the_table_shows_what_the_module_holds():
    constants = BicycleConstants(VEHICLE)
    lines = constants_table([("one", constants), ("two", constants)])
    cells = {line.split("|")[1].strip(): line.split("|")[2:4] for line in lines[2:]}
    with torch.no_grad():
        expected = constants()
    assert float(cells["L_R [m]"][0]) == pytest.approx(float(expected.rear_length), rel=5e-3)
    assert float(cells["C_max over Euler's bound"][1]) == pytest.approx(2, rel=5e-3)


def test_a_folder_without_a_run_is_one_line(tmp_path):
    with pytest.raises(OffpisteError, match="nothing"):
        Constants((tmp_path / "nothing",)).run()
