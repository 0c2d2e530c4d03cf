"""Costs of control sequences by rollouts in torch, for any model; the reference of the kernel."""

import torch
from torch import Tensor

from offpiste.core.conventions import CONTROL
from offpiste.core.state import ModelState, TerrainSource
from offpiste.dynamics.base import Dynamics, rollout
from offpiste.mapping.terrain_sampler import Encode, MapTerrain
from offpiste.planning.caution import position_margins
from offpiste.planning.controls import complete
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.driving_cost import Situation, driving_cost
from offpiste.planning.mppi import CostOf


def driving_costs(
    dynamics: Dynamics,
    model_state: ModelState,
    situation: Situation,
    weights: CostWeights,
    encode: Encode | None = None,
) -> CostOf:
    """Return a function that computes the costs of driving on the map of a situation.

    Args:
        model_state: model state at the start, a batch of one.
        encode: encoder of the map's features, `terrain_sampler.as_codes` for a map of codes, or None for models
            without features.
    """

    def cost_of(controls: Tensor) -> Tensor:
        count, margins = len(controls), None
        source = situation_terrain(situation, count, encode)
        controls = complete(dynamics.vehicle, controls, situation.gear)
        trajectory = rollout(dynamics, spread_model_state(model_state, count), controls, source)
        if situation.caution is not None:
            start = situation.state.expand(count, 6)
            margins = position_margins(situation.caution, dynamics.vehicle, start, trajectory, controls, source)
        return driving_cost(trajectory, controls[..., : len(CONTROL)], situation, weights, margins)

    return cost_of


def situation_terrain(situation: Situation, samples: int, encode: Encode | None = None) -> TerrainSource:
    """Return the terrain of a situation's map for `samples` rollouts."""
    number = torch.zeros(samples, dtype=torch.long, device=situation.state.device)
    offset = situation.offset.expand(samples, 2)
    return MapTerrain(situation.ground, number, offset, situation.wheels, encode)


def spread_model_state(model_state: ModelState, samples: int) -> ModelState:
    """Repeat the model state of one rollout for `samples` rollouts."""
    return ModelState(*(part.expand(samples, -1) for part in vars(model_state).values()))
