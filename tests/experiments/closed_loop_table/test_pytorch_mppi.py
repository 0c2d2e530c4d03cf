"""Plans by pytorch_mppi: the same cost as offpiste's, and a plan that costs less than the one before."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from experiments.closed_loop_table import pytorch_mppi_planner
from experiments.closed_loop_table.pytorch_mppi_planner import PytorchMppi, check_installed, stepwise
from offpiste.errors import OffpisteError, PlanningError
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.pedal import controls_of, pedals_of, with_pedal
from offpiste.runtime.prediction import coded_area, costs_from
from offpiste.state import ModelState
from planning_maps import layers, situation
from runtime.stream import feature_model, parametric, settings

SAMPLES, STEPS = 24, 60


def problem(model):
    """2 m beside the path, at 4 m/s where 5 are wanted."""
    torch.manual_seed(0)
    codes = len(model.encoder.missing()) if model.encoder else 0
    held = np.random.default_rng(0).normal(size=(81, 81, codes)).astype(np.float32)
    area = coded_area(layers(features=held), model.encoder)
    at = replace(situation(state=(-5.0, 2.0, 0.0, 4.0, 0.0, 0.0)), ground=area.stack)
    size = sum(part.hidden for part in (model.compensator, model.actuators)) if model.encoder else 0
    start = ModelState(at.state[None], torch.full((1, 4), torch.nan), *torch.zeros(2, 1, size))
    few = settings(weights=CostWeights(path=5.0))
    sampling = replace(few.sampling, samples=SAMPLES, temperature=0.5, iterations=2)
    return area, at, start, replace(few, sampling=sampling)


def holding():
    """A model that keeps the codes of the start, and that codes move."""
    model = feature_model()
    with torch.no_grad():
        for weights in model.compensator.parameters():
            weights += torch.randn_like(weights)
    model.holds_codes = True
    return model


@pytest.mark.parametrize("made", [parametric, feature_model, holding])
@torch.no_grad()
def test_stepped_costs_are_those_of_rollouts(made):
    model = made()
    area, at, start, given = problem(model)
    pedal_and_steer = torch.rand(SAMPLES, STEPS, 2) * 2 - 1
    reference = with_pedal(costs_from(model, start, area, at, given.weights))(pedal_and_steer)
    dynamics, cost = stepwise(model, area, at, given, SAMPLES)
    state = torch.cat((start.pack()[0], at.state[3:5], at.control, at.control)).expand(SAMPLES, -1)
    total = torch.zeros(SAMPLES)
    for control in pedal_and_steer.unbind(dim=1):
        state = dynamics(state, control)
        total += cost(state, control)
    torch.testing.assert_close(total, reference.to(total), rtol=2e-3, atol=1e-2)
    assert reference.std() > 1, "the samples differ"


@torch.no_grad()
def test_a_plan_costs_less_than_the_one_before_and_a_seed_gives_the_same():
    pytest.importorskip("pytorch_mppi")
    model = parametric()
    area, at, start, given = problem(model)
    before, plans = controls_of(torch.zeros(STEPS, 2)), []
    for seed in (0, 0, 1):
        state = torch.get_rng_state()
        planner = PytorchMppi(model, given, seed)
        plans.append([planner.improve(before, start, area, at).controls for _ in range(2)])
        assert torch.equal(state, torch.get_rng_state()), "torch's own generator stays as it was"
    assert torch.equal(plans[0][1], plans[1][1])
    assert not torch.equal(plans[0][0], plans[0][1]), "the next plan has other samples"
    assert not torch.equal(plans[0][0], plans[2][0])
    cost_of = with_pedal(costs_from(model, start, area, at, given.weights))
    first, improved = cost_of(torch.stack((pedals_of(before), plans[0][0])))
    assert improved < first
    assert plans[0][0].abs().max() <= 1


@torch.no_grad()
def test_without_costs_a_plan_stays(monkeypatch):
    pytest.importorskip("pytorch_mppi")
    free = {"nothing": torch.zeros(SAMPLES)}
    monkeypatch.setattr(pytorch_mppi_planner, "terms_after", lambda *_: free)
    model = parametric()
    area, at, start, given = problem(model)
    at, wanted = replace(at, control=torch.tensor([0.4, 0.0, 0.0])), torch.tensor([0.4, 0.0])
    before = controls_of(wanted.repeat(STEPS, 1))
    planner, plans = PytorchMppi(model, given, 0), []
    for _ in range(6):
        plans.append(planner.improve(before, start, area, at).controls.mean(dim=0))
    torch.testing.assert_close(torch.stack(plans).mean(dim=0), wanted, atol=0.05, rtol=0)


@torch.no_grad()
def test_costs_that_are_not_finite_make_no_plan():
    pytest.importorskip("pytorch_mppi")
    model = parametric()
    area, at, start, given = problem(model)
    lost = replace(start, state=torch.full((1, 6), torch.nan))
    with pytest.raises(PlanningError, match="not finite"):
        PytorchMppi(model, given, 0).improve(torch.zeros(STEPS, 3), lost, area, at)


def test_without_the_package_it_is_one_line(monkeypatch):
    monkeypatch.setattr(pytorch_mppi_planner, "is_installed", lambda module: False)
    with pytest.raises(OffpisteError, match="--planners: pytorch_mppi is not installed; pip install pytorch-mppi"):
        check_installed()
