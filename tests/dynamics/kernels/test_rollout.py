"""Kernels against the eager model in float64: the rollout, and every gradient that training uses."""

import copy
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from factories import coded
from offpiste.core.conventions import ACTUATORS, CONTROL
from offpiste.core.errors import DatasetError
from offpiste.core.state import ModelState, RecordedTerrain, Terrain, Trajectory
from offpiste.dynamics import ConstantMotion, Hybrid, Parametric, Vehicle, rollout
from offpiste.dynamics.kernels import autograd
from offpiste.dynamics.kernels.autograd import rollout_recorded, supports
from offpiste.native.tensors import call

TOLERANCE = 2e-5
"""Of the largest value of each tensor."""

Inputs = tuple[ModelState, Tensor, Terrain]

CHANNELS = {
    "all": (CONTROL, ACTUATORS),
    "no actuators": (CONTROL, ()),
    "only engine": (CONTROL, ("engine_rpm",)),
    "only measured steering": (CONTROL, ("steer", "steer_rate")),
    "brake and engine": (CONTROL, ("brake", "engine_rpm")),
    "brake and steer": (CONTROL, ("brake", "steer", "steer_rate")),
    "no throttle": (("brake", "steer"), ACTUATORS),
    "no brake": (("throttle", "steer"), ("steer", "steer_rate", "engine_rpm")),
    "steer without command": (("throttle", "brake"), ACTUATORS),
    "only steering": (("steer",), ()),
    "gear": ((*CONTROL, "gear"), ACTUATORS),
    "gear without actuators": ((*CONTROL, "gear"), ()),
    "gear without throttle": (("brake", "steer", "gear"), ("brake",)),
}


def example(
    control: tuple[str, ...], actuators: tuple[str, ...], *, codes: int, kind: type[Hybrid | Parametric], seed: int = 0
) -> Hybrid | Parametric:
    """A model with random weights, in float64, its actuators frozen."""
    vehicle = Vehicle(mass=1200.0, wheelbase=2.1, max_steer=0.5, control=control, actuators=actuators)
    return randomised(coded(vehicle, codes) if kind is Hybrid else Parametric(vehicle), codes, seed=seed)


def randomised(model: Hybrid | Parametric, codes: int, *, seed: int = 0) -> Hybrid | Parametric:
    """The model with random weights and ranges of inputs, in float64, its actuators frozen."""
    torch.manual_seed(seed)
    for parameter in model.parameters():
        parameter.data += 0.3 * torch.randn_like(parameter)
    for name, buffer in model.named_buffers():
        if name.endswith("mean"):
            buffer += 0.3 * torch.randn_like(buffer)
    for network in model.actuators.networks.values():
        network.scale *= 1 + torch.rand_like(network.scale)
        network.low[:], network.high[:] = -1.0, 0.7
    if isinstance(model, Hybrid):
        network, known = model.compensator, len(model.compensator.mean) - 4 * codes
        network.scale *= 1 + torch.rand_like(network.scale)
        network.scale[known - 4 : known] = torch.tensor([2000.0, 3000.0, 3000.0, 1.0])
        network.low[:known], network.high[:known] = -1.5, 0.7
    model.actuators.requires_grad_(False)
    return model.double()


