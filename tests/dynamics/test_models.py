"""The registry of models: interface, initial weights, names."""

from dataclasses import replace
from functools import partial

import pytest
import torch

from factories import COMMANDED, VEHICLE, Situation
from offpiste.core.errors import RunError
from offpiste.dynamics import MODELS, Dynamics, register_model
from offpiste.dynamics.models import initial_actuators, is_baseline, reference_of


def test_every_model_declares_its_interface() -> None:
    for model in dict(MODELS.items()).values():
        dynamics = model(VEHICLE, seed=0)
        assert isinstance(dynamics, Dynamics)
        assert dynamics.codes == (dynamics.encoder.size if dynamics.encoder is not None else 0)
        assert dynamics.reads_terrain or model.baseline
        at = Situation(codes=dynamics.codes)
        assert dynamics.double().start(at.history, at.state, at.actuators).recurrent.shape[1] == dynamics.recurrent_size


def test_fitted_physics_is_adopted() -> None:
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


@pytest.mark.parametrize("name", ["lstm", "dc", "actuators"])
def test_initial_weights_depend_only_on_the_seed_and_the_global_generator_is_unchanged(name: str) -> None:
    make = partial(initial_actuators, VEHICLE) if name == "actuators" else partial(MODELS[name], VEHICLE)
    before = torch.get_rng_state()
    first, other = make(seed=3), make(seed=4)
    if name == "dc":
        first.physics()
    assert torch.equal(torch.get_rng_state(), before)
    with torch.random.fork_rng(devices=[]):
        torch.rand(7)
        again = make(seed=3)
    assert all(torch.equal(value, again.state_dict()[key]) for key, value in first.state_dict().items())
    assert any(not torch.equal(value, other.state_dict()[key]) for key, value in first.state_dict().items())


def test_names_are_unique_and_identify_the_baselines_and_the_reference() -> None:
    with pytest.raises(RunError, match="there are two models called 'b'"):
        register_model("b")(MODELS["b"].build)
    assert reference_of(COMMANDED) == "kinematic"
    assert reference_of(replace(COMMANDED, control=("throttle",))) == "ctrv"
    assert [name for name in (*MODELS, "unknown") if is_baseline(name)] == ["ctrv", "kinematic"]
