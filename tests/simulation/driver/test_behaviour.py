"""Parts of the driver: random intent, pedals, and recovery of a stuck vehicle."""

import numpy as np
import pytest

from offpiste.core.conventions import DT
from offpiste.simulation.driver.driver import RandomIntent, SpeedControl, StuckRecovery, TractionControl
from simulation.drives import drive, flat_world, vehicle_on


def intents(seed: int, count: int):
    stream = RandomIntent(np.random.default_rng(seed), pause=3.5)
    return [stream.advance() for _ in range(count)]


def test_processes_are_standard_normal_and_correlated_in_time():
    speed, cornering, steering = np.array([i[:3] for seed in range(40) for i in intents(seed, 3000)[::50]]).T
    for process in (speed, cornering, steering):
        assert abs(process.mean()) < 0.25
        assert abs(process.std() - 1) < 0.15
    steps = np.array([i[:3] for i in intents(0, 3000)])
    # One second apart: exp(-1/7) for speed, exp(-1/0.7) for steering.
    lagged = [np.corrcoef(process[50:], process[:-50])[0, 1] for process in steps.T]
    assert lagged[0] > 0.7
    assert lagged[2] < 0.5


def test_every_manoeuvre_comes_up_and_ends():
    manoeuvres = [i.manoeuvre for i in intents(1, 30_000)]
    assert set(manoeuvres) == {"", "throttle", "brake", "coast", "swerve", "brake and swerve", "stop"}
    assert 0.5 < np.mean([manoeuvre == "" for manoeuvre in manoeuvres]) < 0.85
    assert all(i.time_left > -0.03 for i in intents(1, 3000) if i.manoeuvre)


@pytest.mark.parametrize("wanted", [0.4, 1.0, 1.5, 3.0])
@pytest.mark.parametrize("slope", [-0.08, 0.0, 0.08])
def test_a_slow_speed_is_kept_on_slopes(wanted, slope):
    control = SpeedControl()
    vehicle = vehicle_on(flat_world(slope=slope))
    samples = drive(vehicle, 12, lambda sample: (*control.pedals(wanted - float(sample.velocity[0])), 0.0))
    speed = np.array([sample.velocity[0] for sample in samples])[-300:]
    assert abs(speed.mean() - wanted) < 0.25
    assert speed.std() < 0.4


def test_it_holds_the_spin_of_sliding_wheels():
    # Wheels on ice: spin grows by 20 m/s^2 per throttle beyond 0.3, which the ground takes up.
    traction, spin, spins = TractionControl(), 0.0, []
    for _ in range(500):
        spin = max(spin + DT * 20 * (traction.throttle(1.0, spin, 0.5) - 0.3), 0.0)
        spins.append(spin)
    assert max(spins) < 5
    assert max(spins[250:]) < 1.0
    assert min(spins[250:]) > 0.1


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