def windows(model: Hybrid | Parametric, batch: int, steps: int) -> Inputs:
    """Random input with every branch of the physics: standstill, reverse, slow, fast, brakes applying and releasing."""
    codes = getattr(model, "codes", 0)
    draw = torch.Generator().manual_seed(batch)
    state = torch.randn(batch, 6, generator=draw) * torch.tensor([20.0, 20.0, 3.0, 4.0, 0.5, 0.5])
    state[:, 3] += 3
    state[::5, 3:] = 0
    state[1::7, 3:5] *= 0.05
    actuators = torch.rand(batch, 4, generator=draw) * torch.tensor([1.0, 0.6, 0.5, 3.0])
    actuators -= torch.tensor([0.0, 0.3, 0.2, 0.0])
    control = torch.rand(batch, 1, 3, generator=draw) + 0.3 * torch.randn(batch, steps, 3, generator=draw)
    control = control.clamp(0, 1) - torch.tensor([0.0, 0.0, 0.5])
    control[::2, :, 1] = 0  # not braking is as common as it is a corner of the lag
    if "gear" in model.vehicle.control_columns:
        gears = torch.randint(-1, 2, (batch, steps, 1), generator=torch.Generator().manual_seed(batch))
        control = torch.cat((control, gears.to(control.dtype)), dim=-1)
    actuators[::4, 0] = 0
    normal = torch.randn(batch, steps, 4, 3, generator=draw) * 0.1 + torch.tensor([0.0, 0.0, 1.0])
    normal = normal / normal.norm(dim=-1, keepdim=True)
    # No wheel's, some and all of them.
    unknown = torch.rand(batch, steps, 4, 1, generator=draw) < torch.arange(batch)[:, None, None, None] % 4 / 3
    normal = normal.where(~unknown, torch.nan)
    latent = torch.randn(batch, steps, 4, codes, generator=draw)
    for i, name in enumerate(ACTUATORS):
        if name not in model.vehicle.actuators:
            actuators[:, i] = torch.nan
    for i, name in enumerate(model.vehicle.control_columns):
        if name not in model.vehicle.control:
            control[:, :, i] = torch.nan
    recurrent = torch.randn(batch, model.recurrent_size, generator=draw) * 0.5
    return ModelState(state, actuators, recurrent), control, replace(Terrain.of(normal), latent=latent)


def run(
    model: Hybrid | Parametric, inputs: Inputs, roll_out: Callable[..., Trajectory] | None
) -> tuple[Trajectory, dict[str, Tensor]]:
    """The trajectory, and the gradients of a weighted sum of all that it has.

    Args:
        roll_out: from model, model state, controls and terrain; None for the eager one.
    """
    dtype = next(model.parameters()).dtype
    model.zero_grad()
    model_state, control, terrain = inputs
    leaves = {"state": model_state.state, "recurrent": model_state.recurrent, "latent": terrain.latent}
    leaves = {name: leaf.to(dtype, copy=True).requires_grad_() for name, leaf in leaves.items()}
    model_state = ModelState(leaves["state"], model_state.actuators.to(dtype), leaves["recurrent"])
    terrain, control = Terrain(terrain.normal.to(dtype), terrain.known, leaves["latent"]), control.to(dtype)
    if roll_out is None:
        found = rollout(model, model_state, control, RecordedTerrain(terrain))
    else:
        assert roll_out is not rollout_recorded or supports(model, control.device, dtype)
        found = roll_out(model, model_state, control, terrain)
    draw = torch.Generator().manual_seed(1)
    present = [i for i, name in enumerate(ACTUATORS) if name in model.vehicle.actuators]
    weight = torch.randn(found.state.shape, generator=draw).to(dtype)
    loss = (weight / torch.tensor([10, 10, 1, 2, 1, 1]) * found.state).sum()
    loss = loss + (weight[..., :4] * found.actuators)[..., present].sum()
    loss.backward()
    leaves |= dict(model.named_parameters())
    return found, {name: leaf.grad for name, leaf in leaves.items() if leaf.grad is not None and leaf.numel()}


def difference(found: Tensor, wanted: Tensor) -> float:
    """The largest error over the largest value."""
    assert (found.isnan() == wanted.isnan()).all()
    found, wanted = found.detach().double().nan_to_num(), wanted.detach().nan_to_num()
    return float((found - wanted).abs().max() / wanted.abs().max().clamp(min=1e-12))


def same_for_threads(gradients: dict[str, Tensor], again: Callable[[], dict[str, Tensor]]) -> None:
    """Check that gradients do not depend on the number of threads."""
    threads = torch.get_num_threads()
    try:
        for other in (1, 2, 3):
            torch.set_num_threads(other)
            for name, gradient in again().items():
                # The product with the codes is torch's, which some processors round otherwise in three threads.
                room = 1e-6 * float(gradients[name].abs().max()) if other == 3 else 0.0
                torch.testing.assert_close(gradient, gradients[name], rtol=0.0, atol=room)
    finally:
        torch.set_num_threads(threads)


