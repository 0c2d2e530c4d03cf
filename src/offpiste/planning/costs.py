"""Terms of the cost of driving, each a function of plain scalars: cost per second at one moment.

Like the physics (`dynamics.bicycle`) they are written once. With torch's `maximum` and tensors they are the reference;
Numba compiles the same functions into the fused kernel with its own. Hence arithmetic only, and no numbers: a literal
would make float32 lanes float64; x - x is 0, or NaN. What is not finite makes the cost not finite, and the trajectory
infinitely dear.

The cost of driving: the terms of `terms` along predicted trajectories. The eager reference.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from offpiste.conventions import DT, GRAVITY
from offpiste.geometry import rotate_by_minus_yaw
from offpiste.mapping.terrain_sampler import MapStack, sample_maps
from offpiste.planning.cost_map import CostMap
from offpiste.state import Trajectory

Scalar = Any
"""A number or a tensor of any shape."""

Maximum = Callable[[Scalar, Scalar], Scalar]


def path_term(distance: Scalar, weight: Scalar) -> Scalar:
    """Being off the path: weight distance^2.

    Args:
        distance: to the path [m].
        weight: [1/s per m^2].
    """
    return weight * distance * distance


def speed_term(
    yaw: tuple[Scalar, Scalar],
    vx: Scalar,
    vy: Scalar,
    direction: tuple[Scalar, Scalar],
    target: Scalar,
    weight: Scalar,
) -> Scalar:
    """Going along the course slower or faster than wanted: weight (v_along - target)^2.

    Args:
        yaw: its cosine and sine.
        vx, vy: of the body [m/s].
        direction: of the course, a unit vector in the world.
        target: speed along the course [m/s].
        weight: [1/s per (m/s)^2].
    """
    cos, sin = yaw
    x, y = direction
    along = (cos * vx - sin * vy) * x + (sin * vx + cos * vy) * y
    return weight * (along - target) * (along - target)


def overspeed_term(vx: Scalar, limit: Scalar, weight: Scalar, maximum: Maximum) -> Scalar:
    """Going faster than rough ground allows: weight (|vx| - limit)^2 above the limit.

    Args:
        vx, limit: [m/s]; the limit may be infinite.
        weight: [1/s per (m/s)^2].
    """
    above = maximum(maximum(vx, -vx) - limit, vx - vx)
    return weight * above * above


def lateral_ratio(
    acceleration: Scalar, normal_y: Scalar, normal_z: Scalar, gravity: Scalar, least: Scalar, maximum: Maximum
) -> Scalar:
    """Lateral over vertical acceleration as the vehicle feels them on its ground.

    A vehicle rolls over where this passes track width / (2 height of the centre of mass), its static stability factor
    (NHTSA, 2000). The specific force in the body's lateral plane is (a_y, g); along the ground's lateral tangent and
    its normal it has the parts a_y n_z - g n_y and a_y n_y + g n_z. On level ground the ratio is |a_y| / g, at rest on
    a side slope its rise over run. The ground's curvature along the path is left out.

    Args:
        acceleration: a_y, of the pose point in the horizontal plane, + left [m/s^2].
        normal_y, normal_z: of the ground, turned by minus yaw; normal_y > 0 where the ground falls to the left.
        gravity: [m/s^2].
        least: vertical acceleration that less is counted as, so that lifting off is dear and not negative [m/s^2].
    """
    lateral = acceleration * normal_z - gravity * normal_y
    vertical = acceleration * normal_y + gravity * normal_z
    return maximum(lateral, -lateral) / maximum(vertical, least)


def rollover_term(ratio: Scalar, limit: Scalar, weight: Scalar, maximum: Maximum) -> Scalar:
    """Nearly rolling over: weight (1 + excess) beyond a limit, at once: a hard penalty.

    Args:
        ratio: from `lateral_ratio`.
        limit: that is still safe, e.g. 0.7 of the static stability factor.
        weight: [1/s].
    """
    return weight * (ratio > limit) + weight * maximum(ratio - limit, ratio - ratio)


def effort_term(control: Scalar, weight: Scalar) -> Scalar:
    """Using a control: weight control^2 [1/s]."""
    return weight * control * control


def jerk_term(control: Scalar, before: Scalar, dt: Scalar, weight: Scalar) -> Scalar:
    """Changing a control: weight (change per second)^2.

    Args:
        control, before: in this step and in the one before.
        dt: a step [s].
        weight: [1/s per (1/s)^2].
    """
    rate = (control - before) / dt
    return weight * rate * rate


@dataclass(frozen=True)
class Weights:
    """What matters how much.

    Attributes:
        path: [1/s per m^2].
        speed: along the course [1/s per (m/s)^2].
        overspeed: over the ground's speed limit [1/s per (m/s)^2].
        rollover: beyond `lateral_limit` [1/s].
        lateral_limit: lateral over vertical acceleration that is safe.
        least_vertical: see `lateral_ratio` [m/s^2].
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
    normal = sample_maps(situation.ground, zeros, places, situation.offset.expand_as(places)).normal.mean(dim=-2)
    wheel = situation.costs.at(places, situation.offset)
    course = situation.costs.at(state[..., :2], situation.offset)

    acceleration = (vy - vy_before) / DT + vx * yaw_rate
    normal = rotate_by_minus_yaw(normal, yaw)
    ratio = lateral_ratio(acceleration, normal[..., 1], normal[..., 2], GRAVITY, weights.least_vertical, _maximum)
    return Terms(
        path=path_term(course[..., 2], weights.path),
        speed=speed_term(
            (torch.cos(yaw), torch.sin(yaw)), vx, vy, (course[..., 3], course[..., 4]), course[..., 5], weights.speed
        ),
        overspeed=overspeed_term(vx, wheel[..., 1].amin(dim=-1), weights.overspeed, _maximum),
        hazard=wheel[..., 0].mean(dim=-1),
        rollover=rollover_term(ratio, weights.lateral_limit, weights.rollover, _maximum),
        effort=effort_term(control, control.new_tensor(weights.effort)).sum(dim=-1),
        jerk=jerk_term(control, before, DT, control.new_tensor(weights.jerk)).sum(dim=-1),
    )


def _maximum(a: Tensor, b: Tensor | float) -> Tensor:
    return torch.maximum(a, torch.as_tensor(b, dtype=a.dtype, device=a.device))


def _wheel_places(state: Float[Tensor, "*P 6"], wheels: Float[Tensor, "4 2"]) -> Float[Tensor, "*P 4 2"]:
    px, py, yaw = (column[..., None] for column in state[..., :3].unbind(dim=-1))
    x, y = wheels.to(state.dtype).unbind(dim=-1)
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    return torch.stack((px + cos * x - sin * y, py + sin * x + cos * y), dim=-1)
