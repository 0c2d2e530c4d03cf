"""Costs of control sequences by the generated C kernels, on any device; the reference is `kernel.fused_costs`."""

import math
from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.conventions import CONTROL
from offpiste.core.state import ModelState
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.header.networks import LANE, packed_parameters
from offpiste.dynamics.kernels.layout import COMMANDS
from offpiste.dynamics.kernels.model_state import to_kernel_state
from offpiste.native.cuda_kernels import Kernels
from offpiste.planning.caution import Caution, spread_weights
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.driving_cost import Situation
from offpiste.planning.kernel import Codes, grid_numbers
from offpiste.uncertainty.spread import MOTION

Maps = tuple[Tensor, Tensor, Tensor]
"""Slopes, codes and layers of cells for `offpiste_roll_out`."""


@torch.no_grad()
def costs_by_kernels(
    kernels: Kernels, dynamics: Dynamics, model_state: ModelState, situation: Situation, weights: CostWeights,
    codes: Codes,
) -> Callable[..., Tensor]:  # fmt: skip
    """Return a function that computes the costs of driving by the kernels of `plan_text`.

    It is a `CostOf` that also fills states [T, 6, K], its second argument, if given.

    Args:
        kernels: of the model and the cost map's layers.
        model_state: the start, a batch of one, where the kernels run.
        codes: from `kernel.encode_map`.
    """
    device = model_state.state.device
    params = packed_parameters(dynamics).to(device)
    packed = packed_situation(dynamics, model_state, situation, weights, codes).to(device)
    maps = packed_maps(situation, codes, device)

    def roll(controls: Tensor, states: Tensor | None = None) -> Tensor:
        samples, steps, _ = controls.shape
        by_step = controls[..., : len(CONTROL)].permute(1, 2, 0).contiguous()
        costs = torch.empty(samples, device=device)
        given = (params, packed, *maps, by_step, costs, states, steps)
        kernels.launch("offpiste_roll_out", samples, *given, lanes=kernels.lanes)
        return costs

    return roll


def packed_situation(
    dynamics: Dynamics, model_state: ModelState, situation: Situation, weights: CostWeights, codes: Codes
) -> Float[Tensor, " N"]:
    """Return the numbers of `offpiste_situation` in order, on the CPU."""
    missing = codes[1].cpu()
    parts = (
        missing,
        np.zeros(-len(missing) % LANE),
        grid_numbers(situation, situation.ground),
        grid_numbers(situation, situation.costs),
        situation.wheels.cpu().flatten(),
        [situation.gear],
        situation.control.cpu(),
        [0.0 if math.isnan(value) else value for value in situation.costs.outside],
        weights.vector(),
        to_kernel_state(model_state)[0].cpu(),
        packed_stray(dynamics, situation.caution),
    )
    return torch.from_numpy(np.concatenate(parts, dtype=np.float32))


def packed_stray(dynamics: Dynamics, caution: Caution | None) -> Float[np.ndarray, " N"]:
    """Return the numbers of `offpiste_stray_weights` in order; none without caution."""
    if caution is None:
        return np.empty(0)
    vehicle, before = dynamics.vehicle, len(MOTION)
    of = spread_weights(caution, vehicle, dynamics.codes)
    commands = (before + COMMANDS.index(name) for name in vehicle.control_columns)
    read = [*range(before), *commands, *range(before + len(COMMANDS), len(of.inner))]
    parts = of.inner[read].t(), of.bias, of.outer.t(), of.outer_bias, of.start, np.array([of.reach])
    return np.concatenate([np.ravel(part) for part in parts])


def packed_maps(situation: Situation, codes: Codes, device: torch.device) -> Maps:
    """Return the cells of the ground and of the cost map."""
    cells = situation.ground.slope[0], codes[0], situation.costs.layers
    slope, code, layers = (part.to(device, torch.float32).contiguous() for part in cells)
    return slope, code, layers