def compare(model: Hybrid | Parametric, batch: int, steps: int) -> None:
    inputs = windows(model, batch, steps)
    wanted, wanted_gradients = run(model, inputs, None)
    found, gradients = run(copy.deepcopy(model).float(), inputs, rollout_recorded)
    assert gradients.keys() == wanted_gradients.keys()
    errors = {name: difference(gradients[name], wanted_gradients[name]) for name in gradients}
    errors["states"] = difference(found.state, wanted.state)
    errors["actuators"] = difference(found.actuators, wanted.actuators)
    assert {name: error for name, error in errors.items() if not error < TOLERANCE} == {}


@pytest.mark.parametrize("channels", CHANNELS)
def test_kernels_agree_with_the_eager_model(channels: str) -> None:
    kind = Parametric if channels in ("all", "no actuators", "gear") else Hybrid
    compare(example(*CHANNELS[channels], codes=0, kind=kind), batch=33, steps=8)


def test_gears_matter_and_forward_equals_no_gear() -> None:
    geared = example(*CHANNELS["gear"], codes=0, kind=Parametric).float()
    plain = Parametric(replace(geared.vehicle, control=CONTROL))
    plain.load_state_dict(geared.state_dict())
    plain.actuators.requires_grad_(False)
    model_state, control, terrain = windows(geared, 40, 8)
    control[..., 3] = 1
    forward = rollout_recorded(geared, model_state, control, terrain)
    assert torch.equal(forward.state, rollout_recorded(plain, model_state, control[..., :3], terrain).state)
    control[..., 3] = -1
    assert (rollout_recorded(geared, model_state, control, terrain).state[:, -1, 3] < forward.state[:, -1, 3]).all()


@pytest.mark.parametrize(("channels", "batch"), [("all", 1), ("no actuators", 70), ("no throttle", 64)])
def test_kernels_agree_with_codes_of_the_ground(channels: str, batch: int) -> None:
    compare(example(*CHANNELS[channels], codes=4, kind=Hybrid), batch=batch, steps=8)


def test_kernels_agree_over_a_second_and_with_a_frozen_compensator() -> None:
    compare(example(*CHANNELS["all"], codes=2, kind=Hybrid), batch=20, steps=50)
    model = example(*CHANNELS["all"], codes=0, kind=Hybrid)
    model.compensator.requires_grad_(False)
    compare(model, batch=3, steps=5)


def test_states_of_every_step_are_kept_only_where_gradients_are_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    model, kept = example(*CHANNELS["all"], codes=4, kind=Hybrid).float(), []
    inputs = windows(model, 3, 5)
    monkeypatch.setattr(autograd, "call", lambda *given: kept.append(given[4] is not None) or call(*given))
    rollout_recorded(model, *inputs)
    with torch.no_grad():
        rollout_recorded(model, *inputs)
    rollout_recorded(model.requires_grad_(False), *inputs)
    assert kept[-3:] == [True, False, False]


def test_without_gradients_and_with_any_number_of_threads_the_numbers_are_the_same() -> None:
    model = example(*CHANNELS["all"], codes=4, kind=Hybrid).float()
    inputs = windows(model, 100, 7)
    found, gradients = run(model, inputs, rollout_recorded)
    with torch.no_grad():
        assert torch.equal(rollout_recorded(model, *inputs).state, found.state)
    same_for_threads(gradients, lambda: run(model, inputs, rollout_recorded)[1])


def test_what_kernels_cannot_do_is_refused() -> None:
    model = example(*CHANNELS["all"], codes=4, kind=Hybrid).float()
    model_state, control, terrain = windows(model, 3, 2)
    cpu = torch.device("cpu")
    assert supports(model, cpu, torch.float32)
    assert not supports(model, cpu, torch.float64)
    assert not supports(model, torch.device("cuda"), torch.float32)
    assert not supports(ConstantMotion(model.vehicle), cpu, torch.float32)
    with pytest.raises(ValueError, match="latent"):
        rollout_recorded(model, model_state, control, replace(terrain, latent=terrain.latent[..., :3]))
    later = Terrain(terrain.normal[:, 1:], terrain.known[:, 1:], terrain.latent[:, 1:])
    with pytest.raises(ValueError, match="normals"):
        rollout_recorded(model, model_state, control, later)
    model.actuators.requires_grad_(True)
    assert not supports(model, cpu, torch.float32)
    blind = example(("throttle",), (), codes=0, kind=Parametric).float()
    with pytest.raises(DatasetError, match="steering"):
        rollout_recorded(blind, *windows(blind, 3, 2))
