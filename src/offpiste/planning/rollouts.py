"""Costs of control sequences by rolling a model out: the eager reference, for any model and any cost."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.dynamics.base import Dynamics, rollout
from offpiste.mapping.terrain_sampler import Encode, HeldCodes, MapTerrain
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.driving_cost import Situation, driving_cost
from offpiste.planning.mppi import CostOf
from offpiste.state import ModelState, TerrainSource, Trajectory


def model_costs(
    dynamics: Dynamics, model_state: ModelState, source: TerrainSource, cost: Callable[[Trajectory, Tensor], Tensor]
) -> CostOf:
    """Costs of the trajectories that a model predicts.

    Args:
        model_state: the start, a batch of one.
        source: of the ground for K rollouts.
        cost: from predicted trajectories and their controls [K, T, 3] to costs [K], e.g. `driving_cost`.
    """

    def cost_of(controls: Float[Tensor, "K T U"]) -> Float[Tensor, " K"]:
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
        model_state: the start, a batch of one, in `situation.state`.
        encode: of the map's features; None for models without features. `lookup.as_codes` where it holds codes.
    """

    def cost_of(controls: Float[Tensor, "K T U"]) -> Float[Tensor, " K"]:
        source = ground_ahead(dynamics, situation, len(controls), encode)

        def cost(trajectory: Trajectory, controls: Tensor) -> Tensor:
            return driving_cost(trajectory, controls, situation, weights)

        return model_costs(dynamics, model_state, source, cost)(controls)

    return cost_of


def ground_ahead(dynamics: Dynamics, situation: Situation, samples: int, encode: Encode | None = None) -> TerrainSource:
    """The situation's map for as many rollouts, as the model reads it: one that holds codes keeps those of the start.

    Args:
        encode: as in `driving_costs`.
    """
    number = torch.zeros(samples, dtype=torch.long, device=situation.state.device)
    offset = situation.offset.expand(samples, 2)
    source = MapTerrain(situation.ground, number, offset, situation.wheels, encode)
    if not dynamics.holds_codes:
        return source
    return HeldCodes.of(source, situation.state.expand(samples, 6))


def spread_model_state(model_state: ModelState, samples: int) -> ModelState:
    """The model state of one rollout, for as many samples."""
    """A model state of one, for as many samples."""
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
    """Costs with plain functions, as pytorch_mppi and similar planners take them.

    Args:
        dynamics: from states [K, S] and controls [K, U] to the next states.
        running_cost: of the states after a step and its controls [K].
        state: the start.
        terminal_cost: of the last states [K].
    """

    def cost_of(controls: Float[Tensor, "K T U"]) -> Float[Tensor, " K"]:
        states, total = state.expand(len(controls), -1), controls.new_zeros(len(controls))
        for control in controls.unbind(dim=1):
            states = dynamics(states, control)
            total = total + running_cost(states, control).reshape(-1)
        return total if terminal_cost is None else total + terminal_cost(states).reshape(-1)

    return cost_of
