"""Schedule of controls, and throttle added where the planned one does not move the vehicle."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from offpiste.conventions import DT
from offpiste.runtime.schedule import Launch, LaunchSettings, Schedule, TimedPlan

REST = np.array((9.0, 9.0, 9.0))


def plan(start, first, steps=5):
    """Throttle counts steps from `first`."""
    controls = torch.zeros(steps, 3)
    controls[:, 0] = first + torch.arange(steps)
    return TimedPlan(start, start, controls)


def test_a_later_plan_acts_instead_of_the_earlier_from_its_start_on():
    schedule = Schedule()
    assert schedule.control(0.0) is None
    assert schedule.acting(0.0) is None
    schedule.add(plan(0.10, 0.0))
    schedule.add(plan(0.14, 100.0))
    assert schedule.control(0.08) is None
    due = [schedule.control(0.10 + DT * row)[0] for row in range(8)]
    assert due == [0, 1, 100, 101, 102, 103, 104, 104]  # the last one is held
    assert schedule.acting(0.12).start == 0.10
    assert schedule.acting(0.20).start == 0.14


def test_what_is_committed_is_what_will_be_commanded():
    schedule = Schedule()
    schedule.add(plan(0.04, 0.0))
    schedule.add(plan(0.08, 100.0))
    committed = schedule.committed(0.0, 6, REST)
    assert committed[:, 0].tolist() == [9, 9, 0, 1, 100, 101]
    assert schedule.committed(0.0, 0, REST).shape == (0, 3)


def test_the_next_plan_begins_with_what_is_left():
    schedule = Schedule()
    assert schedule.continued(1.0, 4, REST).tolist() == [[9.0] * 3] * 4
    schedule.add(plan(0.0, 0.0))
    assert schedule.continued(0.06, 5, REST)[:, 0].tolist() == [3, 4, 4, 4, 4]
    assert schedule.continued(1e3, 5, REST)[:, 0].tolist() == [4] * 5


def test_stamps_of_this_century_do_not_shift_steps():
    begin = 1_700_000_000.0
    schedule = Schedule()
    schedule.add(plan(begin + 0.1, 0.0, steps=250))
    for row in range(250):
        assert schedule.control(begin + 0.1 + row * DT)[0] == row


def test_added_throttle_rises_at_a_standstill_and_falls_when_the_vehicle_moves():
    launch = Launch(LaunchSettings(below=1.0, rate=0.5))
    standing = [launch.throttle(0.3, 0.0) for _ in range(100)]
    assert standing[0] == pytest.approx(0.3 + 0.5 * DT)
    assert standing[49] == pytest.approx(0.3 + 0.5 * DT * 50)
    assert standing[-1] == 1.0, "full throttle is all there is"
    moving = [launch.throttle(0.3, 2.0) for _ in range(100)]
    assert moving[49] == pytest.approx(1.0 - 0.5 * DT * 50)
    assert moving[-1] == pytest.approx(0.3), "and no less"


def test_no_throttle_is_added_where_none_is_planned():
    launch = Launch()
    for _ in range(50):
        launch.throttle(0.4, 0.0)
    assert launch.throttle(0.0, 0.0) == 0.0
    assert launch.throttle(0.4, 0.0) == pytest.approx(0.4 + 0.3 * DT), "it starts from the plan again"


def test_throttle_of_steps_to_come_is_computed_without_changing_it():
    launch, planned = Launch(), np.array([0.4, 0.5, 0.0, 0.4, 0.9])
    launch.throttle(0.4, 0.0)
    ahead = launch.ahead(planned, 0.5)
    np.testing.assert_array_equal(launch.ahead(planned, 0.5), ahead)
    np.testing.assert_array_equal([launch.throttle(one, 0.5) for one in planned], ahead)
    launch.reset()
    assert launch.throttle(0.4, 2.0) == 0.4


@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0, 10)), max_size=50))
def test_throttle_is_between_the_planned_one_and_full(driven):
    launch = Launch()
    for planned, speed in driven:
        assert planned <= launch.throttle(planned, speed) <= 1.0 + 1e-9
