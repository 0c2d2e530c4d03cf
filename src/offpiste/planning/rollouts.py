"""Costs of control sequences by rollouts of a model in torch: the reference of the kernel, for any model and cost."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.conventions import CONTROL
from offpiste.core.state import ModelState, TerrainSource, Trajectory
from offpiste.dynamics.base import Dynamics, rollout
from offpiste.mapping.terrain_sampler import Encode, MapTerrain
from offpiste.planning.caution import strays
from offpiste.planning.controls import complete
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.driving_cost import Situation, driving_cost
from offpiste.planning.mppi import CostOf


def model_costs(
    dynamics: Dynamics, model_state: ModelState, source: TerrainSource, cost: Callable[[Trajectory, Tensor], Tensor]
) -> CostOf:
    """Costs of the trajectories that a model predicts.

    Args:
        model_state: model state at the start, a batch of one.
        source: terrain for K rollouts.
        cost: costs [K] of predicted trajectories and their controls [K, T, U], e.g. `driving_cost`.
    """

    def cost_of(controls: Tensor) -> Tensor:
        return cost(rollout(dynamics, spread_model_state(model_state, len(controls)), controls, source), controls)

    return cost_of


def driving_costs(
    dynamics: Dynamics,
    model_state: ModelState,
    situation: Situation,
    weights: CostWeights,
    encode: Encode | None = None,
) -> CostOf:
    """Costs of driving on the situation's map.

    Args:
        model_state: model state at the start, a batch of one, in `situation.state`.
        encode: encoder of the map's features; None for models without features; `terrain_sampler.as_codes` where the
            map holds codes.
    """

    def cost_of(controls: Tensor) -> Tensor:
        source = situation_terrain(dynamics, situation, len(controls), encode)
        caution, start = situation.caution, situation.state.expand(len(controls), 6)

        def cost(trajectory: Trajectory, controls: Tensor) -> Tensor:
            reach = None
            if caution is not None:
                reach = strays(caution, dynamics.vehicle, start, trajectory, controls, source)
            return driving_cost(trajectory, controls[..., : len(CONTROL)], situation, weights, reach)

        completed = complete(dynamics.vehicle, controls, situation.gear)
        return model_costs(dynamics, model_state, source, cost)(completed)

    return cost_of


def situation_terrain(
    dynamics: Dynamics, situation: Situation, samples: int, encode: Encode | None = None
) -> TerrainSource:
    """Terrain of the situation's map for `samples` rollouts.

    Args:
        encode: as in `driving_costs`.
    """
    number = torch.zeros(samples, dtype=torch.long, device=situation.state.device)
    offset = situation.offset.expand(samples, 2)
    return MapTerrain(situation.ground, number, offset, situation.wheels, encode)


def spread_model_state(model_state: ModelState, samples: int) -> ModelState:
    """Model state of one rollout, repeated for `samples` rollouts."""
    return ModelState(
        *(
            part.expand(samples, -1)
            for part in (model_state.state, model_state.actuators, model_state.hidden, model_state.cell)
        )
    )


def callable_costs(
    dynamics: Callable[[Tensor, Tensor], Tensor],
    running_cost: Callable[[Tensor, Tensor], Tensor],
    state: Float[Tensor, " S"],
    *,
    terminal_cost: Callable[[Tensor], Tensor] | None = None,
) -> CostOf:
    """Costs by plain functions, as pytorch_mppi and similar planners take them.

    Args:
        dynamics: next states from states [K, S] and controls [K, U].
        running_cost: costs [K] of the states after a step and its controls.
        state: state at the start.
        terminal_cost: costs [K] of the last states.
    """

    def cost_of(controls: Tensor) -> Tensor:
        states, total = state.expand(len(controls), -1), controls.new_zeros(len(controls))
        for control in controls.unbind(dim=1):
            states = dynamics(states, control)
            total = total + running_cost(states, control).reshape(-1)
        return total if terminal_cost is None else total + terminal_cost(states).reshape(-1)

    return cost_of
