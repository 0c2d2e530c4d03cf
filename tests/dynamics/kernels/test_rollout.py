"""Kernels of the library, and C printed for GPUs and compiled here, against the eager model in float64.

Rollouts are compared, and all gradients that training uses.
"""

import copy
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from factories import coded, torch_threads
from host_kernels import HostKernels, needs_gcc
from offpiste.core.conventions import ACTUATORS, CONTROL
from offpiste.core.errors import DatasetError, OffpisteError
from offpiste.core.state import ModelState, RecordedTerrain, Terrain, Trajectory
from offpiste.dynamics import MODELS, ConstantMotion, Hybrid, Parametric, Vehicle, rollout
from offpiste.dynamics.header.gpu import check_kernels, gpu_kernels, prepared
from offpiste.dynamics.header.recorded import recorded_text, rollout_by_kernels
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


Result = tuple[tuple[Tensor, ...], dict[str, Tensor]]
"""Tensors, and the gradients of a weighted sum of them by name."""


def run(model: Hybrid | Parametric, inputs: Inputs, roll_out: Callable[..., Trajectory] | None) -> Result:
    """States and actuators, and their gradients.

    Args:
        roll_out: from model, model state, controls and terrain; None for the eager one.
    """
    dtype = next(model.parameters()).dtype
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
    scaled = found.state / torch.tensor([10, 10, 1, 2, 1, 1])
    present = [i for i, name in enumerate(ACTUATORS) if name in model.vehicle.actuators]
    return (found.state, found.actuators), gradients(model, leaves, scaled, found.actuators[..., present])


def gradients(model: torch.nn.Module, leaves: dict[str, Tensor], *values: Tensor) -> dict[str, Tensor]:
    """Gradients of a random weighted sum of values for the leaves and the parameters of a model, if enabled."""
    if not torch.is_grad_enabled():
        return {}
    leaves, draw = leaves | dict(model.named_parameters()), torch.Generator().manual_seed(1)
    loss = sum((torch.randn(each.shape, generator=draw).to(each.dtype) * each).sum() for each in values)
    wanted = {name: leaf for name, leaf in leaves.items() if leaf.requires_grad and leaf.numel()}
    found = torch.autograd.grad(loss, list(wanted.values()), allow_unused=True)
    return {name: each for name, each in zip(wanted, found, strict=True) if each is not None}


def assert_agree(found: Result, wanted: Result, tolerance: float = TOLERANCE) -> None:
    """Check each tensor's largest error over its largest value."""
    assert found[1].keys() == wanted[1].keys()
    names = [*map(str, range(len(wanted[0]))), *wanted[1]]
    pairs = zip((*found[0], *found[1].values()), (*wanted[0], *(wanted[1][name] for name in found[1])), strict=True)
    errors = {}
    for name, (one, other) in zip(names, pairs, strict=True):
        assert (one.isnan() == other.isnan()).all(), name
        one, other = one.detach().double().nan_to_num(), other.detach().nan_to_num()
        errors[name] = float((one - other).abs().max() / other.abs().max().clamp(min=1e-12))
    assert {name: error for name, error in errors.items() if not error < tolerance} == {}


def assert_same_for_threads(run: Callable[[], Result]) -> None:
    """Check that values and gradients do not depend on the number of threads, and values not on gradients."""
    values, wanted = run()
    with torch.no_grad():
        assert all(map(torch.equal, run()[0], values))
    for count in (1, 2, 3):
        with torch_threads(count):
            for name, gradient in run()[1].items():
                # The product with the codes is torch's, which some processors round otherwise in three threads.
                room = 1e-6 * float(wanted[name].abs().max()) if count == 3 else 0.0
                torch.testing.assert_close(gradient, wanted[name], rtol=0.0, atol=room)


def printed(model: Hybrid | Parametric, *flags: str) -> Callable[..., Trajectory]:
    """Rollouts by C printed for a model."""
    kernels = HostKernels(recorded_text(model), *flags)
    return lambda *given: rollout_by_kernels(kernels, *given)


PRINTED = [pytest.param("printed", marks=needs_gcc)]
paths = pytest.mark.parametrize("path", ["library", *PRINTED])


def compare(model: Hybrid | Parametric, batch: int, steps: int, path: str) -> dict[str, Tensor]:
    """Compare with the eager model; return the gradients.

    Args:
        path: "library", "printed" (in double precision), or "printed float32".
    """
    inputs, mine = windows(model, batch, steps), copy.deepcopy(model)
    wanted = run(model, inputs, None)
    if path == "printed":
        found = run(mine, inputs, printed(mine, "-DOFFPISTE_DOUBLE"))
    else:
        mine = mine.float()
        found = run(mine, inputs, rollout_recorded if path == "library" else printed(mine))
    assert_agree(found, wanted, 1e-6 if path == "printed" else TOLERANCE)
    return found[1]


@paths
@pytest.mark.parametrize("channels", CHANNELS)
def test_kernels_agree_with_the_eager_model(channels: str, path: str) -> None:
    kind = Parametric if channels in ("all", "no actuators") or "gear" in channels else Hybrid
    compare(example(*CHANNELS[channels], codes=0, kind=kind), batch=33, steps=8, path=path)


@paths
@pytest.mark.parametrize(("channels", "batch"), [("all", 1), ("no actuators", 70), ("no throttle", 64)])
def test_kernels_agree_with_codes_of_the_ground(channels: str, batch: int, path: str) -> None:
    compare(example(*CHANNELS[channels], codes=4, kind=Hybrid), batch=batch, steps=8, path=path)


