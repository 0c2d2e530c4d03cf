"""Warming up: a plan is made for every kind of model, nothing of it stays, and what forbids a plan is said."""

import pytest
import torch

from offpiste.core.errors import PlanningError
from offpiste.runtime.perception import SensorSetup
from offpiste.runtime.runtime import Runtime
from offpiste.runtime.warm_up import warm_up
from runtime.stream import WHEELS, feature_model, parametric, sensor_setup, settings


@pytest.mark.parametrize(("make", "with_camera"), [(parametric, False), (feature_model, True)])
def test_it_plans_with_any_model(monkeypatch, make, with_camera):
    made, plan = [], Runtime._plan

    def keep(self, *given):
        plan(self, *given)
        made.append(self)

    monkeypatch.setattr(Runtime, "_plan", keep)
    model = make()
    before = {name: weights.clone() for name, weights in model.state_dict().items()}
    warm_up(model, sensor_setup(with_camera=with_camera), WHEELS, settings())
    assert made
    assert made[0].predictions
    assert not made[0].failures
    assert made[0].dropped == {}
    assert all(torch.equal(weights, before[name]) for name, weights in model.state_dict().items())


def test_without_a_scan_there_is_no_plan():
    with pytest.raises(PlanningError, match=r"no plan was made on flat ground: .*; change the settings"):
        warm_up(parametric(), SensorSetup({}), WHEELS, settings())
