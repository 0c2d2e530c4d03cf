"""Plans by a declared risk, errors of the planner, and garbage."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from offpiste.core.errors import PlanningError
from offpiste.planning.caution import AddSpread, AsPredicted
from offpiste.runtime.plan_maker import PlanImprover
from offpiste.uncertainty.spread import MOTION, Spread, inputs_of
from runtime.stream import parametric, straight_drive


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
