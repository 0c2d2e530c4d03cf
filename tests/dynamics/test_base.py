"""Properties of all models: gradients, invariance to frame and batch, absent channels, causality."""

import itertools
import math
from dataclasses import replace

import pytest
import torch

from factories import COMMANDED, VEHICLE, Situation, drawn, gradients_agree, unsettled
from offpiste.core.conventions import ACTUATORS, CONTROL
from offpiste.core.state import ModelState, RecordedTerrain, TerrainSource, Trajectory
from offpiste.dynamics import MODELS, Dynamics, Vehicle, as_callable, rollout
from offpiste.dynamics.kernels.model_state import from_kernel_state, to_kernel_state

CODES = {"df": 3, "cf": 4, "dc": 4}
"""Two features and a flag, or their compression."""
models = pytest.mark.parametrize("name", [name for name in MODELS if name not in ("b-hindsight", "cf")])


def built(name: str, vehicle: Vehicle = VEHICLE) -> Dynamics:
    return unsettled(MODELS[name](vehicle, seed=0).double())


def situation(name: str, **options: int) -> Situation:
    return Situation(codes=CODES.get(name, 0), **options)


def predict(model: Dynamics, at: Situation) -> Trajectory:
    return rollout(model, model.start(at.history, at.state, at.actuators), at.controls, at.source)


@models
def test_gradients_equal_finite_differences(name):
    model, at = built(name), situation(name, batch=2, steps=3)

    def end(model):
        found = predict(model, at)
        return torch.cat((found.state[:, -1], found.actuators[:, -1]), dim=-1)

    assert name == "ctrv" or gradients_agree(model, end)

    def final(state, controls):
        model_state = model.start(at.history, state, at.actuators)
        return rollout(model, model_state, controls, at.source).state[:, -1]

    inputs = (at.state.requires_grad_(), at.controls.requires_grad_())
    assert torch.autograd.gradcheck(final, inputs, fast_mode=True)


@models
def test_predictions_turn_and_move_with_the_world_and_do_not_depend_on_the_batch(name):
    model, at, angle, shift = built(name), situation(name, steps=20), 2.0, torch.tensor([300.0, -70.0]).double()
    turn = torch.tensor([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]], dtype=torch.float64)

    def moved(state):
        return torch.cat((state[..., :2] @ turn.T + shift, state[..., 2:3] + angle, state[..., 3:]), dim=-1)

    def turned(terrain):
        return replace(terrain, normal=torch.cat((terrain.normal[..., :2] @ turn.T, terrain.normal[..., 2:]), -1))

    other = at.mapped(lambda tensor: tensor)
    other.history = replace(at.history, state=moved(at.history.state), terrain=turned(at.history.terrain))
    other.state, other.source = moved(at.state), RecordedTerrain(turned(at.source.terrain))
    alone = predict(model, at.mapped(lambda tensor: tensor[1:2])).state
    torch.testing.assert_close(alone[0], predict(model, at).state[1], rtol=1e-10, atol=1e-10)
    torch.testing.assert_close(predict(model, other).state, moved(predict(model, at).state), rtol=1e-9, atol=1e-9)


@models
def test_float32_agrees_with_float64(name):
    at = situation(name, steps=50)
    torch.manual_seed(0)
    model = unsettled(
        MODELS[name](VEHICLE, seed=0).double(), scale=0.05
    )  # larger random weights are chaotic: rounding grows
    wanted = predict(model, at).state
    found = predict(model.float(), at.mapped(lambda tensor: tensor.float()))
    assert found.state.dtype == torch.float32
    torch.testing.assert_close(found.state.double(), wanted, rtol=1e-3, atol=1e-3)


def subsets() -> list[Vehicle]:
    """Every vehicle that a rig can describe: a steering command or angle, and any of the rest."""
    vehicles = []
    for keep in itertools.product((False, True), repeat=6):
        control = tuple(name for name, kept in zip(CONTROL, keep[:3], strict=True) if kept)
        brake, steer, engine = keep[3:]
        actuators = tuple(name for name, kept in zip(ACTUATORS, (brake, steer, steer, engine), strict=True) if kept)
        if "steer" in control or steer:
            vehicles.append(replace(VEHICLE, control=control, actuators=actuators))
    return vehicles


