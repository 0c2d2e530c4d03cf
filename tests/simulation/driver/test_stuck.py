import numpy as np
import pytest

from offpiste.conventions import DT
from offpiste.simulation.driver.stuck import Stall


def stand(stall: Stall, seconds: float, *, at_rest: bool = False) -> None:
    for _ in range(round(seconds / DT)):
        stall.advance(1.0, 2.0, speed=0.0, at_rest=at_rest)


def test_standing_is_noticed_then_hopeless_unless_it_is_meant():
    stall = Stall(10.0)
    stand(stall, 60.0, at_rest=True)
    assert not stall.noticed
    stand(stall, 1.0)
    assert not stall.noticed
    stand(stall, 1.0)
    assert stall.noticed
    assert not stall.hopeless
    stand(stall, 9.0)
    assert stall.hopeless


def test_way_made_ends_a_stall():
    stall = Stall(10.0)
    stand(stall, 5.0)
    stall.advance(2.5, 2.0, speed=0.5, at_rest=False)
    assert stall.noticed
    stall.advance(3.5, 2.0, speed=0.5, at_rest=False)
    assert not stall.noticed


def test_turning_on_the_spot_is_no_way_made():
    stall = Stall(10.0)
    stand(stall, 2.0)
    for i in range(round(12 / DT)):
        stall.advance(1.0 + np.cos(i * DT), 2.0, speed=1.5 * np.sin(i * DT), at_rest=False)
    assert stall.hopeless


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_recovery_digs_gently_rolls_back_and_charges_downhill(side):
    stall, tried = Stall(30.0), []
    stand(stall, 2.0)
    for _ in range(round(8 / DT)):
        stall.advance(1.0, 2.0, speed=0.0, at_rest=False)
        tried.append(stall.recover(-0.3 if tried and tried[-1][0] == 0 else 0.0, 0.2 * side))
    throttle, spin, steer = np.array(tried).T
    assert throttle.min() == 0
    assert throttle.max() == 1
    digging, rolling, charging = throttle * (spin < 0.5) > 0, throttle == 0, throttle * (spin > 1) > 0
    assert digging.sum() > rolling.sum() > 20
    assert charging.sum() > 20
    assert np.ptp(steer[digging]) > 0.3
    # Rolling back, the nose turns to the side opposite of the steering, hence downhill; then it drives there.
    assert (steer[rolling][5:] == -0.8 * side).all()
    assert (steer[charging] == side).all()


def test_what_gets_going_is_not_interrupted():
    stall = Stall(30.0)
    stand(stall, 2.0)
    assert all(stall.recover(0.5, 0.0)[0] == 1.0 for _ in range(500))
