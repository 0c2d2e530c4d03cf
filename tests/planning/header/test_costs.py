"""The generated C of the planner against the compiled library."""

from dataclasses import replace

import pytest
import torch

from host_kernels import HostKernels, needs_gcc
from offpiste.planning.costs.layers import Hazards
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.header.cost_text import plan_text
from offpiste.planning.header.costs import costs_by_kernels
from offpiste.planning.kernel import encode_map, fused_rollout
from planning.test_kernel import GEARED, KINDS, UNKNOWN, commands, ground, model, start
from planning.test_kernel_stray import NO_HAZARDS, PATH_ALONE, caution
from planning_maps import layers, situation

pytestmark = needs_gcc


def printed(dynamics, at, controls, weights, *, lanes):
    """Costs and states of the printed C, by one thread a sample or by four."""
    kernels = HostKernels(plan_text(dynamics, at.costs.table, at.caution, lanes=lanes))
    assert kernels.lanes == (4 if lanes else 1)
    states = torch.empty(controls.shape[1], 6, len(controls))
    codes = encode_map(at.ground, dynamics.encoder)
    return costs_by_kernels(kernels, dynamics, start(dynamics, at), at, weights, codes)(controls, states), states


@pytest.mark.parametrize(("kind", "vehicle"), KINDS)
def test_four_lanes_come_to_what_one_thread_does(kind, vehicle):
    dynamics, weights = model(kind, vehicle), CostWeights(lateral_limit=0.25, rollover=20.0)
    at = situation(ground(), hazards=Hazards(obstacle=50.0), state=(-3.0, 1, 0.3, 8, 0.2, 0.1))
    controls = commands(6)[:, :40]
    controls[4, 20:] = torch.nan
    (costs, states), (wanted, of_one) = (
        printed(dynamics, at, controls, weights, lanes=lanes) for lanes in (True, False)
    )
    torch.testing.assert_close(states, of_one, atol=1e-4, rtol=1e-5, equal_nan=True)
    torch.testing.assert_close(costs, wanted, atol=1e-3, rtol=1e-4, equal_nan=True)
    assert costs.isnan().tolist() == [False, False, False, False, True, False]


@pytest.mark.parametrize("place", [0.0, 300.0, 1e9, float("nan")], ids=["on the map", "off it", "far away", "nowhere"])
def test_four_lanes_read_the_ground_as_one_thread_does(place):
    at = situation(ground(), state=(place, 0, 1, 5, 0, 0))
    (costs, _), (wanted, _) = (
        printed(model("dc"), at, commands(3)[:, :10], CostWeights(lateral_limit=2.0), lanes=lanes)
        for lanes in (True, False)
    )
    torch.testing.assert_close(costs, wanted, atol=1e-3, rtol=1e-4, equal_nan=True)


def both(dynamics, at, controls, weights):
    """Costs and states of the printed C, and of the compiled library."""
    model_state, codes = start(dynamics, at), encode_map(at.ground, dynamics.encoder)
    kernels = HostKernels(plan_text(dynamics, at.costs.table, at.caution))
    states = torch.empty(controls.shape[1], 6, len(controls))
    costs = costs_by_kernels(kernels, dynamics, model_state, at, weights, codes)(controls, states)
    return (costs, states.permute(2, 0, 1)), fused_rollout(dynamics, model_state, controls, at, weights, codes)


@pytest.mark.parametrize(("kind", "vehicle"), KINDS)
def test_costs_and_states_equal_those_of_the_library(kind, vehicle):
    at = situation(ground(), hazards=Hazards(obstacle=50.0), state=(-3.0, 1, 0.3, 8, 0.2, 0.1))
    found, wanted = both(model(kind, vehicle), at, commands(70), CostWeights(lateral_limit=0.25, rollover=20.0))
    close = (found[1] - wanted[1]).abs().amax(dim=(1, 2)) < 2e-3
    assert close.float().mean() > 0.9  # at edges of cells rounding decides, and trajectories part
    difference = (found[0] - wanted[0]).abs()[close] / wanted[0].abs()[close]
    assert (difference < 0.01).float().mean() > 0.9
    assert difference.median() < 1e-4


