import numpy as np
import pytest

from offpiste.simulation.driver.speed_control import SpeedControl
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
