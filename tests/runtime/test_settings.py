"""Settings that cannot be met, and plans within the limits of commands."""

import numpy as np
import pytest

from offpiste.core.errors import PlanningError
from offpiste.planning.caution import WorstShare
from offpiste.rig.outputs import CommandLimits
from offpiste.runtime.settings import RuntimeSettings, keeping_to
from runtime.stream import feature_model, settings, straight_drive


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"latency": 0.05}, r"latency of 0\.05"),
        *(({"plan_rate": rate}, "invalid plan rate") for rate in (0.0, 1.0, 15.0)),
        ({"dynamics": feature_model()}, "reads features, but has no extractor"),
        ({"risk": WorstShare()}, "needs a spread, which the run does not have.*offpiste calibrate"),
        ({"device": "coda"}, "no GPU 'coda' for planning"),
        ({"device": "cuda:7"}, "no GPU 'cuda:7' for planning"),
    ],
)
def test_settings_that_cannot_be_met_are_refused_in_one_line(changed, said):
    with pytest.raises(PlanningError, match=said) as one:
        straight_drive(**changed)
    assert "\n" not in str(one.value)


def test_limits_of_commands_bound_pedal_wheel_and_speed_of_plans():
    assert keeping_to(RuntimeSettings(), CommandLimits()) == RuntimeSettings()
    limits = CommandLimits(throttle=0.4, brake=0.7, steer=0.6, brake_rate=2.0, steer_rate=1.0, speed=4.0)
    narrowed = keeping_to(RuntimeSettings(), limits)
    within = narrowed.sampling.limits
    assert (within.low, within.high, within.rate) == ((-0.7, -0.6), (0.4, 0.6), (2.0, 1.0))
    assert narrowed.speed == 4.0
    assert keeping_to(narrowed, CommandLimits(speed=9.0)) == narrowed, "never wider than before"


def test_plans_respect_the_limits_of_commands():
    fast, steering = [], []
    for limits in (CommandLimits(), CommandLimits(throttle=0.3, steer=0.05, speed=2.0)):
        narrowed = keeping_to(settings(), limits)
        stream = straight_drive(sampling=narrowed.sampling, speed=narrowed.speed)
        controls = np.array([each.command for each in stream.run(3.0).controls])
        assert controls[:, 0].max() <= limits.throttle + 1e-6
        assert abs(controls[:, 2]).max() <= limits.steer + 1e-6
        fast.append(np.mean([each.state[-1, 3] for each in stream.runtime.predictions[-4:]]))
        steering.append(abs(controls[:, 2]).max())
    assert fast[1] < 2.5 < fast[0], "the course wants 5 m/s"
    assert steering[0] > 0.05
