"""Rollouts over recorded terrain on an NVIDIA GPU (extra `cuda`): which models, and a check before the first one."""

import logging
from collections.abc import Callable
from copy import deepcopy
from functools import cache
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from offpiste.conventions import ACTUATORS
from offpiste.cuda_kernels import Kernels, cuda_kernels
from offpiste.dynamics.base import Dynamics, rollout
from offpiste.dynamics.header.recorded import recorded_text, rollout_by_kernels
from offpiste.dynamics.kernels.autograd import has_kernels
from offpiste.dynamics.kernels.model_arrays import kernel_parts
from offpiste.errors import OffpisteError, is_installed
from offpiste.state import ModelState, RecordedTerrain, Terrain

logger = logging.getLogger(__name__)

APART = 1e-3
"""Largest difference of states and of gradients from the eager model's, over their largest values."""

_prepared: WeakKeyDictionary[Dynamics, dict[torch.device, Kernels]] = WeakKeyDictionary()
"""Kernels that were compiled for a model and checked with it: a training asks for them at each batch."""


def gpu_kernels(dynamics: Dynamics, device: torch.device, dtype: torch.dtype) -> Kernels | None:
    """Kernels for `rollout_by_kernels` of a model; None where it is not on a GPU, or not for kernels.

    Raises:
        OffpisteError: the GPU computes something else than the eager model.
    """
    if device.type != "cuda" or dtype != torch.float32 or not has_kernels(dynamics):
        return None
    if not (is_installed("cuda") and is_installed("cuda.core")):
        _say_that_kernels_are_missing()
        return None
    return prepared(dynamics, device, cuda_kernels)


def prepared(dynamics: Dynamics, device: torch.device, compiled: Callable[[str, torch.device], Kernels]) -> Kernels:
    """Kernels of a model on a device; text, code and check are made once for each.

    Args:
        compiled: makes kernels of a text.

    Raises:
        OffpisteError: they compute something else than the eager model.
    """
    by_device = _prepared.setdefault(dynamics, {})
    if device not in by_device:
        kernels = compiled(recorded_text(dynamics), device)
        check_kernels(kernels, dynamics, device)
        by_device[device] = kernels
    return by_device[device]


@cache
def _say_that_kernels_are_missing() -> None:
    logger.warning("without the extra `cuda` the GPU steps models eagerly, which is slow: pip install 'offpiste[cuda]'")


@torch.enable_grad()
def check_kernels(kernels: Kernels, dynamics: Dynamics, device: torch.device) -> None:
    """Compare states, and their gradients by start, codes and what learns, with the eager model's, on random input.

    The kernels' text has no weights in it, so that they are compared with weights of their own.

    Raises:
        OffpisteError: they differ.
    """
    dynamics = _with_other_weights(dynamics)
    model_state, controls, terrain = _random(dynamics, device, batch=65, steps=10)
    parts, _ = kernel_parts(dynamics)
    networks = () if parts.compensator is None else parts.compensator.parameters()
    learning = [each for each in (*parts.bicycle.parameters(), *networks) if each.requires_grad]

    def of(by_kernels: bool) -> list[Tensor]:
        leaves = [part.detach().clone().requires_grad_() for part in (model_state.state, terrain.latent)]
        start = ModelState(leaves[0], model_state.actuators, model_state.hidden, model_state.cell)
        ground = Terrain(terrain.normal, terrain.known, leaves[1])
        if by_kernels:
            states = rollout_by_kernels(kernels, dynamics, start, controls, ground).state
        else:
            states = rollout(dynamics, start, controls, RecordedTerrain(ground)).state
        of_all = (*leaves, *learning)
        gradients = torch.autograd.grad(states[..., 3:].square().sum(), of_all, materialize_grads=True)
        return [states.detach(), *gradients]

    pairs = zip(of(by_kernels=True), of(by_kernels=False), strict=True)
    differences = [(a - b).abs().max() / b.abs().max().clamp(min=1e-6) for a, b in pairs if a.numel()]
    apart = float(torch.stack(differences).max())  # NaN where one is
    if not apart < APART:
        what = f"rollouts on {device} differ from the eager model's, by {apart:.1e}"
        raise OffpisteError(what, how="use --device cpu, and report GPU, driver and this line")


def _with_other_weights(dynamics: Dynamics) -> Dynamics:
    """The model with other weights: before training most gradients are zero, since the last layer is."""
    other, draw = deepcopy(dynamics), torch.Generator().manual_seed(1)
    networks = kernel_parts(other)[0].compensator
    for weights in () if networks is None else networks.parameters():
        weights.data += 0.2 * torch.randn(weights.shape, generator=draw).to(weights.device)
    return other.to(next(other.parameters()).device)  # cuDNN wants an LSTM's weights in one piece, which copies are not


def _random(dynamics: Dynamics, device: torch.device, batch: int, steps: int) -> tuple[ModelState, Tensor, Terrain]:
    draw = torch.Generator().manual_seed(0)
    state = torch.randn(batch, 6, generator=draw) + torch.tensor([0.0, 0, 0, 5, 0, 0])
    units = dynamics.recurrent_size
    hidden, cell = 0.3 * torch.randn(2, batch, units, generator=draw)
    actuators = 0.1 * torch.rand(batch, len(ACTUATORS), generator=draw)
    controls = 0.5 * torch.rand(batch, steps, len(dynamics.vehicle.control_columns), generator=draw)
    normal = torch.nn.functional.normalize(
        0.1 * torch.randn(batch, steps, 4, 3, generator=draw) + torch.tensor([0.0, 0, 1]), dim=-1
    )
    latent = torch.randn(batch, steps, 4, dynamics.codes, generator=draw)
    model_state = ModelState(*(part.to(device) for part in (state, actuators, hidden, cell)))
    known = torch.rand(batch, steps, 4, generator=draw) > 0.1
    return model_state, controls.to(device), Terrain(normal.to(device), known.to(device), latent.to(device))
