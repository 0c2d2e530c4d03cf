"""The printed C, compiled for this machine, against the eager model: rollouts, and all gradients that training uses."""

import copy
from dataclasses import replace

import pytest
import torch

from dynamics.kernels.test_rollout import CHANNELS, TOLERANCE, difference, example, randomised, run, windows
from host_kernels import HostKernels, needs_gcc
from offpiste.core.conventions import ACTUATORS, CONTROL
from offpiste.core.errors import OffpisteError
from offpiste.dynamics import MODELS, Hybrid, Parametric, Vehicle
from offpiste.dynamics.header.gpu import check_kernels, gpu_kernels, prepared
from offpiste.dynamics.header.recorded import recorded_text, rollout_by_kernels

pytestmark = needs_gcc


def errors(model, batch, steps, *, double=False):
    """Largest errors of trajectory and gradients, each over its largest value, against the eager model in float64."""
    inputs = windows(model, batch, steps)
    wanted, wanted_gradients = run(model, inputs, roll_out=None)
    model = copy.deepcopy(model) if double else copy.deepcopy(model).float()
    kernels = HostKernels(recorded_text(model), *(["-DOFFPISTE_DOUBLE"] if double else []))
    found, gradients = run(model, inputs, roll_out=lambda *given: rollout_by_kernels(kernels, *given))
    assert gradients.keys() == wanted_gradients.keys()
    result = {name: difference(gradients[name], wanted_gradients[name]) for name in gradients}
    result["states"] = difference(found.state, wanted.state)
    result["actuators"] = difference(found.actuators, wanted.actuators)
    return result


@pytest.mark.parametrize("channels", [name for name in CHANNELS if name not in ("all", "no throttle")])
def test_the_printed_step_and_its_adjoint_agree_with_autograd(channels):
    model = example(*CHANNELS[channels], codes=0, kind=Parametric if "gear" in channels else Hybrid)
    assert max(errors(model, 33, 8, double=True).values()) < 1e-6


VEHICLE = Vehicle(1200.0, 2.1, 0.5, CONTROL, ACTUATORS, features=5)
PRINTED = sorted(name for name in MODELS if MODELS[name](VEHICLE, seed=0).kernel_parts() is not None)
"""All models that kernels step."""

STARTS = ("init_cell", "init_output", "encoder")
"""Parts of a model outside of the rollout: their gradients come by those of its start and of codes."""


@pytest.mark.parametrize("name", PRINTED)
def test_gradients_of_all_weights_of_every_model(name):
    model = MODELS[name](VEHICLE, seed=0)
    model = randomised(model, model.codes)
    learns = {n for n, p in model.named_parameters() if p.requires_grad and not any(part in n for part in STARTS)}
    found = errors(model, 9, 6, double=True)
    assert learns <= found.keys()
    assert max(found.values()) < 1e-6  # over each tensor's largest value


@pytest.mark.parametrize(("channels", "batch"), [("all", 1), ("no actuators", 70), ("no throttle", 64)])
def test_with_codes_of_the_ground(channels, batch):
    model = example(*CHANNELS[channels], codes=4, kind=Hybrid)
    assert max(errors(model, batch, 8, double=True).values()) < 1e-6


def test_float32_over_a_second_is_as_close_as_the_library_also_with_a_frozen_compensator():
    model = example(*CHANNELS["all"], codes=2, kind=Hybrid)
    assert max(errors(model, 20, 50).values()) < TOLERANCE
    model.compensator.requires_grad_(False)
    assert max(errors(model, 3, 5, double=True).values()) < 1e-6


def test_absent_actuators_and_windows_beside_one_with_nan_are_unchanged():
    model = example(*CHANNELS["brake and steer"], codes=0, kind=Hybrid).float().requires_grad_(False)
    kernels = HostKernels(recorded_text(model))
    model_state, control, terrain = windows(model, 40, 5)
    good = rollout_by_kernels(kernels, model, model_state, control, terrain)
    assert good.actuators[..., 3].isnan().all()
    model_state.state[7, 3] = torch.nan
    bad = rollout_by_kernels(kernels, model, model_state, control, terrain)
    assert bad.state[7, -1].isnan().any()
    others = [i for i in range(40) if i != 7]
    assert torch.equal(bad.state[others], good.state[others])


def test_kernels_are_checked_before_their_first_use():
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


def test_kernels_are_prepared_once_for_each_model_and_device():
    model, cpu, compiled = example(*CHANNELS["all"], codes=0, kind=Parametric).float(), torch.device("cpu"), []

    def compile_here(text, device):
        compiled.append((text, device))
        return HostKernels(text)

    kernels = prepared(model, cpu, compile_here)
    assert prepared(model, cpu, compile_here) is kernels
    assert compiled == [(recorded_text(model), cpu)]
    prepared(copy.deepcopy(model), cpu, compile_here)
    assert len(compiled) == 2


@pytest.mark.parametrize("wrong", ["controls", "type", "steps"])
def test_what_kernels_would_read_wrongly_is_refused(wrong):
    model = example(*CHANNELS["all"], codes=0, kind=Hybrid).float().requires_grad_(False)
    kernels = HostKernels(recorded_text(model))
    model_state, control, terrain = windows(model, 4, 3)
    whole = rollout_by_kernels(kernels, model, model_state, control, terrain).state
    spare = replace(terrain, latent=torch.randn(*terrain.known.shape, 3, generator=torch.Generator().manual_seed(0)))
    assert torch.equal(rollout_by_kernels(kernels, model, model_state, control, spare).state, whole)
    given = {
        "controls": (torch.cat((control, control[..., :1]), dim=-1), terrain),
        "type": (control.double(), terrain),
        "steps": (control, terrain.rows(slice(2))),
    }[wrong]
    with pytest.raises(ValueError, match=r"kernels need"):
        rollout_by_kernels(kernels, model, model_state, *given)
