"""The actuators' kernels against the eager delay models in float64: values, and every gradient that fits them."""

import copy
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from torch import Tensor

from offpiste.core.conventions import ACTUATORS, CONTROL
from offpiste.dynamics import Vehicle
from offpiste.dynamics.actuators import Actuators
from offpiste.dynamics.kernels.actuators import rollout_actuators, supports_actuators

TOLERANCE = 2e-5
"""Of the largest value of each tensor."""

CHANNELS = {
    "all": (CONTROL, ACTUATORS),
    "only engine": (CONTROL, ("engine_rpm",)),
    "brake and steer": (CONTROL, ("brake", "steer", "steer_rate")),
    "no throttle": (("brake", "steer"), ACTUATORS),
    "no brake": (("throttle", "steer"), ("steer", "steer_rate", "engine_rpm")),
    "steer without command": (("throttle", "brake"), ACTUATORS),
    "gear": ((*CONTROL, "gear"), ACTUATORS),
}


def example(channels: str) -> Actuators:
    """Delay models with random weights and ranges, in float64."""
    torch.manual_seed(0)
    control, actuators = CHANNELS[channels]
    model = Actuators(Vehicle(mass=1200.0, wheelbase=2.1, max_steer=0.5, control=control, actuators=actuators))
    for parameter in model.parameters():
        parameter.data += 0.3 * torch.randn_like(parameter)
    for network in model.networks.values():
        network.mean += 0.3 * torch.randn_like(network.mean)
        network.scale *= 1 + torch.rand_like(network.scale)
        network.low[:], network.high[:] = -1.0, 0.7
    return model.double()


def inputs(model: Actuators, batch: int, steps: int) -> dict[str, Tensor]:
    """Random input in every branch: brakes applying, releasing and at rest, driving on, back and standing still."""
    draw = torch.Generator().manual_seed(batch)
    start = torch.rand(batch, 4, generator=draw) * torch.tensor([1.0, 0.6, 0.5, 3.0])
    start -= torch.tensor([0.0, 0.3, 0.2, 0.0])
    start[::4, 0] = 0
    controls = torch.rand(batch, 1, 3, generator=draw) + 0.3 * torch.randn(batch, steps, 3, generator=draw)
    controls = controls.clamp(0, 1) - torch.tensor([0.0, 0.0, 0.5])
    controls[::2, :, 1] = 0
    if "gear" in model.vehicle.control_columns:
        gears = torch.randint(-1, 2, (batch, steps, 1), generator=torch.Generator().manual_seed(batch))
        controls = torch.cat((controls, gears.to(controls.dtype)), dim=-1)
    speed = 4 * torch.randn(batch, steps, generator=draw)
    speed[::5] = 0
    for i, name in enumerate(ACTUATORS):
        if name not in model.vehicle.actuators:
            start[:, i] = torch.nan
    for i, name in enumerate(model.vehicle.control_columns):
        if name not in model.vehicle.control:
            controls[:, :, i] = torch.nan
    hidden, cell = torch.randn(2, batch, model.hidden, generator=draw) * 0.5
    return {"start": start, "hidden": hidden, "cell": cell, "controls": controls, "speed": speed}


def run(model: Actuators, given: dict[str, Tensor], *, eager: bool) -> tuple[Tensor, dict[str, Tensor]]:
    """The actuators, and the gradients of a weighted sum of those that the log has."""
    dtype = model.raw.dtype
    leaves = {name: given[name].to(dtype, copy=True).requires_grad_() for name in ("start", "hidden", "cell")}
    recorded = {name: given[name].to(dtype) for name in ("controls", "speed")}
    assert supports_actuators(model, model.raw.device, dtype) is not eager
    found = model.rollout(**leaves, **recorded) if eager else rollout_actuators(model, **leaves, **recorded)
    weight = torch.randn(found.shape, generator=torch.Generator().manual_seed(1)).to(dtype)
    present = [i for i, name in enumerate(ACTUATORS) if name in model.vehicle.actuators]
    (weight * found)[..., present].sum().backward()
    leaves |= dict(model.named_parameters())
    return found, {name: leaf.grad for name, leaf in leaves.items() if leaf.grad is not None and leaf.numel()}


