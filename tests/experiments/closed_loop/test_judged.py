"""What was driven, in numbers."""

import numpy as np
import pytest

from offpiste.experiments.closed_loop.judged import Trace, driven_cost
from offpiste.planning.costs import Weights


def test_the_driven_cost_by_hand():
    # Two seconds 0.5 m beside the course, at 5 m/s where 7 are wanted: 2 s x (3 x 0.25 + 1 x 4).
    n = 100
    trace = Trace(np.zeros((n, 2)), *(np.full(n, value) for value in (5.0, 0.5, 7.0, 0.0, 0.0)))
    weights = Weights(path=3.0, speed=1.0)
    assert driven_cost(trace, n, None, weights) == pytest.approx(2 * (0.75 + 4.0))
    # Not at the end after 10 s: the other eight count as standing.
    assert driven_cost(trace, n, 10.0, weights) == pytest.approx(2 * (0.75 + 4.0) + 8 * 49.0)
    assert driven_cost(trace, 50, None, weights) == pytest.approx(0.75 + 4.0)
