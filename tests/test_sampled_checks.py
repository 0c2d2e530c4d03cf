"""Sampled shape checks."""

import jaxtyping
import numpy as np
import pytest
from beartype import beartype
from jaxtyping import Float

from offpiste.simulation.sample import Pose
from sampled_checks import EVERY, FIRST, begin_test, sampled


def total(values: Float[np.ndarray, "2"]) -> float:
    return float(values.sum())


CHECKED = sampled(total, typechecker=beartype)


def is_refused() -> bool:
    try:
        CHECKED(np.zeros(3))
    except jaxtyping.TypeCheckError:
        return True
    return False


def test_first_calls_are_checked_and_some_later_ones():
    refused = [is_refused() for _ in range(FIRST + 2 * EVERY)]
    assert all(refused[:FIRST])
    assert sum(refused[FIRST:]) == 2
    begin_test()
    assert is_refused()


def test_the_package_is_checked():
    pose = Pose(np.zeros(3), np.array((0.0, 0.0, 0.0, 1.0)))
    with pytest.raises(jaxtyping.TypeCheckError):
        pose.apply(np.zeros(3))
    with pytest.raises(jaxtyping.TypeCheckError):
        Pose(np.zeros(2), pose.orientation)
