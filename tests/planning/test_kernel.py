"""Plans by the compiled library, and by C printed for GPUs and compiled here, against the eager model and cost."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from factories import COMMANDED, VEHICLE, coded, torch_threads, unsettled
from host_kernels import HostKernels, needs_gcc
from offpiste.core.conventions import ACTUATORS
from offpiste.core.state import ModelState, Trajectory
from offpiste.dynamics import Hybrid, Parametric, rollout
from offpiste.dynamics.feature_encoder import Compressor, Identity
from offpiste.mapping.terrain_sampler import as_codes
from offpiste.planning.caution import Caution
from offpiste.planning.controls import CONTROL_LIMITS, complete
from offpiste.planning.costs.layers import Hazards
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.driving_cost import driving_costs, driving_terms, situation_terrain, spread_model_state
from offpiste.planning.header.cost_text import plan_text
from offpiste.planning.header.costs import costs_by_kernels, packed_stray
from offpiste.planning.kernel import coded_map, encode_map, fused_costs, fused_rollout, kernel_model_state
from offpiste.planning.mppi import Settings, improve
from offpiste.planning.noise import coloured
from offpiste.uncertainty.spread import Spread, inputs_of
from planning_maps import layers, situation

STEPS = 60
KINDS = [("parametric", COMMANDED), ("b", VEHICLE), ("dc", VEHICLE), ("df", COMMANDED)]
"""Models of vehicles with and without measured actuators."""

GEARED = replace(VEHICLE, control=(*VEHICLE.control, "gear"))
PATH_ALONE = CostWeights(path=1.0, speed=0.0, overspeed=0.0, rollover=0.0, effort=(0.0, 0.0, 0.0), jerk=(0.0, 0.0, 0.0))
NO_HAZARDS = Hazards(obstacle=0.0, steep=0.0, unknown=0.0)
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


def caution(dynamics, reach=1.7):
    """A spread with random weights, which reads all that it can."""
    torch.manual_seed(0)
    spread = Spread(inputs_of(dynamics.vehicle, dynamics.codes))
    for layer in (spread.layers[0], spread.layers[2]):
        torch.nn.init.normal_(layer.weight, std=0.4)
        torch.nn.init.normal_(layer.bias, std=0.5)
    spread.start.data.copy_(torch.tensor([-1.0, 0.5]))
    spread.mean.normal_()
    spread.deviation.uniform_(0.5, 3)
    spread.factor.fill_(0.8)
    return Caution(spread.requires_grad_(False), reach)


PATHS = {"library": 70, "printed": 70, "lanes": 10}
"""Numbers of samples to compare: of the compiled library, and of printed C by one thread a sample or by four."""

paths = pytest.mark.parametrize(
    "path", ["library", *(pytest.param(name, marks=needs_gcc) for name in ("printed", "lanes"))]
)


def fused(dynamics, at):
    """Costs of control sequences by the library."""
    return fused_costs(dynamics, start(dynamics, at), at, CostWeights(), encode_map(at.ground, dynamics.encoder))


def planned(path, dynamics, at, controls, weights=None):
    """Costs and states of control sequences by one of `PATHS`, or "eager"."""
    encoder, model_state, weights = dynamics.encoder, start(dynamics, at), weights or CostWeights(lateral_limit=2.0)
    if path == "eager":
        source = situation_terrain(at, len(controls), encoder)
        completed = complete(dynamics.vehicle, controls, at.gear)
        trajectory = rollout(dynamics, spread_model_state(model_state, len(controls)), completed, source)
        return driving_costs(dynamics, model_state, at, weights, encoder)(controls), trajectory.state
    codes = encode_map(at.ground, encoder)
    if path == "library":
        return fused_rollout(dynamics, model_state, controls, at, weights, codes)
    kernels = HostKernels(plan_text(dynamics, at.costs.table, at.caution, lanes=path == "lanes"))
    states = torch.empty(controls.shape[1], 6, len(controls))
    costs = costs_by_kernels(kernels, dynamics, model_state, at, weights, codes)(controls, states)
    return costs, states.permute(2, 0, 1)


def assert_all_agree(path, dynamics, at, controls):
    """Compare every sample with the eager model and cost; return the states."""
    found, wanted = (planned(way, dynamics, at, controls) for way in (path, "eager"))
    torch.testing.assert_close(found[1], wanted[1], atol=1e-3, rtol=1e-4)
    torch.testing.assert_close(found[0], wanted[0], atol=1e-2, rtol=1e-2)
    return found[1]


def agreeing(states, wanted, share=0.9):
    """Return which samples have the same states: at edges of cells rounding decides, and trajectories part."""
    close = (states - wanted).abs().amax(dim=(1, 2)) < 2e-3
    assert close.float().mean() >= share
    return close


@paths
@pytest.mark.parametrize(("kind", "vehicle"), [*KINDS, ("dc", COMMANDED), ("dc of five numbers", VEHICLE)])
def test_costs_and_states_equal_the_eager_ones(kind, vehicle, path):
    at = situation(ground(), hazards=Hazards(obstacle=50.0), state=(-3.0, 1, 0.3, 8, 0.2, 0.1))
    given = model(kind, vehicle), at, commands(PATHS[path]), CostWeights(lateral_limit=0.25, rollover=20.0)
    (found, states), (wanted, eager_states) = planned(path, *given), planned("eager", *given)
    close = agreeing(states, eager_states)
    difference = (found - wanted).abs()[close]
    assert (difference < 0.01 * wanted.abs()[close] + 0.05).float().mean() > 0.9
    assert difference.median() < 1e-3 * wanted.median()
    trajectory = Trajectory(eager_states, torch.zeros(*eager_states.shape[:2], 4))
    assert all((term > 0).any() for term in driving_terms(trajectory, given[2], at, given[3]).values())


@paths
@pytest.mark.parametrize("place", [0.0, 300.0], ids=["on the map", "off it"])
def test_on_even_ground_every_sample_agrees(place, path):
    at = situation(layers(plane=(0.1, -0.2)), state=(place, 0, 1, 5, 0, 0))
    assert_all_agree(path, model("dc"), at, commands(PATHS[path] // 2, seed=2))


@paths
@pytest.mark.parametrize(("kind", "gear"), [("parametric", 0.0), ("b", 1.0), ("b", -1.0)])
def test_a_held_gear_completes_the_controls_of_models_that_know_one(kind, gear, path):
    at = replace(situation(layers(plane=(0.1, -0.2)), state=(0.0, 0, 0, 3 * gear, 0, 0)), gear=gear)
    dynamics, controls = model(kind, GEARED), commands(PATHS[path] // 2, seed=2)[:, :40]
    states = assert_all_agree(path, dynamics, at, controls)
    other = planned(path, dynamics, replace(at, gear=gear - 1), controls)[1]
    assert other[:, -1, 3].mean() < states[:, -1, 3].mean() - 0.1


def test_a_gear_may_be_given_with_the_controls():
    at, dynamics, controls = situation(state=(0.0, 0, 0, -3, 0, 0)), model("b", GEARED), commands(40)
    geared = torch.cat((controls, torch.full_like(controls[..., :1], -1.0)), dim=-1)
    assert torch.equal(fused(dynamics, at)(geared), fused(dynamics, replace(at, gear=-1.0))(controls))


def test_a_model_without_a_gear_does_not_mind_one():
    at, dynamics, controls = situation(), model("b"), commands(8)
    one, other = (planned("library", dynamics, replace(at, gear=gear), controls)[1] for gear in (1.0, -1.0))
    assert torch.equal(one, other)


def test_backwards_most_samples_agree():
    # Random weights make reverse unstable: there the eager float32 is as far from float64 as the kernel is.
    given = model("dc"), situation(layers(), state=(0.0, 0, 2, -1, 0, 0)), commands(33, seed=2)[:, :30]
    states, wanted = planned("library", *given)[1], planned("eager", *given)[1]
    assert (states - wanted).abs().amax(dim=(1, 2)).median() < 1e-4
    agreeing(states, wanted)


def added_by_caution(path, dynamics, at, controls):
    """Cost of the path that caution adds, and the states."""
    careful, states = planned(path, dynamics, replace(at, caution=caution(dynamics)), controls, PATH_ALONE)
    return careful - planned(path, dynamics, at, controls, PATH_ALONE)[0], states


@paths
@pytest.mark.parametrize(
    ("kind", "vehicle", "steps"), [(*KINDS[0], 60), (*KINDS[1], 45), (*KINDS[2], 60), (*KINDS[2], 3), (*KINDS[3], 45)]
)
def test_what_caution_adds_equals_what_the_reference_adds(kind, vehicle, steps, path):
    at = situation(ground(), hazards=NO_HAZARDS, state=(-3.0, 1, 0.3, 8, 0.2, 0.1))
    given = model(kind, vehicle), at, commands(PATHS[path])[:, :steps]
    (found, states), (wanted, eager_states) = added_by_caution(path, *given), added_by_caution("eager", *given)
    close = agreeing(states, eager_states)
    assert (wanted > 0).all()
    apart = ((found - wanted).abs() / wanted)[close]
    assert apart.median() < 1e-3
    assert (apart < 0.02).float().mean() > 0.95


@paths
@pytest.mark.parametrize("gear", [1.0, -1.0])
@pytest.mark.parametrize("place", [0.0, 300.0], ids=["on the map", "off it"])
def test_what_caution_adds_on_even_ground_and_in_each_gear(place, gear, path):
    at = replace(situation(layers(plane=(0.1, -0.2)), hazards=NO_HAZARDS, state=(place, 0, 1, 3, 0, 0)), gear=gear)
    given = model("b", GEARED), at, commands(PATHS[path] // 2, seed=2)[:, :40]
    (found, states), (wanted, eager_states) = added_by_caution(path, *given), added_by_caution("eager", *given)
    agreeing(states, eager_states, share=1.0)
    torch.testing.assert_close(found, wanted, atol=1e-3, rtol=2e-3)


def test_no_reach_costs_nothing():
    at, dynamics = situation(ground(), state=(-3.0, 1, 0.3, 8, 0.2, 0.1)), model("dc")
    plain, none = (fused(dynamics, here)(commands(40)) for here in (at, replace(at, caution=caution(dynamics, 0.0))))
    assert torch.equal(plain, none)


def test_a_spread_of_a_model_with_other_inputs_is_refused():
    dynamics, at = model("b"), replace(situation(ground()), caution=caution(model("dc")))
    for read in (lambda: fused(dynamics, at), lambda: packed_stray(dynamics, at.caution)):
        with pytest.raises(ValueError, match=r"the spread has \d+ inputs; this model's has 9"):
            read()


@pytest.mark.parametrize(("kind", "vehicle"), KINDS)
def test_the_model_state_after_controls_equals_that_of_eager_steps(kind, vehicle):
    at, dynamics = situation(ground(), state=(-3.0, 1, 0.3, 8, 0.2, 0.1)), model(kind, vehicle)
    controls = commands(1)[0]
    encoder, model_state = dynamics.encoder, start(dynamics, at)
    found = kernel_model_state(dynamics, model_state, controls[:8], at, encode_map(at.ground, encoder))
    source = situation_terrain(at, 1, encoder)
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


@paths
@pytest.mark.parametrize("ground", [layers(1, 20.0, plane=(0.1, 0.05)), layers(2, 20.0), UNKNOWN])
def test_maps_of_hardly_any_cells_or_without_known_ones(ground, path):
    assert_all_agree(path, model("dc"), situation(ground), commands(5))


@pytest.mark.parametrize("samples", [1, 32, 65])
def test_any_number_of_samples_costs_what_each_costs_alone(samples):
    cost_of, controls = fused(model("dc"), situation(ground())), commands(samples)
    together = cost_of(controls)
    assert together.shape == (samples,)
    for k in {0, samples // 2, samples - 1}:
        assert torch.equal(cost_of(controls[k : k + 1])[0], together[k])


@pytest.mark.parametrize(("steps", "geared"), [(1, False), (2, True), (3, False)])
def test_the_first_steps_are_the_same_in_a_shorter_plan(steps, geared):
    given, controls = (model("b", GEARED if geared else COMMANDED), situation(ground())), commands(33)
    controls = torch.cat((controls, torch.ones(33, STEPS, 1)), dim=2) if geared else controls
    whole, part = (planned("library", *given, c.contiguous())[1] for c in (controls, controls[:, :steps]))
    assert torch.equal(part, whole[:, :steps])


def test_a_plan_is_the_same_on_any_number_of_threads():
    cost_of, plans = fused(model("dc"), situation(ground())), []
    settings = Settings(CONTROL_LIMITS, (0.3, 0.1, 0.3), samples=100)
    for count in (1, 2):
        with torch_threads(count):
            draw = torch.Generator().manual_seed(0)
            plans.append(improve(torch.zeros(STEPS, 3), cost_of, settings, draw, previous=torch.zeros(3)))
    assert torch.equal(plans[0].costs, plans[1].costs)
    assert torch.equal(plans[0].controls, plans[1].controls)


@paths
@pytest.mark.parametrize("careful", [False, True])
def test_a_sample_with_nan_costs_nan_and_others_do_not(careful, path):
    at, dynamics, controls = situation(ground()), model("b"), commands(PATHS[path])
    controls[7, 30] = torch.nan
    costs, _ = planned(path, dynamics, replace(at, caution=caution(dynamics)) if careful else at, controls)
    assert costs.isnan().nonzero().flatten().tolist() == [7]


def test_inputs_that_the_kernel_does_not_support_are_refused():
    at, dynamics = situation(ground()), model("dc")
    model_state, codes = start(dynamics, at), encode_map(at.ground, dynamics.encoder)
    with pytest.raises(ValueError, match="codes have length 0"):
        fused_costs(dynamics, model_state, at, CostWeights(), encode_map(at.ground, None))
    with pytest.raises(ValueError, match="the start is"):
        fused_costs(dynamics, spread_model_state(model_state, 2), at, CostWeights(), codes)
    with pytest.raises(ValueError, match="float64"):
        fused(dynamics, at)(commands(3).double())
    with pytest.raises(ValueError, match="no kernel"):
        fused_costs(
            dynamics.double(), ModelState(*(p.double() for p in vars(model_state).values())), at, CostWeights(), codes
        )


@paths
@pytest.mark.parametrize("place", [(14.9, 14.9), (-15.2, 0), (1e9, -1e9), (torch.nan, 0), (torch.inf, 0)])
def test_places_at_the_edge_and_nowhere_are_read_within_bounds(place, path):
    given = model("dc"), situation(ground(), state=(*place, 0.7, 9, 0, 0)), commands(PATHS[path] // 2)[:, :20]
    found, wanted = (planned(way, *given)[0] for way in (path, "eager"))
    assert torch.equal(found.isfinite(), wanted.isfinite())


def test_the_cost_does_not_depend_on_the_frame_of_the_situation():
    at, dynamics = situation(layers(), state=(0.0, 0, 0, 5, 0, 0)), model("b")
    there, offset = at.state - torch.tensor([5.0, 7, 0, 0, 0, 0]), torch.tensor([5.0, 7.0], dtype=torch.float64)
    one, other = (fused(dynamics, here)(commands(8)) for here in (at, replace(at, state=there, offset=offset)))
    torch.testing.assert_close(one, other, rtol=1e-2, atol=1e-2)
