"""Declarations of columns: what they read, and which rows are complete."""

import numpy as np
import pytest

from factories import circle_rows, small_rig
from offpiste.core.channels import MORE_ACTUATORS, Actuator
from offpiste.dataset.columns import COLUMNS, Column, RowGrid, channel_column
from offpiste.dataset.resample import rows_from_arrays
from offpiste.logs.channel import Channel
from offpiste.logs.drive import Drive
from offpiste.rig import channels


def test_a_column_that_rows_were_made_without_is_unknown(monkeypatch):
    monkeypatch.setattr(COLUMNS, "_entries", dict(COLUMNS.items()))
    COLUMNS.register("slip")(Column(read=lambda grid: grid.time, shape=(4,)))
    rows = circle_rows(20)
    assert rows.column("slip").shape == (20, 4)
    assert np.isnan(rows.column("slip")).all()
    given = rows_from_arrays({**rows.arrays(), "slip": np.ones((20, 4), np.float32)}, rows.origin)
    assert (given.column("slip") == 1).all()


@pytest.mark.parametrize(("present", "complete"), [(True, [True, False, False]), ([True, False], [True, True, False])])
def test_rows_are_complete_where_present_components_are_known(present, complete):
    column = Column(read=lambda grid: grid.time, shape=(2,), present=lambda rig: present)
    values = np.array([[1.0, 1.0], [1.0, np.nan], [np.inf, 1.0]])
    assert column.complete(values, small_rig()).tolist() == complete
    by_set = Column(read=lambda grid: grid.time, shape=(2,), present=lambda rig: present, by_feature_set=True)
    assert by_set.complete(values[None], small_rig()).tolist() == complete


def test_actuators_of_one_channel_have_a_column_each(monkeypatch):
    for name in ("front", "rear"):
        monkeypatch.setitem(MORE_ACTUATORS._entries, name, Actuator(name, channel="air"))
    rig, time = small_rig('[channels.air]\ntopic = "air"\nfields = ["p"]\n'), np.arange(0, 3, 0.1)
    grid = RowGrid(Drive("one", rig, {"air": Channel("air", "1", time, time[:, None])}), time)
    np.testing.assert_allclose(COLUMNS["actuators"].read(grid)[:, 4:], np.stack((time, time), axis=1))
    assert COLUMNS["actuators"].present(rig) == [False] * 4 + [True] * 2


def test_a_channel_column_is_unknown_in_gaps_and_absent_without_the_channel(monkeypatch):
    monkeypatch.setitem(channels.OTHER_CHANNELS, "temperature", ("1", (1,)))
    rig = small_rig('[channels.temperature]\ntopic = "air"\nfields = ["degrees"]\n')
    time = np.append(np.arange(0, 3, 0.1), np.arange(5, 8, 0.1))
    drive = Drive("one", rig, {"temperature": Channel("temperature", "1", time, 2 * time[:, None])})
    column, grid = channel_column("temperature", "ahead"), RowGrid(drive, np.arange(0, 7.5, 0.5))
    values = column.read(grid)
    known = (grid.time < 3) | (grid.time >= 5)
    np.testing.assert_allclose(values[known], 2 * grid.time[known])
    np.testing.assert_array_equal(column.complete(values, rig), known)
    without = column.read(RowGrid(Drive("two", small_rig(), {}), grid.time))
    assert np.isnan(without).all()
    held = channel_column("temperature", "past", "start").read(RowGrid(drive, np.array([-0.01, 0.19, 2.99, 3.5, 4.99])))
    np.testing.assert_allclose(held, [np.nan, 0.2, 5.8, np.nan, np.nan])
    assert column.complete(without, small_rig()).all()
