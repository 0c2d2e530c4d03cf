"""The cost of driving: the terms of `terms` along predicted trajectories. The eager reference."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.conventions import DT, GRAVITY
from offpiste.geometry import rotate_by_minus_yaw
from offpiste.mapping.lookup import MapStack, look_up
from offpiste.planning import terms
from offpiste.planning.course import CostMap
from offpiste.trajectory import Trajectory


@dataclass(frozen=True)
class Weights:
    """What matters how much.

    Attributes:
        path: [1/s per m^2].
        speed: along the course [1/s per (m/s)^2].
        overspeed: over the ground's speed limit [1/s per (m/s)^2].
        rollover: beyond `lateral_limit` [1/s].
        lateral_limit: lateral over vertical acceleration that is safe.
        least_vertical: see `terms.lateral_ratio` [m/s^2].
        effort: of throttle, brake, steer [1/s].
        jerk: of throttle, brake, steer [1/s per (1/s)^2].
    """

    path: float = 1.0
    speed: float = 1.0
    overspeed: float = 2.0
    rollover: float = 1000.0
    lateral_limit: float = 0.7
    least_vertical: float = 1.0
    effort: tuple[float, float, float] = (0.0, 0.2, 0.2)
    jerk: tuple[float, float, float] = (0.02, 0.02, 0.05)


@dataclass(frozen=True)
class Situation:
    """Where and how a plan begins.

    Attributes:
        ground: a stack of one map, for the normals.
        costs: hazards and course.
        wheels: in the body frame, from the pose point [m].
        offset: of the frame of the trajectories in the world frame [m] (float64).
        state: at the start.
        control: commanded in the step before it.
    """

    ground: MapStack
    costs: CostMap
    wheels: Float[Tensor, "4 2"]
    offset: Float[Tensor, " 2"]
    state: Float[Tensor, " 6"]
    control: Float[Tensor, " 3"]


class Terms(NamedTuple):
    """Cost per second of each kind, after each step: [K, T], or as many as were asked for."""

    path: Tensor
    speed: Tensor
    overspeed: Tensor
    hazard: Tensor
    rollover: Tensor
    effort: Tensor
    jerk: Tensor


def driving_cost(
    trajectory: Trajectory, controls: Float[Tensor, "K T 3"], situation: Situation, weights: Weights
) -> Float[Tensor, " K"]:
    """Sum of all terms over time; not finite where a state is not."""
    return DT * torch.stack(driving_terms(trajectory, controls, situation, weights)).sum(dim=(0, 2))


def driving_terms(
    trajectory: Trajectory, controls: Float[Tensor, "K T 3"], situation: Situation, weights: Weights
) -> Terms:
    """The terms, in cost per second."""
    vy = trajectory.state[..., 4]
    vy_before = torch.cat((situation.state[4].expand(len(vy), 1), vy[:, :-1]), dim=1)
    before = torch.cat((situation.control.expand(len(controls), 1, 3), controls[:, :-1]), dim=1)
    return terms_after(trajectory.state, vy_before, controls, before, situation, weights)


def terms_after(
    state: Float[Tensor, "*B 6"],
    vy_before: Float[Tensor, "*B"],
    control: Float[Tensor, "*B 3"],
    before: Float[Tensor, "*B 3"],
    situation: Situation,
    weights: Weights,
) -> Terms:
    """The terms after single steps, for planners that ask step by step.

    Args:
        state: after a step.
        vy_before: lateral velocity before it [m/s].
        control, before: commanded during it, and during the step before.
        situation: its state and control are not read.
    """
    _, _, yaw, vx, vy, yaw_rate = state.unbind(-1)
    places = _wheel_places(state, situation.wheels)
    zeros = torch.zeros(places.shape[:-1], dtype=torch.long, device=places.device)
    normal = look_up(situation.ground, zeros, places, situation.offset.expand_as(places)).normal.mean(dim=-2)
    wheel = situation.costs.at(places, situation.offset)
    course = situation.costs.at(state[..., :2], situation.offset)

    acceleration = (vy - vy_before) / DT + vx * yaw_rate
    normal = rotate_by_minus_yaw(normal, yaw)
    ratio = terms.lateral_ratio(acceleration, normal[..., 1], normal[..., 2], GRAVITY, weights.least_vertical, _maximum)
    return Terms(
        path=terms.path_term(course[..., 2], weights.path),
        speed=terms.speed_term(
            (torch.cos(yaw), torch.sin(yaw)), vx, vy, (course[..., 3], course[..., 4]), course[..., 5], weights.speed
        ),
        overspeed=terms.overspeed_term(vx, wheel[..., 1].amin(dim=-1), weights.overspeed, _maximum),
        hazard=wheel[..., 0].mean(dim=-1),
        rollover=terms.rollover_term(ratio, weights.lateral_limit, weights.rollover, _maximum),
        effort=terms.effort_term(control, control.new_tensor(weights.effort)).sum(dim=-1),
        jerk=terms.jerk_term(control, before, DT, control.new_tensor(weights.jerk)).sum(dim=-1),
    )


def _maximum(a: Tensor, b: Tensor | float) -> Tensor:
    return torch.maximum(a, torch.as_tensor(b, dtype=a.dtype, device=a.device))


def _wheel_places(state: Float[Tensor, "*P 6"], wheels: Float[Tensor, "4 2"]) -> Float[Tensor, "*P 4 2"]:
    px, py, yaw = (column[..., None] for column in state[..., :3].unbind(dim=-1))
    x, y = wheels.to(state.dtype).unbind(dim=-1)
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    return torch.stack((px + cos * x - sin * y, py + sin * x + cos * y), dim=-1)