@models
def test_absent_channels_are_never_read(name):
    for vehicle in subsets()[:: 1 if name == "dc" else 7]:
        model, at = built(name, vehicle), situation(name, batch=2, steps=2)
        with_nan, with_seven = (predict(model, at.filled(vehicle, value)) for value in (math.nan, 7.0))
        assert with_nan.state.isfinite().all(), vehicle
        assert torch.equal(with_nan.state, with_seven.state), vehicle
        present = torch.tensor([actuator in vehicle.actuators for actuator in ACTUATORS])
        assert torch.equal(with_nan.actuators[..., present], with_seven.actuators[..., present]), vehicle
        if with_nan.state.requires_grad:
            with_nan.state.sum().backward()
        assert all(p.grad is None or p.grad.isfinite().all() for p in model.parameters()), vehicle


@models
def test_the_callable_for_other_planners_and_a_single_step_equal_the_rollout(name):
    model, at = built(name), situation(name)
    model_state = model.start(at.history, at.state, at.actuators)
    wanted = rollout(model, model_state, at.controls, at.source)
    once = model.step(model_state, at.controls[:, 0], at.source.at(0, model_state.state))
    assert torch.equal(once.state, wanted.state[:, 0])
    call, packed = as_callable(model, at.source), model_state.pack()
    for t, control in enumerate(at.controls.unbind(1)):
        packed = call(packed, control, t)
        assert torch.equal(packed[:, :6], wanted.state[:, t])
        assert torch.equal(packed[:, 6:10], wanted.actuators[:, t])


@pytest.mark.parametrize("networks", [0, 1, 3])
def test_a_packed_model_state_is_unpacked_unchanged(networks):
    model_state = ModelState(drawn(5, 6), drawn(5, 4), drawn(5, 8 * networks))
    for packed, unpack in (
        (model_state.pack(), ModelState.unpack), (to_kernel_state(model_state), from_kernel_state)
    ):  # fmt: skip
        assert packed.shape == (5, 10 + 8 * networks)
        assert all(torch.equal(value, vars(model_state)[name]) for name, value in vars(unpack(packed)).items())


@models
def test_predictions_do_not_depend_on_the_future(name):
    model, at = built(name), situation(name)
    other = at.mapped(lambda tensor: tensor.clone())
    other.controls[:, 5:] = 0.5
    other.source.terrain.normal[:, 5:] = torch.tensor([0.0, 0.0, 1.0]).double()
    assert torch.equal(predict(model, other).state[:, :5], predict(model, at).state[:, :5])


def test_terrain_is_read_with_the_state_before_each_step():
    at, asked = Situation(), []

    class Watched:
        def at(self, t, state):
            asked.append((t, state))
            return at.source.at(t, state)

    assert isinstance(Watched(), TerrainSource)
    model = built("parametric")
    found = rollout(model, model.start(at.history, at.state, at.actuators), at.controls, Watched())
    assert [t for t, _ in asked] == list(range(8))
    assert torch.equal(asked[0][1], at.state)
    assert torch.equal(asked[5][1], found.state[:, 4])


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
@models
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_gpu_agrees_with_the_cpu(name, dtype):
    at = situation(name, steps=50).mapped(lambda tensor: tensor.to(dtype))
    wanted = predict(built(name).to(dtype), at).state
    found = predict(built(name).to("cuda", dtype), at.mapped(lambda tensor: tensor.cuda())).state
    tolerance = 1e-3 if dtype == torch.float32 else 1e-9
    torch.testing.assert_close(found.cpu(), wanted, rtol=tolerance, atol=tolerance)


def test_commands_alone_are_enough_for_every_model():
    for name in MODELS:
        at = situation(name).filled(COMMANDED, math.nan)
        assert predict(built(name, COMMANDED), at).state.isfinite().all()
