"""Settings, limits and risks of plans, courses that part, errors of the planner, and garbage."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from offpiste.core.errors import PlanningError
from offpiste.planning import mppi
from offpiste.planning.caution import AddSpread, AsPredicted, WorstShare
from offpiste.rig.outputs import CommandLimits
from offpiste.runtime.plan_maker import PlanImprover
from offpiste.runtime.runtime import Runtime
from offpiste.runtime.settings import RuntimeSettings, keeping_to
from offpiste.uncertainty.spread import MOTION, Spread, inputs_of
from runtime.stream import WHEELS, Stream, course, feature_model, parametric, sensor_setup, settings, straight_drive


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


def unsure_when_fast():
    """A spread that grows with the speed alone."""
    vehicle = parametric().vehicle
    spread = Spread(inputs_of(vehicle, 0), hidden=4)
    with torch.no_grad():
        for layer in (spread.layers[0], spread.layers[2]):
            layer.weight.zero_()
            layer.bias.zero_()
        spread.layers[0].weight[0, MOTION.index("speed")] = 0.2
        spread.layers[2].weight[:, 0] = 4.0
        spread.layers[2].bias.fill_(-3.0)
    return spread.requires_grad_(False)


def test_plans_are_slower_where_fast_ones_are_unsure():
    ends = {}
    for risk in (AsPredicted(), AddSpread(2.0)):
        stream = straight_drive(spread=unsure_when_fast(), risk=risk).run(1.0)
        ends[risk.kind] = np.mean([p.state[-1, 3] for p in stream.runtime.predictions[-4:]])
    assert ends["spread"] < ends["none"] - 0.5


def test_an_error_of_the_planner_ends_the_run(monkeypatch):
    stream = straight_drive()

    def refuses(*_, **__):
        raise PlanningError("the GPU computes something else")

    monkeypatch.setattr(PlanImprover, "improve", refuses)
    with pytest.raises(PlanningError, match="something else"):
        stream.run(1.5)


def test_plans_leave_nothing_to_garbage_collection():
    """In a process without the import hook of these tests, which makes some."""
    code = """if True:
        import gc
        from runtime.stream import straight_drive
        stream = straight_drive().run(1.0)
        gc.collect()
        gc.disable()
        plans = len(stream.runtime.predictions)
        stream.run(1.0)
        gc.set_debug(gc.DEBUG_SAVEALL)
        gc.collect()
        print(len(stream.runtime.predictions) > plans, len(gc.garbage), {type(each).__name__ for each in gc.garbage})
    """
    paths = (str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", ""))
    there = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=there).stdout
    assert said == "True 0 set()\n"


LINE = course()


def parted(apart, begin=20.0):
    """A straight course whose alternative lies to the left, from a distance on."""
    away = apart * np.clip((LINE.path[:, 0] - begin) / 10.0, 0.0, 1.0)
    return replace(LINE, alternative=LINE.path + np.stack((np.zeros_like(away), away), axis=1))


class Priced:
    """Plans of a fixed steering for each way; what they cost is given."""

    prices = (9.0, 1.0)

    def __init__(self, dynamics, chosen, seed):
        self.begun = []

    def improve(self, controls, model_state, area, at):
        lane = at.costs.at(torch.tensor([[50.0, 0.0]]), torch.zeros(2, dtype=torch.float64))
        number = int(lane[0, at.costs.names.index("distance")] > 1.0)
        self.begun.append((number, float(controls[0, 2])))
        plan = torch.tensor([0.0, (-0.2, 0.3)[number]]).expand(len(controls), 2).clone()
        return mppi.Plan(plan, torch.full((4,), self.prices[number]).double(), torch.full((4,), 0.25).double())


@pytest.mark.parametrize("cheaper", [0, 1])
def test_the_clearly_cheaper_plan_acts_and_each_way_continues_its_own(cheaper, monkeypatch):
    monkeypatch.setattr(Priced, "prices", (1.0, 9.0) if cheaper == 0 else (9.0, 1.0))
    monkeypatch.setattr("offpiste.runtime.plan_maker.PlanImprover", Priced)
    runtime = Runtime(parametric(), sensor_setup(), WHEELS, parted(8.0), settings())
    stream = Stream(runtime)
    assert stream.run(0.6).controls[-1].command[2] == pytest.approx((-0.2, 0.3)[cheaper])
    later = runtime._maker._improver.begun[2:]
    assert {number for number, _ in later} == {0, 1}
    assert all(began == pytest.approx((-0.2, 0.3)[number]) for number, began in later)
    monkeypatch.setattr(Priced, "prices", (1.0, 0.5) if cheaper == 0 else (0.5, 1.0))
    assert stream.run(0.6).controls[-1].command[2] == pytest.approx((-0.2, 0.3)[cheaper]), (
        "cheaper by less than the temperature"
    )
