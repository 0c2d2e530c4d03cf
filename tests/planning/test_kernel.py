"""The fused kernel against the eager model and cost, in every branch of the map and of the cost."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from factories import COMMANDED, VEHICLE, coded, unsettled
from offpiste.core.conventions import ACTUATORS
from offpiste.core.state import ModelState
from offpiste.dynamics import Hybrid, Parametric, rollout
from offpiste.dynamics.feature_encoder import Compressor, Identity
from offpiste.mapping.terrain_sampler import MapTerrain, as_codes
from offpiste.planning.controls import CONTROL_LIMITS, complete
from offpiste.planning.costs.layers import Hazards
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.driving_cost import driving_costs, driving_terms, situation_terrain, spread_model_state
from offpiste.planning.kernel import coded_map, encode_map, fused_costs, fused_rollout, kernel_model_state
from offpiste.planning.mppi import Settings, improve
from offpiste.planning.noise import coloured
from planning_maps import layers, situation

STEPS = 60
KINDS = [("parametric", COMMANDED), ("b", VEHICLE), ("dc", VEHICLE), ("df", COMMANDED)]
"""Models of vehicles with and without measured actuators."""

GEARED = replace(VEHICLE, control=(*VEHICLE.control, "gear"))


UNKNOWN = layers(
    known=np.zeros((81, 81), bool), features=np.full((81, 81, 2), np.nan, np.float32),
    normal=np.full((81, 81, 3), np.nan, np.float32),
)  # fmt: skip


def ground(seed=0):
    """Waves, holes in the map, missing features, obstacles, rough and steep places; smaller than what is driven."""
    draw = np.random.default_rng(seed)
    flat = layers(61, 0.5)
    x, y = np.meshgrid(flat.origin[0] + 0.5 * np.arange(61), flat.origin[1] + 0.5 * np.arange(61))
    normal = np.stack((-0.3 * np.cos(x / 3), -0.2 * np.sin(y / 4), np.ones_like(x)), axis=-1)
    known = draw.random((61, 61)) > 0.02
    normal[~known] = np.nan
    features = draw.normal(size=(61, 61, 2)).astype(np.float32)
    valid = draw.random((61, 61)) > 0.2
    features[~valid] = np.nan
    return layers(
        61, 0.5,
        normal=(normal / np.linalg.norm(normal, axis=-1, keepdims=True)).astype(np.float32),
        slope=(0.6 * draw.random((61, 61))).astype(np.float32),
        roughness=(0.2 * draw.random((61, 61))).astype(np.float32),
        obstacle_height=(draw.random((61, 61)) > 0.995).astype(np.float32),
        features=features, known=known, valid=valid,
    )  # fmt: skip


def model(kind, vehicle=COMMANDED):
    torch.manual_seed(0)
    made = {
        "parametric": Parametric(vehicle),
        "b": Hybrid(vehicle),
        "dc": coded(vehicle, 3),
        "dc of five numbers": Hybrid(vehicle, encoder=Compressor(2, size=5)),
        "df": Hybrid(vehicle, encoder=Identity(2)),
    }[kind]
    if isinstance(made, Hybrid):
        torch.nn.init.normal_(made.compensator.output[-1].weight, std=0.1)
        # Speed forwards, sideways and of yaw, which samples leave and come back to.
        made.compensator.low[:3] = torch.tensor([2.0, -0.5, -0.4])
        made.compensator.high[:3] = torch.tensor([7.5, 0.5, 0.4])
    return unsettled(made, scale=0.05).requires_grad_(False)


def start(dynamics, at):
    actuators = torch.tensor([[0.1, 0.05, 0.0, 1.5]])
    present = torch.tensor([name in dynamics.vehicle.actuators for name in ACTUATORS])
    actuators = torch.where(present, actuators, torch.nan)
    return ModelState(at.state[None], actuators, torch.zeros(1, dynamics.recurrent_size))


def commands(samples, seed=0):
    noise = coloured((samples, STEPS, 3), torch.Generator().manual_seed(seed))
    return (noise * torch.tensor([0.4, 0.2, 0.6]) + torch.tensor([0.4, 0.0, 0.0])).clamp(-1, 1)


def both(dynamics, at, controls, weights):
    """Costs, states: eager, fused; and the eager terms."""
    encoder = getattr(dynamics, "encoder", None)
    model_state = start(dynamics, at)
    source = situation_terrain(at, len(controls), encoder)
    completed = complete(dynamics.vehicle, controls, at.gear)
    trajectory = rollout(dynamics, spread_model_state(model_state, len(controls)), completed, source)
    eager = driving_costs(dynamics, model_state, at, weights, encoder)(controls), trajectory.state
    fused = fused_rollout(dynamics, model_state, controls, at, weights, encode_map(at.ground, encoder))
    return eager, fused, driving_terms(trajectory, controls, at, weights)


@pytest.mark.parametrize(("kind", "vehicle"), [*KINDS, ("dc", COMMANDED), ("dc of five numbers", VEHICLE)])
def test_costs_and_states_equal_the_eager_ones(kind, vehicle):
    at = situation(ground(), hazards=Hazards(obstacle=50.0), state=(-3.0, 1, 0.3, 8, 0.2, 0.1))
    weights = CostWeights(lateral_limit=0.25, rollover=20.0)
    eager, fused, terms = both(model(kind, vehicle), at, commands(70), weights)
    for name, term in terms.items():
        assert (term > 0).any(), name
    close = (fused[1] - eager[1]).abs().amax(dim=(1, 2)) < 2e-3
    assert close.float().mean() > 0.9  # at edges of cells rounding decides, and trajectories part
    torch.testing.assert_close(fused[1][close], eager[1][close], atol=2e-3, rtol=1e-4)
    difference = (fused[0] - eager[0]).abs()[close]
    assert (difference < 0.01 * eager[0].abs()[close] + 0.05).float().mean() > 0.9
    assert difference.median() < 1e-3 * eager[0].median()


@pytest.mark.parametrize("place", [0.0, 300.0], ids=["on the map", "off it"])
def test_on_even_ground_every_sample_agrees(place):
    at = situation(layers(plane=(0.1, -0.2)), state=(place, 0, 1, 5, 0, 0))
    controls = commands(33, seed=2)
    eager, fused, _ = both(model("dc"), at, controls, CostWeights(lateral_limit=2.0))
    torch.testing.assert_close(fused[1], eager[1], atol=1e-3, rtol=1e-4)
    torch.testing.assert_close(fused[0], eager[0], atol=1e-2, rtol=1e-2)


@pytest.mark.parametrize(("kind", "gear"), [("parametric", 0.0), ("b", 1.0), ("b", -1.0)])
def test_a_held_gear_completes_the_controls_of_models_that_know_one(kind, gear):
    at = replace(situation(layers(plane=(0.1, -0.2)), state=(0.0, 0, 0, 3 * gear, 0, 0)), gear=gear)
    dynamics, controls = model(kind, GEARED), commands(40, seed=2)[:, :40]
    eager, fused, _ = both(dynamics, at, controls, CostWeights(lateral_limit=2.0))
    torch.testing.assert_close(fused[1], eager[1], atol=1e-3, rtol=1e-4)
    torch.testing.assert_close(fused[0], eager[0], atol=1e-2, rtol=1e-2)
    geared = torch.cat((controls, torch.full_like(controls[..., :1], gear)), dim=-1)
    forward = replace(at, gear=1.0)
    codes = encode_map(at.ground, None)
    again = fused_rollout(dynamics, start(dynamics, at), geared, forward, CostWeights(lateral_limit=2.0), codes)
    assert torch.equal(again[0], fused[0])
    other = fused_rollout(dynamics, start(dynamics, at), controls, replace(at, gear=gear - 1), CostWeights(), codes)
    assert other[1][:, -1, 3].mean() < fused[1][:, -1, 3].mean() - 0.1


def test_a_model_without_a_gear_does_not_mind_one():
    at, dynamics, controls = situation(), model("b"), commands(8)
    codes = encode_map(at.ground, None)
    one, other = (
        fused_rollout(dynamics, start(dynamics, at), controls, replace(at, gear=gear), CostWeights(), codes)[1]
        for gear in (1.0, -1.0)
    )
    assert torch.equal(one, other)


def test_backwards_most_samples_agree():
    # Random weights make reverse unstable: there the eager float32 is as far from float64 as the kernel is.
    at, controls = situation(layers(), state=(0.0, 0, 2, -1, 0, 0)), commands(33, seed=2)[:, :30]
    eager, fused, _ = both(model("dc"), at, controls, CostWeights(lateral_limit=2.0))
    difference = (fused[1] - eager[1]).abs().amax(dim=(1, 2))
    assert difference.median() < 1e-4
    assert (difference < 1e-3).float().mean() > 0.9


@pytest.mark.parametrize(("kind", "vehicle"), KINDS)
def test_the_model_state_after_controls_equals_that_of_eager_steps(kind, vehicle):
    at, dynamics = situation(ground(), state=(-3.0, 1, 0.3, 8, 0.2, 0.1)), model(kind, vehicle)
    controls = commands(1)[0]
    encoder, model_state = getattr(dynamics, "encoder", None), start(dynamics, at)
    found = kernel_model_state(dynamics, model_state, controls[:8], at, encode_map(at.ground, encoder))
    source = MapTerrain(at.ground, torch.zeros(1, dtype=torch.long), at.offset[None], at.wheels, encoder)
    for t, control in enumerate(controls[:8]):
        model_state = dynamics.step(model_state, control[None], source.at(t, model_state.state))
    for part in ("state", "actuators", "recurrent"):
        torch.testing.assert_close(
            getattr(found, part), getattr(model_state, part), atol=1e-4, rtol=1e-4, equal_nan=True
        )


def test_a_map_that_holds_codes_needs_no_encoder():
    at, dynamics, controls = situation(ground()), model("dc"), commands(8)
    encoder, model_state = dynamics.encoder, start(dynamics, at)
    codes, missing = encode_map(at.ground, encoder)
    # As a map gives them: NaN where nothing was seen.
    seen = at.ground.features[0].isfinite().all(-1, keepdim=True)
    coded_at = replace(at, ground=replace(at.ground, features=codes.where(seen, torch.nan)[None]))
    again = coded_map(coded_at.ground.features[0], encoder)
    torch.testing.assert_close(again, (codes, missing), rtol=0, atol=0)
    eager = driving_costs(dynamics, model_state, coded_at, CostWeights(), as_codes(missing))(controls)
    torch.testing.assert_close(eager, driving_costs(dynamics, model_state, at, CostWeights(), encoder)(controls))
    with pytest.raises(ValueError, match="codes of length 2; the encoder's have length 3"):
        coded_map(at.ground.features[0], encoder)


def test_cells_are_encoded_as_one_by_one():
    torch.manual_seed(0)
    at, encoder = situation(ground()), Compressor(2).requires_grad_(False)
    codes, _ = encode_map(at.ground, encoder)
    features = at.ground.features[0]
    for row, column in ((0, 0), (30, 31), (60, 60), *features.isnan().any(-1).nonzero()[:2].tolist()):
        cell = features[row, column][None]
        torch.testing.assert_close(codes[row, column], encoder(cell, cell.isfinite().all(-1))[0])


@pytest.mark.parametrize("ground", [layers(1, 20.0, plane=(0.1, 0.05)), layers(2, 20.0), UNKNOWN])
def test_maps_of_hardly_any_cells_or_without_known_ones(ground):
    eager, fused, _ = both(model("dc"), situation(ground), commands(5), CostWeights(lateral_limit=2.0))
    torch.testing.assert_close(fused[1], eager[1], atol=1e-3, rtol=1e-4)
    torch.testing.assert_close(fused[0], eager[0], atol=1e-2, rtol=1e-2)


@pytest.mark.parametrize("samples", [1, 32, 65])
def test_any_number_of_samples_costs_what_each_costs_alone(samples):
    at, dynamics = situation(ground()), model("dc")
    cost_of = fused_costs(dynamics, start(dynamics, at), at, CostWeights(), encode_map(at.ground, dynamics.encoder))
    controls = commands(samples)
    together = cost_of(controls)
    assert together.shape == (samples,)
    for k in {0, samples // 2, samples - 1}:
        assert torch.equal(cost_of(controls[k : k + 1])[0], together[k])


@pytest.mark.parametrize(("steps", "geared"), [(1, False), (2, True), (3, False)])
def test_the_first_steps_are_the_same_in_a_shorter_plan(steps, geared):
    at, dynamics = situation(ground()), model("b", GEARED if geared else COMMANDED)
    controls = commands(33)
    controls = torch.cat((controls, torch.ones(33, STEPS, 1)), dim=2) if geared else controls
    given = start(dynamics, at), at, CostWeights(), encode_map(at.ground, None)
    whole, part = (
        fused_rollout(dynamics, given[0], c.contiguous(), *given[1:])[1] for c in (controls, controls[:, :steps])
    )
    assert torch.equal(part, whole[:, :steps])


def test_a_plan_is_the_same_on_any_number_of_threads():
    at, dynamics = situation(ground()), model("dc")
    cost_of = fused_costs(dynamics, start(dynamics, at), at, CostWeights(), encode_map(at.ground, dynamics.encoder))
    settings, plans, threads = Settings(CONTROL_LIMITS, (0.3, 0.1, 0.3), samples=100), [], torch.get_num_threads()
    for count in (1, 2):
        torch.set_num_threads(count)
        draw = torch.Generator().manual_seed(0)
        plans.append(improve(torch.zeros(STEPS, 3), cost_of, settings, draw, previous=torch.zeros(3)))
    torch.set_num_threads(threads)
    assert torch.equal(plans[0].costs, plans[1].costs)
    assert torch.equal(plans[0].controls, plans[1].controls)


def test_a_sample_with_nan_costs_nan_and_others_do_not():
    at, dynamics = situation(ground()), model("b")
    cost_of = fused_costs(dynamics, start(dynamics, at), at, CostWeights(), encode_map(at.ground, None))
    controls = commands(40)
    controls[7, 30] = torch.nan
    assert cost_of(controls).isnan().nonzero().flatten().tolist() == [7]


def test_inputs_that_the_kernel_does_not_support_are_refused():
    at, dynamics = situation(ground()), model("dc")
    model_state, codes = start(dynamics, at), encode_map(at.ground, dynamics.encoder)
    with pytest.raises(ValueError, match="codes have length 0"):
        fused_costs(dynamics, model_state, at, CostWeights(), encode_map(at.ground, None))
    with pytest.raises(ValueError, match="the start is"):
        fused_costs(dynamics, spread_model_state(model_state, 2), at, CostWeights(), codes)
    with pytest.raises(ValueError, match="float64"):
        fused_costs(dynamics, model_state, at, CostWeights(), codes)(commands(3).double())
    with pytest.raises(ValueError, match="no kernel"):
        fused_costs(
            dynamics.double(), ModelState(*(p.double() for p in vars(model_state).values())), at, CostWeights(), codes
        )


def test_places_off_the_map_end_no_process():
    dynamics = model("dc")
    for x, y in ((14.9, 14.9), (-15.2, 0), (1e9, -1e9), (torch.nan, 0), (torch.inf, 0)):
        at = situation(ground(), state=(x, y, 0.7, 9, 0, 0))
        codes = encode_map(at.ground, dynamics.encoder)
        assert fused_costs(dynamics, start(dynamics, at), at, CostWeights(), codes)(commands(33)).shape == (33,)


def test_the_eager_cost_keeps_the_frame_of_the_situation():
    at, dynamics = situation(layers(), state=(0.0, 0, 0, 5, 0, 0)), model("b")
    moved = replace(
        at, state=at.state - torch.tensor([5.0, 7, 0, 0, 0, 0]), offset=torch.tensor([5.0, 7.0], dtype=torch.float64)
    )
    costs = [
        fused_costs(dynamics, start(dynamics, here), here, CostWeights(), encode_map(here.ground, None))(commands(8))
        for here in (at, moved)
    ]
    torch.testing.assert_close(costs[0], costs[1], rtol=1e-2, atol=1e-2)
