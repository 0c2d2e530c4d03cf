"""Cost terms by hand."""

import math

import pytest

from offpiste.planning.costs import terms
from offpiste.planning.costs.weights import CostWeights

G = 9.81


def ratio(acceleration, angle=0.0):
    return terms.lateral_ratio(acceleration, math.sin(angle), math.cos(angle), G, 1.0, max)


def test_speed_is_that_along_the_course():
    def cost(yaw, vx, vy, direction, target, weight):
        return terms.speed_term(terms.speed_along(*yaw, vx, vy, *direction), target, weight)

    quarter = (0.0, 1.0)  # heads north
    assert cost(quarter, 5.0, 0.0, (0.0, 1.0), 5.0, 3.0) == 0
    assert cost(quarter, 5.0, 0.0, (1.0, 0.0), 5.0, 3.0) == 75
    assert cost(quarter, 0.0, -2.0, (1.0, 0.0), 5.0, 3.0) == 27
    assert cost(quarter, 5.0, 0.0, (0.0, -1.0), 5.0, 1.0) == 100


def test_only_what_is_above_the_speed_limit_counts():
    assert terms.overspeed_term(4.0, 5.0, 2.0, max) == 0
    assert terms.overspeed_term(8.0, 5.0, 2.0, max) == 18
    assert terms.overspeed_term(-8.0, 5.0, 2.0, max) == 18
    assert terms.overspeed_term(8.0, math.inf, 2.0, max) == 0


@pytest.mark.parametrize(
    ("lean", "angle"), [(0.5, 0.0), (-0.5, 0.0), (0.0, 0.35), (0.0, -0.35), (0.26, 0.26), (-0.26, 0.26), (0.3, 0.2)]
)
def test_the_specific_force_leans_away_from_the_normal_of_the_ground(lean, angle):
    """By atan(a_y / g) less the angle at which the ground falls to the left: nothing is felt on a banked left turn."""
    assert ratio(G * math.tan(lean), angle) == pytest.approx(abs(math.tan(lean - angle)), abs=1e-12)


def test_lifting_off_is_expensive():
    assert ratio(-50 * G, math.radians(60)) > 20


def test_rollover_is_a_step_and_then_a_ramp():
    assert terms.rollover_term(0.69, 0.7, 100.0, max) == 0
    assert terms.rollover_term(0.7, 0.7, 100.0, max) == 0
    assert terms.rollover_term(0.9, 0.7, 100.0, max) == pytest.approx(120)


def test_weights_are_the_same_whether_defaults_are_given_or_not():
    defaults = CostWeights()
    assert CostWeights(path=defaults.path) == defaults != CostWeights(path=2 * defaults.path)