@pytest.mark.parametrize("path", ["library", pytest.param("printed float32", marks=needs_gcc)])
def test_kernels_agree_over_a_second_and_with_a_frozen_compensator(path: str) -> None:
    model = example(*CHANNELS["all"], codes=2, kind=Hybrid)
    compare(model, batch=20, steps=50, path=path)
    model.compensator.requires_grad_(False)
    compare(model, batch=3, steps=5, path=path)


VEHICLE = Vehicle(1200.0, 2.1, 0.5, CONTROL, ACTUATORS, features=5)
STARTS = ("init_cell", "init_output", "encoder")
"""Parts of a model outside the rollout: their gradients come by those of its start and of codes."""


@paths
@pytest.mark.parametrize("name", [name for name in MODELS if MODELS[name](VEHICLE, seed=0).kernel_parts() is not None])
def test_all_weights_of_every_model_have_gradients(name: str, path: str) -> None:
    model = MODELS[name](VEHICLE, seed=0)
    model = randomised(model, model.codes)
    learns = {n for n, p in model.named_parameters() if p.requires_grad and not any(part in n for part in STARTS)}
    assert learns <= compare(model, 9, 6, path).keys()


@paths
def test_a_window_with_nan_changes_no_other(path: str) -> None:
    model = example(*CHANNELS["brake and steer"], codes=0, kind=Hybrid).float().requires_grad_(False)
    roll_out = rollout_recorded if path == "library" else printed(model)
    model_state, control, terrain = windows(model, 40, 5)
    good = roll_out(model, model_state, control, terrain)
    assert good.actuators[..., 3].isnan().all(), "absent"
    model_state.state[7, 3] = torch.nan
    bad = roll_out(model, model_state, control, terrain)
    assert bad.state[7, -1].isnan().any()
    others = [i for i in range(40) if i != 7]
    assert torch.equal(bad.state[others], good.state[others])


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
    assert_same_for_threads(lambda: run(model, inputs, rollout_recorded))


def test_what_kernels_cannot_do_is_refused() -> None:
    model, cpu = example(*CHANNELS["all"], codes=4, kind=Hybrid).float(), torch.device("cpu")
    assert supports(model, cpu, torch.float32)
    assert not supports(model, cpu, torch.float64)
    assert not supports(model, torch.device("cuda"), torch.float32)
    assert not supports(ConstantMotion(model.vehicle), cpu, torch.float32)
    model.actuators.requires_grad_(True)
    assert not supports(model, cpu, torch.float32)
    blind = example(("throttle",), (), codes=0, kind=Parametric).float()
    with pytest.raises(DatasetError, match="steering"):
        rollout_recorded(blind, *windows(blind, 3, 2))


@paths
@pytest.mark.parametrize("wrong", ["codes", "type", "controls", "steps"])
def test_inputs_that_do_not_fit_are_refused(wrong: str, path: str) -> None:
    model = example(*CHANNELS["all"], codes=4, kind=Hybrid).float().requires_grad_(False)
    model_state, control, terrain = windows(model, 4, 3)
    given = {
        "codes": (control, replace(terrain, latent=terrain.latent[..., :3])),
        "type": (control.double(), terrain),
        "controls": (torch.cat((control, control[..., :1]), dim=-1), terrain),
        "steps": (control, terrain.rows(slice(2))),
    }[wrong]
    said = {"codes": "latent is", "type": "no kernels|normals is", "controls": "controls is", "steps": "known normals"}
    with pytest.raises(ValueError, match=said[wrong]):
        (rollout_recorded if path == "library" else printed(model))(model, model_state, *given)


@needs_gcc
def test_printed_kernels_are_checked_before_their_first_use() -> None:
    model, cpu = example(*CHANNELS["all"], codes=4, kind=Hybrid).float(), torch.device("cpu")
    for last in model.compensator.output[-1].parameters():  # as before training
        torch.nn.init.zeros_(last)
    text = recorded_text(model)
    check_kernels(HostKernels(text), model, cpu)
    for right, wrong in (
        ("0.02f*yaw_rate", "0.021f*yaw_rate"),
        ("1.0f - a->layer[k]", "0.9f - a->layer[k]"),
        ("start_bar[k * n + i] = bar[k];", "start_bar[k * n + i] = 0.0f / 0.0f;"),
        ("constants_bar[k * n + i] = c_bar[k];", "constants_bar[k * n + i] = 5.0f;"),
    ):
        assert right in text
        with pytest.raises(OffpisteError, match="rollouts on cpu differ from the eager model's"):
            check_kernels(HostKernels(text.replace(right, wrong)), model, cpu)
    assert gpu_kernels(model, cpu, torch.float32) is None


@needs_gcc
def test_printed_kernels_are_prepared_once_for_each_model_and_device() -> None:
    model, cpu, compiled = example(*CHANNELS["all"], codes=0, kind=Parametric).float(), torch.device("cpu"), []

    def compile_here(text: str, device: torch.device) -> HostKernels:
        compiled.append((text, device))
        return HostKernels(text)

    kernels = prepared(model, cpu, compile_here)
    assert prepared(model, cpu, compile_here) is kernels
    assert compiled == [(recorded_text(model), cpu)]
    prepared(copy.deepcopy(model), cpu, compile_here)
    assert len(compiled) == 2
