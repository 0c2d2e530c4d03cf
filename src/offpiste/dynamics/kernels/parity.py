"""Comparison of compiled rollouts with the eager model on random input, before their first use with a model."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace

import torch
from torch import Tensor

from offpiste.core.conventions import ACTUATORS
from offpiste.core.state import ModelState, RecordedTerrain, Terrain, Trajectory
from offpiste.dynamics.base import Dynamics, rollout

APART = 1e-3
"""Largest difference of states and of gradients from the eager model's, relative to their largest values."""

Rollout = Callable[[Dynamics, ModelState, Tensor, Terrain], Trajectory]
"""`rollout` over recorded terrain."""


def largest_difference(
    dynamics: Dynamics, compiled: Rollout, device: torch.device, *, gradients: bool, batch: int = 65, steps: int = 10
) -> float:
    """Return the largest relative difference of a compiled rollout from the eager one; NaN where one is NaN.

    The weights of all networks are moved first: before training their last layers are zero, which hides differences.

    Args:
        gradients: compare the gradients by start, codes, bicycle and network as well.
        batch: not a multiple of the lanes of a kernel.
    """
    dynamics = _with_other_weights(dynamics)
    parts = dynamics.kernel_parts()
    assert parts is not None
    model_state, controls, terrain = _random_input(dynamics, device, batch, steps)
    networks = () if parts.compensator is None else parts.compensator.parameters()
    learning = [each for each in (*parts.bicycle.parameters(), *networks) if each.requires_grad]

    def results(rolled: Rollout) -> list[Tensor]:
        leaves = [part.detach().clone().requires_grad_(gradients) for part in (model_state.state, terrain.latent)]
        start = replace(model_state, state=leaves[0])
        found = rolled(dynamics, start, controls, Terrain(terrain.normal, terrain.known, leaves[1]))
        if not gradients:
            return [found.state]
        loss = found.state[..., 3:].square().sum()
        return [found.state.detach(), *torch.autograd.grad(loss, (*leaves, *learning), materialize_grads=True)]

    with torch.set_grad_enabled(gradients):
        pairs = zip(results(compiled), results(_eager), strict=True)
    differences = [(a - b).abs().max() / b.abs().max().clamp(min=1e-6) for a, b in pairs if a.numel()]
    return float(torch.stack(differences).max())


def _eager(dynamics: Dynamics, model_state: ModelState, controls: Tensor, terrain: Terrain) -> Trajectory:
    return rollout(dynamics, model_state, controls, RecordedTerrain(terrain))


def _with_other_weights(dynamics: Dynamics) -> Dynamics:
    other, draw = deepcopy(dynamics), torch.Generator().manual_seed(1)
    parts, residuals = other.kernel_parts(), other.actuators.residuals.values() if other.actuators is not None else ()
    assert parts is not None
    for network in (parts.compensator, *residuals):
        for weights in () if network is None else network.parameters():
            weights.data += 0.2 * torch.randn(weights.shape, generator=draw).to(weights.device)
    return other.to(next(other.parameters()).device)  # cuDNN wants an LSTM's weights in one piece, which copies are not


def _random_input(
    dynamics: Dynamics, device: torch.device, batch: int, steps: int
) -> tuple[ModelState, Tensor, Terrain]:
    draw = torch.Generator().manual_seed(0)
    state = torch.randn(batch, 6, generator=draw) + torch.tensor([0.0, 0, 0, 5, 0, 0])
    recurrent = 0.3 * torch.randn(batch, dynamics.recurrent_size, generator=draw)
    actuators = 0.1 * torch.rand(batch, len(ACTUATORS), generator=draw)
    controls = 0.5 * torch.rand(batch, steps, len(dynamics.vehicle.control_columns), generator=draw)
    normal = torch.nn.functional.normalize(
        0.1 * torch.randn(batch, steps, 4, 3, generator=draw) + torch.tensor([0.0, 0, 1]), dim=-1
    )
    latent = torch.randn(batch, steps, 4, dynamics.codes, generator=draw)
    model_state = ModelState(*(part.to(device) for part in (state, actuators, recurrent)))
    known = torch.rand(batch, steps, 4, generator=draw) > 0.1
    return model_state, controls.to(device), Terrain(normal.to(device), known.to(device), latent.to(device))