def difference(found: Tensor, wanted: Tensor) -> float:
    """The largest error over the largest value."""
    assert (found.isnan() == wanted.isnan()).all()
    found, wanted = found.detach().double().nan_to_num(), wanted.detach().nan_to_num()
    return float((found - wanted).abs().max() / wanted.abs().max().clamp(min=1e-12))


def compare(channels: str, batch: int, steps: int) -> None:
    model = example(channels)
    given = inputs(model, batch, steps)
    wanted, wanted_gradients = run(model, given, eager=True)
    found, gradients = run(copy.deepcopy(model).float(), given, eager=False)
    assert gradients.keys() == wanted_gradients.keys()
    errors = {name: difference(gradients[name], wanted_gradients[name]) for name in gradients}
    errors["actuators"] = difference(found, wanted)
    assert {name: error for name, error in errors.items() if not error < TOLERANCE} == {}


@pytest.mark.parametrize("channels", CHANNELS)
def test_kernels_agree_with_the_eager_models(channels: str) -> None:
    compare(channels, batch=33, steps=8)


@pytest.mark.parametrize(("batch", "steps"), [(1, 3), (70, 5), (20, 100)])
def test_kernels_agree_for_any_number_of_windows_and_steps(batch: int, steps: int) -> None:
    compare("all", batch, steps)


def test_gradients_are_those_of_finite_differences() -> None:
    model = example("all").float()
    given = inputs(model, 20, 10)
    _, gradients = run(model, given, eager=False)

    def objective(raw: Tensor) -> float:
        with torch.no_grad():
            model.raw.copy_(raw)
            found = rollout_actuators(model, **given)
            weight = torch.randn(found.shape, generator=torch.Generator().manual_seed(1))
            return float((weight * found).double().sum())

    raw, along = model.raw.detach().clone(), torch.randn(model.raw.shape, generator=torch.Generator().manual_seed(2))
    step = 1e-2
    slope = (objective(raw + step * along) - objective(raw - step * along)) / (2 * step)
    assert slope == pytest.approx(float((gradients["raw"] * along).sum()), rel=2e-3)


def test_numbers_do_not_depend_on_gradients_and_threads() -> None:
    model = example("all").float()
    given = inputs(model, 100, 7)
    found, gradients = run(model, given, eager=False)
    with torch.no_grad():
        assert torch.equal(rollout_actuators(model, **given), found)
    threads = torch.get_num_threads()
    try:
        for other in (1, 3):
            torch.set_num_threads(other)
            model.zero_grad()
            _, again = run(model, given, eager=False)
            assert all(torch.equal(again[name], gradients[name]) for name in gradients)
    finally:
        torch.set_num_threads(threads)


def test_a_frozen_residual_gets_no_gradient() -> None:
    model = example("all").float()
    model.networks["brake"].requires_grad_(False)
    _, gradients = run(model, inputs(model, 5, 4), eager=False)
    assert "raw" in gradients
    assert not any(name.startswith("residuals.brake") for name in gradients)


def test_other_types_are_refused() -> None:
    model = example("all")
    with pytest.raises(ValueError, match="no kernels"):
        rollout_actuators(model, **{name: value.double() for name, value in inputs(model, 2, 2).items()})


def test_kernels_stay_inside_their_arrays(bounds_checked: dict[str, str]) -> None:
    """Once more, compiled with bounds checks, in a process of its own."""
    paths = os.pathsep.join((str(Path(__file__).parent), *filter(None, sys.path)))
    code = "import test_actuators as t; t.compare('all', 33, 3)"
    subprocess.run([sys.executable, "-c", code], env=bounds_checked | {"PYTHONPATH": paths}, check=True)
