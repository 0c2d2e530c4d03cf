"""Costs of control sequences by one kernel: what `rollouts.driving_costs` computes, several times as fast, on the CPU.

The first call compiles for some 20 seconds; the machine code is kept beside the sources where that folder can be
written.
"""

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.conventions import ACTUATORS, CONTROL, DT, GRAVITY
from offpiste.dynamics.encoder import FeatureEncoder
from offpiste.dynamics.hybrid import Hybrid, Parametric
from offpiste.dynamics.kernels import layout
from offpiste.dynamics.kernels.function import supports
from offpiste.dynamics.kernels.given import constants, networks
from offpiste.dynamics.kernels.network import weights as matrices
from offpiste.dynamics.kernels.threads import spread
from offpiste.mapping.lookup import MapStack
from offpiste.planning.costs import Situation, Weights
from offpiste.planning.fused_kernel import Grid, Ground, Prices, Raster, roll_out
from offpiste.planning.mppi import CostOf
from offpiste.trajectory import Carry

Codes = tuple[Float[Tensor, "ny nx E"], Float[Tensor, " E"]]
"""Of the cells of a map, and of a cell without features."""


@torch.no_grad()
def encode_map(maps: MapStack, encoder: FeatureEncoder | None) -> Codes:
    """Codes of all cells of the first map of a stack: choosing a cell and encoding it commute."""
    features = maps.features[0].float()
    if encoder is None:
        return features[..., :0], features.new_zeros(0)
    flat = features.flatten(0, 1)
    codes = encoder(flat, flat.isfinite().all(dim=-1))
    return codes.unflatten(0, features.shape[:2]), encoder.missing()


def fused_costs(
    dynamics: Parametric | Hybrid, carry: Carry, situation: Situation, weights: Weights, codes: Codes
) -> CostOf:
    """Costs of driving on the situation's map; the same as `rollouts.driving_costs`, up to rounding.

    Args:
        dynamics: one that `dynamics.kernels.function.supports` is true for.
        carry: the start, a batch of one.
        codes: from `encode_map`.

    Raises:
        ValueError: a model, types or shapes that the kernel cannot take.
    """
    roll = _bind(dynamics, carry, situation, weights, codes)

    def cost_of(controls: Float[Tensor, "K T 3"]) -> Float[Tensor, " K"]:
        return roll(controls, torch.empty(0, 0, 6))

    return cost_of


def fused_rollout(
    dynamics: Parametric | Hybrid,
    carry: Carry,
    controls: Float[Tensor, "K T 3"],
    situation: Situation,
    weights: Weights,
    codes: Codes,
) -> tuple[Float[Tensor, " K"], Float[Tensor, "K T 6"]]:
    """The same costs, and the states after each step: to look at, and to test."""
    states = torch.empty(*controls.shape[:2], 6)
    return _bind(dynamics, carry, situation, weights, codes)(controls, states), states


@torch.no_grad()
def _bind(
    dynamics: Parametric | Hybrid, carry: Carry, situation: Situation, weights: Weights, codes: Codes
) -> Callable[[Tensor, Tensor], Tensor]:
    _check(dynamics, carry, codes)
    vehicle = dynamics.vehicle
    compensator = dynamics.compensator if isinstance(dynamics, Hybrid) else None
    weighted = matrices(compensator, dynamics.force_scale if isinstance(dynamics, Hybrid) else None)
    recorded = [*(name in vehicle.actuators for name in ACTUATORS), *(name in vehicle.control for name in CONTROL)]
    given = (
        situation.control.float().numpy(),
        np.array(recorded),
        constants(dynamics, torch.stack(dynamics.bicycle())),
        networks(dynamics, weighted),
        _ground(situation, codes),
        _raster(situation),
        _prices(weights),
    )
    start = carry.pack()[0].contiguous().numpy()

    def roll(controls: Tensor, states: Tensor) -> Tensor:
        if controls.ndim != 3 or controls.shape[2] != 3 or controls.dtype != torch.float32 or controls.is_cuda:
            raise ValueError(f"controls are {list(controls.shape)}, {controls.dtype}; [K, T, 3], float32 on the CPU")
        costs = torch.empty(len(controls))
        blocks = -(-len(controls) // layout.LANES)
        spread(blocks, roll_out, start, controls.contiguous().numpy(), *given, costs.numpy(), states.numpy())
        return costs

    return roll


def _ground(situation: Situation, codes: Codes) -> Ground:
    maps = situation.ground
    return Ground(
        _grid(situation.offset - maps.origin[0], maps.resolution),
        maps.slope[0].float().contiguous().numpy(),
        *(part.float().contiguous().numpy() for part in (*codes, situation.wheels)),
    )


def _raster(situation: Situation) -> Raster:
    costs = situation.costs
    grid = _grid(situation.offset - costs.origin, costs.resolution)
    return Raster(grid, costs.layers.float().contiguous().numpy(), np.float32(costs.outside))


def _grid(shift: Float[Tensor, " 2"], resolution: float) -> Grid:
    return Grid(shift.numpy().astype(np.float32), np.float32(1 / resolution))


def _prices(w: Weights) -> Prices:
    return Prices(
        path=np.float32(w.path),
        speed=np.float32(w.speed),
        overspeed=np.float32(w.overspeed),
        rollover=np.float32(w.rollover),
        lateral_limit=np.float32(w.lateral_limit),
        least_vertical=np.float32(w.least_vertical),
        gravity=np.float32(GRAVITY),
        dt=np.float32(DT),
        effort=np.array(w.effort, np.float32),
        jerk=np.array(w.jerk, np.float32),
    )


def _check(dynamics: Parametric | Hybrid, carry: Carry, codes: Codes) -> None:
    """Refuse what the kernel would read out of bounds, or wrongly."""
    if not supports(dynamics, carry.state.device, carry.state.dtype) or getattr(dynamics, "holds", False):
        raise ValueError("no kernel for this model; see `supports`")
    wanted = dynamics.codes if isinstance(dynamics, Hybrid) else 0
    units = dynamics.actuators.hidden + (dynamics.compensator.hidden if isinstance(dynamics, Hybrid) else 0)
    if carry.pack().shape != (1, 10 + 2 * units):
        raise ValueError(f"the start is {list(carry.pack().shape)}; the kernel wants {[1, 10 + 2 * units]}")
    if codes[0].shape[-1] != wanted or len(codes[1]) != wanted:
        raise ValueError(f"codes of {codes[0].shape[-1]} numbers; the model reads {wanted}")
