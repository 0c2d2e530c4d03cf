import numpy as np
import pytest

from offpiste.core.conventions import DT
from offpiste.simulation.driver.pedal_control import SpeedControl, TractionControl
from simulation.drives import drive, flat_world, vehicle_on


@pytest.mark.parametrize("wanted", [0.4, 1.0, 1.5, 3.0])
@pytest.mark.parametrize("slope", [-0.08, 0.0, 0.08])
def test_a_slow_speed_is_kept_on_slopes(wanted, slope):
    control = SpeedControl()
    vehicle = vehicle_on(flat_world(slope=slope))
    samples = drive(vehicle, 12, lambda sample: (*control.pedals(wanted - float(sample.velocity[0])), 0.0))
    speed = np.array([sample.velocity[0] for sample in samples])[-300:]
    assert abs(speed.mean() - wanted) < 0.25
    assert speed.std() < 0.4


def test_pedals_stay_within_limits_and_are_not_pressed_together():
    control, rng = SpeedControl(), np.random.default_rng(0)
    throttle, brake = np.array([control.pedals(float(lack)) for lack in rng.normal(0, 3, 2000)]).T
    assert throttle.min() == brake.min() == 0
    assert 0.9 < throttle.max() <= 1
    assert 0.9 < brake.max() <= 1
    assert not (throttle * brake).any()


def test_without_spin_the_throttle_follows_the_request():
    traction = TractionControl()
    throttles = [traction.throttle(0.7, 0.0, 1.0) for _ in range(100)]
    assert throttles[0] < 0.2 < 0.7 - 1e-3 < throttles[-1] <= 0.7


def test_it_holds_the_spin_of_sliding_wheels():
    # Wheels on ice: spin grows by 20 m/s^2 per throttle beyond 0.3, which the ground takes up.
    traction, spin, spins = TractionControl(), 0.0, []
    for _ in range(500):
        spin = max(spin + DT * 20 * (traction.throttle(1.0, spin, 0.5) - 0.3), 0.0)
        spins.append(spin)
    assert max(spins) < 5
    assert max(spins[250:]) < 1.0
    assert min(spins[250:]) > 0.1


def test_grip_returns_the_throttle():
    traction = TractionControl()
    for _ in range(200):
        spinning = traction.throttle(1.0, 5.0, 0.5)
    for _ in range(200):
        gripping = traction.throttle(1.0, 0.0, 2.0)
    assert spinning < 0.05
    assert gripping > 0.9
