"""The spread of a prediction: how far its positions stray along and across the heading, grown along the rollout.

A network says at every 0.2 s, from what the vehicle does and what ground it is on, how fast the velocity becomes
unsure. These variances add up to that of the velocity; errors of a velocity last, so their standard deviations add up
to that of the position. It never shrinks, it costs next to nothing beside the rollout, and nothing in it looks ahead.
"""

from dataclasses import dataclass, fields
from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from offpiste.core.conventions import DT, HORIZON_STEPS
from offpiste.core.state import Terrain, TerrainSource, Trajectory
from offpiste.dynamics.vehicle import Vehicle

EVERY: Final = 10
"""Steps between two moments at which the spread is known."""

INTERVAL: Final = EVERY * DT
"""Time between them [s]."""

MOTION: Final = ("speed", "yaw_rate", "lateral_acceleration", "slope_along", "slope_across", "unknown")
"""Inputs beside commands and codes: speed [m/s], yaw rate [rad/s] and lateral acceleration [m/s²] without their signs,
slopes as components of the normal (uphill positive, across without sign), and the share of wheels on unknown ground."""

LEAST_FREEDOM: Final = 2.0
"""Degrees of freedom stay above it, so that a variance exists."""


@dataclass(frozen=True)
class Moments:
    """A rollout at every `EVERY` steps from its start on.

    Attributes:
        state: [m, rad, m/s, rad/s].
        control: commanded from there on.
        terrain: under the wheels there, with the model's codes.
    """

    state: Float[Tensor, "B K 6"]
    control: Float[Tensor, "B K U"]
    terrain: Terrain


def states_at_moments(start: Float[Tensor, "B 6"], trajectory: Trajectory) -> Float[Tensor, "B K 6"]:
    """States at which the spread's inputs are read: the start, and every `EVERY` steps after it but the last."""
    return torch.cat((start[:, None], trajectory.state[:, EVERY - 1 : -1 : EVERY]), dim=1)


def spread_inputs(vehicle: Vehicle, moments: Moments) -> Float[Tensor, "B K I"]:
    """What the spread's network reads at every moment: `MOTION`, commands, the mean code under the wheels.

    Commands that the log lacks are not read.
    """
    _, _, yaw, vx, vy, yaw_rate = moments.state.unbind(dim=-1)
    known = moments.terrain.known.to(vx.dtype)
    share = known.mean(dim=-1)
    normal = (moments.terrain.normal * known[..., None]).sum(dim=-2) / known.sum(dim=-1).clamp(min=1)[..., None]
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    along = -(cos * normal[..., 0] + sin * normal[..., 1])
    across = sin * normal[..., 0] - cos * normal[..., 1]
    motion = (torch.hypot(vx, vy), yaw_rate.abs(), (vx * yaw_rate).abs(), along, across.abs(), 1 - share)
    present = [vehicle.control_columns.index(name) for name in vehicle.control]
    read = (torch.stack(motion, dim=-1), moments.control[..., present], moments.terrain.latent.mean(dim=-2))
    return torch.cat(read, dim=-1)


def inputs_along(
    vehicle: Vehicle, start: Float[Tensor, "B 6"], trajectory: Trajectory, control: Float[Tensor, "B T U"],
    source: TerrainSource,
) -> Float[Tensor, "B K I"]:  # fmt: skip
    """What the spread's network reads along a rollout.

    Args:
        start: state before the first step.
        control: of each step, in the vehicle's columns.
        source: terrain of the rollout.
    """
    state = states_at_moments(start, trajectory)
    read = [source.at(EVERY * k, moment) for k, moment in enumerate(state.unbind(dim=1))]
    terrain = Terrain(*(torch.stack([getattr(each, f.name) for each in read], dim=1) for f in fields(Terrain)))
    return spread_inputs(vehicle, Moments(state, control[:, ::EVERY], terrain))


class Spread(nn.Module):
    """Scales and degrees of freedom of a model's errors of position (`student`).

    Args:
        inputs: I, how many (`inputs_of`).
        hidden: units of the network's layer.

    Attributes:
        hidden: as given.
    """

    mean: Tensor
    deviation: Tensor
    factor: Tensor

    def __init__(self, inputs: int, *, hidden: int = 32) -> None:
        super().__init__()
        self.hidden = hidden
        self.layers = nn.Sequential(nn.Linear(inputs, hidden), nn.Tanh(), nn.Linear(hidden, 2))
        self.start = nn.Parameter(torch.full((2,), -2.0))
        self.tail = nn.Parameter(torch.tensor(1.0))
        self.register_buffer("mean", torch.zeros(inputs))
        self.register_buffer("deviation", torch.ones(inputs))
        self.register_buffer("factor", torch.ones(()))

    @property
    def freedom(self) -> Float[Tensor, ""]:
        """Degrees of freedom of the errors."""
        return LEAST_FREEDOM + functional.softplus(self.tail)

    def forward(self, inputs: Float[Tensor, "B K I"]) -> Float[Tensor, "B K 2"]:
        """Scales along and across the heading, `INTERVAL` after each moment [m]."""
        return self._velocity(inputs).cumsum(dim=1) * INTERVAL

    def at_every_step(self, inputs: Float[Tensor, "B K I"]) -> Float[Tensor, "B _ 2"]:
        """The same after every step [m], `EVERY` to a moment."""
        return self._velocity(inputs).repeat_interleave(EVERY, dim=1).cumsum(dim=1) * DT

    def _velocity(self, inputs: Float[Tensor, "B K I"]) -> Float[Tensor, "B K 2"]:
        """Scales of the velocity during the interval after each moment [m/s]."""
        rate = functional.softplus(self.layers((inputs - self.mean) / self.deviation))  # m/s^1.5
        begin = functional.softplus(self.start).square()
        return self.factor * (begin + rate.square().cumsum(dim=1) * INTERVAL).sqrt()

    def standardise_on(self, inputs: Float[Tensor, "B K I"]) -> None:
        """Take mean and deviation of training inputs; one that hardly varies keeps its unit."""
        flat = inputs.flatten(0, 1).double()
        deviation = flat.std(dim=0)
        self.mean.copy_(flat.mean(dim=0))
        self.deviation.copy_(torch.where(deviation > 1e-4, deviation, torch.ones_like(deviation)))


def inputs_of(vehicle: Vehicle, codes: int) -> int:
    """How many inputs the spread of a vehicle's model has.

    Args:
        codes: length of the model's code.
    """
    return len(MOTION) + len(vehicle.control) + codes


def errors_in_heading(predicted: Float[Tensor, "B T 6"], target: Float[Tensor, "B T 6"]) -> Float[Tensor, "B K 2"]:
    """Errors of position along and across the predicted heading, every `INTERVAL` [m]."""
    at = slice(EVERY - 1, HORIZON_STEPS, EVERY)
    yaw, difference = predicted[:, at, 2], (target - predicted)[:, at, :2]
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    x, y = difference.unbind(dim=-1)
    return torch.stack((cos * x + sin * y, cos * y - sin * x), dim=-1)
