"""Shapes are checked in tests."""

import jaxtyping
import numpy as np
import pytest

from offpiste.simulation.sample import Pose
from sampled_checks import EVERY, FIRST, begin_test


def test_first_calls_are_checked_and_some_later_ones():
    pose = Pose(np.zeros(3), np.array((0.0, 0.0, 0.0, 1.0)))

    def is_refused() -> bool:
        try:
            pose.apply(np.zeros(3))
        except jaxtyping.TypeCheckError:
            return True
        except ValueError:  # of NumPy
            return False
        return False

    refused = [is_refused() for _ in range(FIRST + 2 * EVERY)]
    assert all(refused[:FIRST])
    assert sum(refused[FIRST:]) == 2
    begin_test()
    assert is_refused()
    with pytest.raises(jaxtyping.TypeCheckError):
        Pose(np.zeros(2), pose.orientation)