def added_by_caution(costs_of, dynamics, at):
    """Return the cost of the path added by caution."""
    careful, plain = (costs_of(here) for here in (replace(at, caution=caution(dynamics)), at))
    return careful - plain


@pytest.mark.parametrize(
    ("kind", "vehicle", "lanes"), [(*KINDS[0], True), (*KINDS[1], False), (*KINDS[2], True), (*KINDS[3], False)]
)
def test_what_caution_adds_equals_what_the_library_adds(kind, vehicle, lanes):
    at = situation(ground(), hazards=NO_HAZARDS, state=(-3.0, 1, 0.3, 8, 0.2, 0.1))
    dynamics, controls = model(kind, vehicle), commands(9 if lanes else 70)[:, :45]
    model_state, codes = start(dynamics, at), encode_map(at.ground, dynamics.encoder)

    def fused(here):
        return fused_rollout(dynamics, model_state, controls, here, PATH_ALONE, codes)

    found = added_by_caution(lambda here: printed(dynamics, here, controls, PATH_ALONE, lanes=lanes)[0], dynamics, at)
    wanted = added_by_caution(lambda here: fused(here)[0], dynamics, at)
    states = printed(dynamics, at, controls, PATH_ALONE, lanes=lanes)[1].permute(2, 0, 1)
    close = (states - fused(at)[1]).abs().amax(dim=(1, 2)) < 2e-3
    assert close.float().mean() > 0.85  # at edges of cells rounding decides, and trajectories part
    assert (wanted > 0).all()
    apart = ((found - wanted).abs() / wanted)[close]
    assert apart.median() < 1e-3
    assert apart.max() < 0.02


@pytest.mark.parametrize("gear", [1.0, -1.0])
@pytest.mark.parametrize("place", [0.0, 300.0], ids=["on the map", "off it"])
def test_caution_on_even_ground_and_in_each_gear(place, gear):
    at = situation(layers(plane=(0.1, -0.2)), hazards=NO_HAZARDS, state=(place, 0, 1, 3, 0, 0))
    dynamics = model("b", GEARED)
    at = replace(at, gear=gear, caution=caution(dynamics))
    found, wanted = both(dynamics, at, commands(33, seed=2)[:, :40], PATH_ALONE)
    torch.testing.assert_close(found[0], wanted[0], atol=1e-2, rtol=2e-3)


@pytest.mark.parametrize("gear", [1.0, -1.0])
def test_a_held_gear(gear):
    at = replace(situation(layers(plane=(0.1, -0.2)), state=(0.0, 0, 0, 3 * gear, 0, 0)), gear=gear)
    found, wanted = both(model("b", GEARED), at, commands(40, seed=2)[:, :40], CostWeights(lateral_limit=2.0))
    torch.testing.assert_close(found[1], wanted[1], atol=1e-3, rtol=1e-4)
    torch.testing.assert_close(found[0], wanted[0], atol=1e-2, rtol=1e-2)


@pytest.mark.parametrize("ground", [layers(1, 20.0, plane=(0.1, 0.05)), layers(2, 20.0), UNKNOWN])
def test_maps_of_hardly_any_cells_or_without_known_ones(ground):
    found, wanted = both(model("dc"), situation(ground), commands(5), CostWeights(lateral_limit=2.0))
    torch.testing.assert_close(found[0], wanted[0], atol=1e-2, rtol=1e-3)


@pytest.mark.parametrize(
    "state", [(1e9, -1e9, 0, 5, 0, 0), (float("nan"), 0, 0, 5, 0, 0), (float("inf"), 0, 0, 5, 0, 0)]
)
def test_places_that_are_nowhere_are_read_within_bounds(state):
    found, wanted = both(model("dc"), situation(ground(), state=state), commands(33), CostWeights())
    assert torch.equal(found[0].isfinite(), wanted[0].isfinite())
