"""Costs of control sequences by a fused kernel on the CPU; the reference is `driving_cost.driving_costs`.

The first call compiles for some 20 seconds; the machine code is kept in the user's cache folder
(`offpiste.native.kernel_cache`).
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from offpiste.core.conventions import ACTUATORS, CONTROL
from offpiste.core.state import ModelState
from offpiste.dynamics.base import Dynamics
from offpiste.dynamics.feature_encoder import FeatureEncoder
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.autograd import supports
from offpiste.dynamics.kernels.model_arrays import (
    compensator_weights,
    constants,
    from_kernel_state,
    learned_constants,
    networks,
    recorded_channels,
    to_kernel_state,
)
from offpiste.mapping.terrain_sampler import MapStack
from offpiste.native.compilation import spread_kernel
from offpiste.planning.controls import complete
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.driving_cost import Situation
from offpiste.planning.kernel_costs import kernel_costs
from offpiste.planning.kernel_stray import stray_weights
from offpiste.planning.kernel_terrain import CostCells, Grid, GroundCells
from offpiste.planning.mppi import CostOf

Codes = tuple[Float[Tensor, "ny nx E"], Float[Tensor, " E"]]
"""Codes of the cells of a map, and of a cell without features."""

PART: Final = 4096
"""Number of cells encoded at a time."""


@torch.no_grad()
def encode_map(maps: MapStack, encoder: FeatureEncoder | None) -> Codes:
    """Encode the cells of the first map of a stack."""
    features = maps.features[0]
    if encoder is None:
        return features[..., :0].float(), torch.zeros(0, device=features.device)
    missing = encoder.missing()
    codes, seen = missing.repeat(*features.shape[:2], 1), features.isfinite().all(dim=-1)
    # Small parts stay in the cache.
    for row, column in zip(*(index.split(PART) for index in seen.nonzero(as_tuple=True)), strict=True):
        there = torch.ones(len(row), dtype=torch.bool, device=features.device)
        codes[row, column] = encoder(features[row, column].to(missing.dtype), there)
    return codes, missing


@torch.no_grad()
def coded_map(codes: Float[Tensor, "ny nx n"], encoder: FeatureEncoder) -> Codes:
    """Return the codes of a map that already holds codes; non-finite ones are missing.

    Raises:
        ValueError: their length differs from the encoder's.
    """
    missing = encoder.missing()
    if codes.shape[-1] != encoder.size:
        raise ValueError(f"the map holds {codes.shape[-1]} numbers a cell; codes are {encoder.size}")
    return codes.to(missing.dtype).where(codes.isfinite().all(dim=-1, keepdim=True), missing), missing


def fused_costs(
    dynamics: Dynamics, model_state: ModelState, situation: Situation, weights: CostWeights, codes: Codes
) -> CostOf:
    """Return a function that computes the costs of driving, as `driving_cost.driving_costs` up to rounding.

    Args:
        dynamics: model supported by the kernels (`dynamics.kernels.autograd.supports`).
        model_state: model state at the start, a batch of one.
        codes: from `encode_map`.

    Raises:
        ValueError: unsupported model, types or shapes.
    """
    roll = _bind(dynamics, model_state, situation, weights, codes)

    def cost_of(controls: Tensor) -> Tensor:
        return roll(controls, torch.empty(0, 0, 6))

    return cost_of


def fused_rollout(
    dynamics: Dynamics,
    model_state: ModelState,
    controls: Float[Tensor, "K T U"],
    situation: Situation,
    weights: CostWeights,
    codes: Codes,
) -> tuple[Float[Tensor, " K"], Float[Tensor, "K T 6"]]:
    """Return the same costs, and the states after each step."""
    states = torch.empty(*controls.shape[:2], 6)
    return _bind(dynamics, model_state, situation, weights, codes)(controls, states), states


def kernel_model_state(
    dynamics: Dynamics,
    model_state: ModelState,
    controls: Float[Tensor, "T U"],
    situation: Situation,
    codes: Codes,
) -> ModelState:
    """Return the model state after at least one step of controls."""
    after = torch.empty(1, len(controls), model_state.pack().shape[1])
    _bind(dynamics, model_state, situation, CostWeights(), codes)(controls[None], after)
    result = from_kernel_state(after[:, -1])
    recorded = torch.tensor([name in dynamics.vehicle.actuators for name in ACTUATORS])
    return replace(result, actuators=result.actuators.where(recorded, model_state.actuators))


@torch.no_grad()
def _bind(
    dynamics: Dynamics,
    model_state: ModelState,
    situation: Situation,
    weights: CostWeights,
    codes: Codes,
) -> Callable[[Tensor, Tensor], Tensor]:
    _check(dynamics, model_state, codes)
    vehicle, costs = dynamics.vehicle, kernel_costs(situation.costs.table)
    given = (
        situation.control.float().numpy(),
        recorded_channels(vehicle),
        constants(dynamics, learned_constants(dynamics)),
        networks(dynamics, compensator_weights(dynamics)),
        _ground_cells(situation, codes),
        _cost_cells(situation),
        stray_weights(situation.caution, vehicle, dynamics.codes),
        costs.numbers(weights),
    )
    start = to_kernel_state(model_state)[0].contiguous().numpy()

    def roll(controls: Tensor, states: Tensor) -> Tensor:
        widths, wanted = {len(CONTROL), len(vehicle.control_columns)}, (torch.float32, torch.device("cpu"))
        if controls.ndim != 3 or controls.shape[2] not in widths or (controls.dtype, controls.device) != wanted:
            result = f"{list(controls.shape)}, {controls.dtype} on {controls.device}"
            raise ValueError(f"controls are {result}; the kernel wants [K, T, {min(widths)}], float32 on the CPU")
        controls = complete(vehicle, controls, situation.gear)
        total = torch.empty(len(controls))
        blocks = -(-len(controls) // layout.LANES)
        arrays = start, controls.contiguous().numpy(), *given, total.numpy(), states.numpy()
        spread_kernel(blocks, costs.roll_out, *arrays)
        return total

    return roll


def _ground_cells(situation: Situation, codes: Codes) -> GroundCells:
    maps, slope = situation.ground, situation.ground.slope[0]
    cells, missing = codes
    return GroundCells(
        _grid(situation.offset - maps.origin[0], maps.resolution, cells),
        _flat(slope.expand(-1, 2, -1) if slope.shape[1] == 1 else slope),
        _flat(cells),
        *(part.float().contiguous().numpy() for part in (missing, situation.wheels)),
    )


def _cost_cells(situation: Situation) -> CostCells:
    costs = situation.costs
    more = max(0, 4 - len(costs.outside))
    return CostCells(
        _grid(situation.offset - costs.origin, costs.resolution, costs.layers),
        _flat(pad(costs.layers, (0, more)) if more else costs.layers),
        np.array((*costs.outside, *[0] * more), np.float32),
    )


def _flat(cells: Float[Tensor, "ny nx C"]) -> Float[np.ndarray, " numbers"]:
    return cells.float().contiguous().numpy().reshape(-1)


def _grid(shift: Float[Tensor, " 2"], resolution: float, cells: Float[Tensor, "ny nx _"]) -> Grid:
    return Grid(shift.numpy().astype(np.float32), np.float32(1 / resolution), cells.shape[0], cells.shape[1])


def _check(dynamics: Dynamics, model_state: ModelState, codes: Codes) -> None:
    """Raise for inputs that the kernel would read wrongly or out of bounds."""
    if not supports(dynamics, model_state.state.device, model_state.state.dtype):
        raise ValueError("no kernel for this model; see `supports`")
    wanted = dynamics.codes
    result, needed = list(model_state.pack().shape), [1, len(layout.STEPPED) + dynamics.recurrent_size]
    if result != needed:
        raise ValueError(f"the start is {result}; the kernel wants {needed}")
    if codes[0].shape[-1] != wanted or len(codes[1]) != wanted:
        raise ValueError(f"codes of {codes[0].shape[-1]} numbers; the model reads {wanted}")
