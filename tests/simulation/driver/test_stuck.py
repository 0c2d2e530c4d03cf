import numpy as np
import pytest

from offpiste.core.conventions import DT
from offpiste.simulation.driver.stuck import StuckRecovery


def stand_still(recovery: StuckRecovery, seconds: float, *, stop_intended: bool = False) -> None:
    for _ in range(round(seconds / DT)):
        recovery.advance(1.0, 2.0, speed=0.0, stop_intended=stop_intended)


def test_a_standstill_counts_as_stuck_and_then_times_out_unless_it_is_intended():
    recovery = StuckRecovery(10.0)
    stand_still(recovery, 60.0, stop_intended=True)
    assert not recovery.stuck
    stand_still(recovery, 1.0)
    assert not recovery.stuck
    stand_still(recovery, 1.0)
    assert recovery.stuck
    assert not recovery.timed_out
    stand_still(recovery, 9.0)
    assert recovery.timed_out


def test_progress_ends_the_recovery():
    recovery = StuckRecovery(10.0)
    stand_still(recovery, 5.0)
    recovery.advance(2.5, 2.0, speed=0.5, stop_intended=False)
    assert recovery.stuck
    recovery.advance(3.5, 2.0, speed=0.5, stop_intended=False)
    assert not recovery.stuck


def test_turning_on_the_spot_is_no_progress():
    recovery = StuckRecovery(10.0)
    stand_still(recovery, 2.0)
    for i in range(round(12 / DT)):
        recovery.advance(1.0 + np.cos(i * DT), 2.0, speed=1.5 * np.sin(i * DT), stop_intended=False)
    assert recovery.timed_out


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_recovery_digs_gently_rolls_back_and_charges_downhill(side):
    recovery, tried = StuckRecovery(30.0), []
    stand_still(recovery, 2.0)
    for _ in range(round(8 / DT)):
        recovery.advance(1.0, 2.0, speed=0.0, stop_intended=False)
        tried.append(recovery.recover(-0.3 if tried and tried[-1][0] == 0 else 0.0, 0.2 * side))
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


def test_a_vehicle_that_begins_to_move_is_not_interrupted():
    recovery = StuckRecovery(30.0)
    stand_still(recovery, 2.0)
    assert all(recovery.recover(0.5, 0.0)[0] == 1.0 for _ in range(500))
