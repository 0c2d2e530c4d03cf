"""Added cost terms, a constant quantity and a map layer, in the kernel and in eager code."""

import pytest

from extending.outside import succeeded
from offpiste.core.errors import PlanningError
from offpiste.planning.costs.declaration import CostTerm, Parameter, check_term, cost_term, evaluate, reading_order
from offpiste.planning.costs.weights import CostWeights

PLAN = """
import numpy as np, torch
from offpiste import CostWeights
from offpiste.planning.costs.declaration import cost_term, quantity
from offpiste.planning.driving_cost import driving_costs, driving_terms
from offpiste.planning.kernel import encode_map, fused_costs, fused_rollout
from offpiste.planning.controls import CONTROL_LIMITS
from offpiste.planning.mppi import Settings, improve
from offpiste.core.state import Trajectory
from planning.test_kernel import commands, model, start
from planning_maps import layers, situation

@quantity
def crossing_speed():
    return 0.3

@cost_term("crossing", weight=1.0, unit="s/m^2")
def crossing(vy, crossing_speed, maximum, weight):
    return weight * maximum(abs(vy), crossing_speed)

ground = layers()
ground.roughness[:, 45:] = 0.05
at, dynamics, controls = situation(ground), model("parametric"), commands(33)
assert "roughness" in at.costs.names
plain, shaken = CostWeights(lateral_limit=2.0, shaking=0.0), CostWeights(lateral_limit=2.0, shaking=0.5)
assert CostWeights().shaking == 0.2
codes, model_state = encode_map(at.ground, None), start(dynamics, at)
costs, states = fused_rollout(dynamics, model_state, controls, at, shaken, codes)
eager = driving_costs(dynamics, model_state, at, shaken)(controls)
torch.testing.assert_close(costs, eager, rtol=1e-2, atol=1e-2)
without = fused_costs(dynamics, model_state, at, plain, codes)(controls)
terms = driving_terms(Trajectory(states, torch.zeros(*states.shape[:2], 4)), controls, at, shaken)
torch.testing.assert_close(costs - without, 0.02 * terms["shaking"].sum(dim=1), rtol=1e-2, atol=1e-2)
assert (terms["shaking"] > 0).any() and (terms["shaking"] == 0).any()

settings = Settings(CONTROL_LIMITS, (0.3, 0.1, 0.3), samples=64)
plan = improve(torch.zeros(60, 3), fused_costs(dynamics, model_state, at, shaken, codes), settings,
               torch.Generator().manual_seed(0), previous=torch.zeros(3))
assert plan.controls.isfinite().all()
"""


def test_added_terms_are_planned_with_by_kernel_and_eager_model_alike():
    succeeded("-c", PLAN, extension="roughness_cost")


def test_a_name_that_nothing_provides_is_refused():
    def swaying(sway, weight):
        return weight * sway

    with pytest.raises(PlanningError, match="'swaying' reads 'sway', which nothing provides"):
        evaluate(swaying, {"weight": 1.0})
    with pytest.raises(PlanningError, match="'swaying' reads 'sway', which nothing provides"):
        reading_order([swaying], ["weight"])


def test_declarations_that_contradict_themselves_are_refused():
    def unweighted(vx):
        return vx

    def mixed(control, vx, weight):
        return weight * control * vx

    def single(control, weight):
        return weight * control

    for function, message in ((unweighted, "go together"), (mixed, "one control and"), (single, "for each")):
        with pytest.raises(PlanningError, match=message):
            check_term(CostTerm("added", function, Parameter(1.0, "1/s")))
    with pytest.raises(PlanningError, match="two cost terms called 'path'"):
        cost_term("path", weight=1.0, unit="1/s")(lambda weight: weight)


def test_unknown_weights_are_refused_with_those_that_there_are():
    with pytest.raises(PlanningError, match=r"no cost weight 'pth'.*path \[1/s per m\^2\]"):
        CostWeights(pth=1.0)
    with pytest.raises(PlanningError, match="effort"):
        CostWeights(effort=1.0)
    assert CostWeights(path=5.0) == CostWeights(path=5.0) != CostWeights()
    assert CostWeights(path=5.0).values()["speed"] == CostWeights().speed == 1.0
