"""Margins for position errors in the fused kernel against the reference in torch."""

from dataclasses import replace

import pytest
import torch

from offpiste.planning.caution import Caution
from offpiste.planning.costs.layers import Hazards
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.header.costs import packed_stray
from offpiste.planning.kernel import encode_map, fused_costs
from offpiste.uncertainty.spread import Spread, inputs_of
from planning.test_kernel import GEARED, KINDS, both, commands, ground, model, start
from planning_maps import layers, situation

PATH_ALONE = CostWeights(path=1.0, speed=0.0, overspeed=0.0, rollover=0.0, effort=(0.0, 0.0, 0.0), jerk=(0.0, 0.0, 0.0))
NO_HAZARDS = Hazards(obstacle=0.0, steep=0.0, unknown=0.0)


def caution(dynamics, reach=1.7, seed=0):
    """A spread with random weights, which reads all that it can."""
    torch.manual_seed(seed)
    spread = Spread(inputs_of(dynamics.vehicle, dynamics.codes))
    for layer in (spread.layers[0], spread.layers[2]):
        torch.nn.init.normal_(layer.weight, std=0.4)
        torch.nn.init.normal_(layer.bias, std=0.5)
    spread.start.data.copy_(torch.tensor([-1.0, 0.5]))
    spread.mean.normal_()
    spread.deviation.uniform_(0.5, 3)
    spread.factor.fill_(0.8)
    return Caution(spread.requires_grad_(False), reach)


def compared(kind, vehicle, at, controls):
    """Costs of the path with caution and without, eager and fused, where trajectories agree."""
    dynamics = model(kind, vehicle)
    careful = replace(at, caution=caution(dynamics))
    (eager, _), (fused, states), _ = both(dynamics, careful, controls, PATH_ALONE)
    (eager_plain, eager_states), (fused_plain, _), _ = both(dynamics, at, controls, PATH_ALONE)
    close = (states - eager_states).abs().amax(dim=(1, 2)) < 2e-3
    return (eager - eager_plain)[close], (fused - fused_plain)[close], close


@pytest.mark.parametrize(
    ("kind", "vehicle", "steps"), [(*KINDS[0], 60), (*KINDS[1], 45), (*KINDS[2], 60), (*KINDS[2], 3), (*KINDS[3], 45)]
)
def test_what_caution_adds_equals_what_the_reference_adds(kind, vehicle, steps):
    at = situation(ground(), hazards=NO_HAZARDS, state=(-3.0, 1, 0.3, 8, 0.2, 0.1))
    eager, fused, close = compared(kind, vehicle, at, commands(70)[:, :steps])
    assert close.float().mean() > 0.9  # at edges of cells rounding decides, and trajectories part
    assert (eager > 0).all()
    apart = (fused - eager).abs() / eager
    assert apart.median() < 1e-3
    assert (apart < 0.02).float().mean() > 0.95


@pytest.mark.parametrize("gear", [1.0, -1.0])
@pytest.mark.parametrize("state", [(0.0, 0, 0, 3, 0, 0), (300.0, 0, 1, 3, 0, 0)], ids=["on the map", "off it"])
def test_on_even_ground_every_sample_agrees(gear, state):
    at = replace(situation(layers(plane=(0.1, -0.2)), hazards=NO_HAZARDS, state=state), gear=gear)
    eager, fused, close = compared("b", GEARED, at, commands(40, seed=2)[:, :40])
    assert close.all()
    torch.testing.assert_close(fused, eager, atol=1e-3, rtol=2e-3)


def test_no_reach_costs_nothing():
    at, dynamics = situation(ground(), state=(-3.0, 1, 0.3, 8, 0.2, 0.1)), model("dc")
    codes, controls = encode_map(at.ground, dynamics.encoder), commands(40)
    plain, none = (
        fused_costs(dynamics, start(dynamics, at), here, CostWeights(), codes)(controls)
        for here in (at, replace(at, caution=caution(dynamics, reach=0.0)))
    )
    assert torch.equal(plain, none)


def test_an_unsure_plan_of_nan_costs_nan_and_others_do_not():
    at, dynamics = situation(ground()), model("b")
    at = replace(at, caution=caution(dynamics))
    cost_of = fused_costs(dynamics, start(dynamics, at), at, CostWeights(), encode_map(at.ground, None))
    controls = commands(40)
    controls[7, 30] = torch.nan
    assert cost_of(controls).isnan().nonzero().flatten().tolist() == [7]


def test_a_spread_of_a_model_with_other_inputs_is_refused():
    dynamics, at = model("b"), situation(ground())
    at = replace(at, caution=caution(model("dc")))
    expected = r"the spread has \d+ inputs; this model's has 9"
    with pytest.raises(ValueError, match=expected):
        fused_costs(dynamics, start(dynamics, at), at, CostWeights(), encode_map(at.ground, None))
    with pytest.raises(ValueError, match=expected):
        packed_stray(dynamics, at.caution)
