"""More throttle where the planned one does not move the vehicle."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from offpiste.conventions import DT
from offpiste.runtime.schedule import Launch, LaunchSettings


def test_it_rises_while_the_vehicle_stands_and_comes_back_when_it_moves():
    launch = Launch(LaunchSettings(below=1.0, rate=0.5))
    standing = [launch.throttle(0.3, 0.0) for _ in range(100)]
    assert standing[0] == pytest.approx(0.3 + 0.5 * DT)
    assert standing[49] == pytest.approx(0.3 + 0.5 * DT * 50)
    assert standing[-1] == 1.0, "full throttle is all there is"
    moving = [launch.throttle(0.3, 2.0) for _ in range(100)]
    assert moving[49] == pytest.approx(1.0 - 0.5 * DT * 50)
    assert moving[-1] == pytest.approx(0.3), "and no less"


def test_who_wants_to_stand_is_left_alone():
    launch = Launch()
    for _ in range(50):
        launch.throttle(0.4, 0.0)
    assert launch.throttle(0.0, 0.0) == 0.0
    assert launch.throttle(0.4, 0.0) == pytest.approx(0.4 + 0.3 * DT), "begins anew"


def test_what_will_be_given_is_told_before_and_changes_nothing():
    launch, planned = Launch(), np.array([0.4, 0.5, 0.0, 0.4, 0.9])
    launch.throttle(0.4, 0.0)
    told = launch.ahead(planned, 0.5)
    np.testing.assert_array_equal(launch.ahead(planned, 0.5), told)
    np.testing.assert_array_equal([launch.throttle(one, 0.5) for one in planned], told)
    launch.reset()
    assert launch.throttle(0.4, 2.0) == 0.4


@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0, 10)), max_size=50))
def test_between_the_planned_and_full_throttle(driven):
    launch = Launch()
    for planned, speed in driven:
        assert planned <= launch.throttle(planned, speed) <= 1.0 + 1e-9
