"""Costs of driving in torch, by rollouts of any model; the reference of the kernel."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.core.conventions import CONTROL, DT, GRAVITY
from offpiste.core.state import ModelState, TerrainSource, Trajectory
from offpiste.dynamics.base import Dynamics, rollout
from offpiste.mapping.terrain_map import wheel_positions_of_states
from offpiste.mapping.terrain_sampler import Encode, MapStack, MapTerrain, sample_maps
from offpiste.planning.caution import Caution, position_margins
from offpiste.planning.controls import complete
from offpiste.planning.costs.declaration import CostTerm, Scalar, cost_terms, evaluate
from offpiste.planning.costs.layers import CostMap
from offpiste.planning.costs.weights import CostWeights
from offpiste.planning.mppi import CostOf


@dataclass(frozen=True)
class Situation:
    """Map, costs, state and last control at the start of a plan.

    Attributes:
        ground: stack of one terrain map, for the normals.
        costs: cost map.
        wheels: positions in the body frame, from the pose point [m].
        offset: origin of the trajectories' frame in the world frame [m] (float64).
        state: state at the start.
        control: control of the step before the start.
        gear: gear held during the plan, for models with a gear.
        caution: margins for position errors; None for none.
    """

    ground: MapStack
    costs: CostMap
    wheels: Float[Tensor, "4 2"]
    offset: Float[Tensor, " 2"]
    state: Float[Tensor, " 6"]
    control: Float[Tensor, " 3"]
    gear: float = 1.0
    caution: Caution | None = None


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


def driving_cost(
    trajectory: Trajectory,
    controls: Float[Tensor, "K T 3"],
    situation: Situation,
    weights: CostWeights,
    margins: Float[Tensor, "K T 2"] | None = None,
) -> Float[Tensor, " K"]:
    """Return the sum of all terms over time; not finite for trajectories with non-finite states.

    Args:
        margins: margins for position errors along and across the heading [m]; None for none.
    """
    terms = driving_terms(trajectory, controls, situation, weights, margins)
    return DT * torch.stack(tuple(terms.values())).sum(dim=(0, 2))


def driving_terms(
    trajectory: Trajectory,
    controls: Float[Tensor, "K T 3"],
    situation: Situation,
    weights: CostWeights,
    margins: Float[Tensor, "K T 2"] | None = None,
) -> dict[str, Float[Tensor, "K T"]]:
    """Return the cost per second of each term after each step, by name."""
    velocity = trajectory.state[..., 3:5]
    velocity_before = torch.cat((situation.state[3:5].expand(len(velocity), 1, 2), velocity[:, :-1]), dim=1)
    control_before = torch.cat((situation.control.expand(len(controls), 1, 3), controls[:, :-1]), dim=1)
    return terms_after(trajectory.state, velocity_before, controls, control_before, situation, weights, margins)


def terms_after(
    state: Float[Tensor, "*B 6"],
    velocity_before: Float[Tensor, "*B 2"],
    control: Float[Tensor, "*B 3"],
    control_before: Float[Tensor, "*B 3"],
    situation: Situation,
    weights: CostWeights,
    margins: Float[Tensor, "*B 2"] | None = None,
) -> dict[str, Float[Tensor, "*B"]]:
    """Return the cost per second of each term after single steps.

    Args:
        state: state after a step.
        velocity_before: vx, vy before the step [m/s].
        control, control_before: controls of the step, and of the step before.
        situation: its state, control and caution are ignored.
        margins: see `driving_cost`.
    """
    numbers, terms = weights.values(), cost_terms()
    parameters = {name: numbers[name] for term in terms.values() for name in term.parameters}
    motion = _motion(state, velocity_before, control, situation, margins) | parameters
    controls: dict[str, Scalar] = {"control": control, "control_before": control_before, "dt": DT, "maximum": _maximum}
    controls |= {name: control.new_tensor(value) for name, value in parameters.items() if isinstance(value, tuple)}

    def cost(term: CostTerm) -> Tensor:
        weight = numbers.get(term.name)
        if term.of_controls:
            each = None if weight is None else control.new_tensor(weight)
            value: Tensor = evaluate(term.function, controls | {"weight": each}).sum(dim=-1)
            return value
        motion["weight"] = weight
        return evaluate(term.function, motion)

    return {name: cost(term) for name, term in terms.items()}


def _motion(
    state: Tensor, velocity_before: Tensor, control: Tensor, situation: Situation, margins: Tensor | None
) -> dict[str, Scalar]:
    """Return base quantities of the motion, layers and elementary functions by name."""
    _, _, yaw, vx, vy, yaw_rate = state.unbind(-1)
    wheels = wheel_positions_of_states(state, situation.wheels)
    zeros = torch.zeros(wheels.shape[:-1], dtype=torch.long, device=wheels.device)
    normal = sample_maps(situation.ground, zeros, wheels, situation.offset.expand_as(wheels)).normal.mean(dim=-2)
    given: dict[str, Scalar] = dict(
        zip(("world_normal_x", "world_normal_y", "world_normal_z"), normal.unbind(-1), strict=True)
    )
    given |= dict(zip(("throttle", "brake", "steer"), control.unbind(-1), strict=True))
    given |= {"vx": vx, "vy": vy, "yaw_rate": yaw_rate, "cos_yaw": torch.cos(yaw), "sin_yaw": torch.sin(yaw)}
    margins = torch.zeros_like(state[..., :2]) if margins is None else margins
    given |= dict(zip(("margin_along", "margin_across"), margins.unbind(-1), strict=True))
    given |= {"vx_before": velocity_before[..., 0], "vy_before": velocity_before[..., 1], "dt": DT, "gravity": GRAVITY}
    functions = {"maximum": _maximum, "sin": torch.sin, "cos": torch.cos, "tanh": torch.tanh, "atan": torch.atan}
    return given | functions | _layers(state[..., :2], wheels, situation)


def _layers(place: Float[Tensor, "*B 2"], wheels: Float[Tensor, "*B 4 2"], situation: Situation) -> dict[str, Tensor]:
    """Return the values of the cost layers at the places of their declarations, by name."""
    costs = situation.costs
    under, here = costs.at(wheels, situation.offset), costs.at(place, situation.offset)
    return {
        layer.name: {
            "mean of wheels": lambda column: under[..., column].mean(dim=-1),
            "least of wheels": lambda column: under[..., column].amin(dim=-1),
            "pose point": lambda column: here[..., column],
        }[layer.read](column)
        for column, layer in enumerate(costs.table)
    }


def _maximum(a: Tensor, b: Tensor | float) -> Tensor:
    return torch.maximum(a, torch.as_tensor(b, dtype=a.dtype, device=a.device))
