"""Courses that part: the plan along the cheaper way acts."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from offpiste.planning import mppi
from offpiste.runtime.runtime import Runtime
from runtime.stream import WHEELS, Stream, course, parametric, sensor_setup, settings

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
