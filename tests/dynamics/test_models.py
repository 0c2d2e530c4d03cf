"""Models by name: what ships, what each name brings along, and what can be added."""

from dataclasses import replace
from functools import partial

import pytest
import torch

from factories import COMMANDED, VEHICLE, Situation
from offpiste.core.errors import RunError
from offpiste.dynamics import MODELS, Dynamics, register_model
from offpiste.dynamics.models import initial_actuators, is_baseline, reference_of


def test_every_model_can_be_made_and_says_what_it_can_do() -> None:
    for model in dict(MODELS.items()).values():
        dynamics = model(VEHICLE, seed=0)
        assert isinstance(dynamics, Dynamics)
        assert dynamics.codes == (dynamics.encoder.size if dynamics.encoder is not None else 0)
        assert dynamics.reads_terrain or model.baseline
        at = Situation(codes=dynamics.codes)
        assert dynamics.double().start(at.history, at.state, at.actuators).hidden.shape[1] == dynamics.recurrent_size


def test_physics_that_is_fitted_first_is_taken_over() -> None:
    hybrid = MODELS["b"](VEHICLE, seed=0)
    physics = hybrid.physics()
    with torch.no_grad():
        physics.bicycle.raw += 0.5
    hybrid.adopt_physics(physics)
    assert torch.equal(hybrid.bicycle.raw, physics.bicycle.raw)
    assert not hybrid.bicycle.raw.requires_grad
    hybrid.adopt_physics(physics, learns=True)
    assert hybrid.bicycle.raw.requires_grad
    assert MODELS["ctrv"](VEHICLE, seed=0).physics() is None


@pytest.mark.parametrize("name", [*MODELS, "actuators"])
def test_initial_weights_follow_from_the_seed_and_leave_the_global_generator_as_it_was(name: str) -> None:
    make = partial(initial_actuators, VEHICLE) if name == "actuators" else partial(MODELS[name], VEHICLE)
    before = torch.get_rng_state()
    first, other = make(seed=3), make(seed=4)
    if name in MODELS:
        first.physics()
    assert torch.equal(torch.get_rng_state(), before)
    with torch.random.fork_rng(devices=[]):
        torch.rand(7)
        again = make(seed=3)
    assert all(torch.equal(value, again.state_dict()[key]) for key, value in first.state_dict().items())
    if sum(p.numel() for n, p in first.named_parameters() if not n.endswith("raw")):
        assert any(not torch.equal(value, other.state_dict()[key]) for key, value in first.state_dict().items())


def test_a_taken_name_is_refused() -> None:
    with pytest.raises(RunError, match="there are two models called 'b'"):
        register_model("b")(MODELS["b"].build)


def test_the_reference_is_a_bicycle_where_something_steers() -> None:
    assert reference_of(COMMANDED) == "kinematic"
    assert reference_of(replace(COMMANDED, control=("throttle",))) == "ctrv"


def test_baselines_are_known_by_name() -> None:
    assert [name for name in (*MODELS, "unknown") if is_baseline(name)] == ["ctrv", "kinematic"]
