"""Spread of a prediction: scales of its position errors along and across the heading, growing along the rollout.

Every 0.2 s a network maps motion and ground to the rate at which the variance of the velocity grows. Errors of the
velocity persist, so that their standard deviations add up to that of the position. The spread never shrinks and does
not look ahead.

Errors are a bivariate Student t, whose heavy tails fit the few windows in which the vehicle slips. Standard deviations
are those of the scale matrix, along and across the predicted heading, which share their degrees of freedom.
"""

import math
from dataclasses import fields
from typing import Final

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from offpiste.core.conventions import DT, HORIZON_STEPS
from offpiste.core.state import Terrain, TerrainSource, Trajectory
from offpiste.dynamics.vehicle import Vehicle

EVERY: Final = 10
"""Steps between the moments of a spread."""

INTERVAL: Final = EVERY * DT
"""Time between the moments of a spread [s]."""

MOTION: Final = ("speed", "yaw_rate", "lateral_acceleration", "slope_along", "slope_across", "unknown")
"""Inputs besides commands and codes: magnitudes of speed [m/s], yaw rate [rad/s] and lateral acceleration [m/s²];
slopes as components of the normal (uphill positive, across as a magnitude); share of wheels on unknown ground."""

LEAST_FREEDOM: Final = 2.0
"""Lower bound of the degrees of freedom, so that a variance exists."""


def states_at_moments(start: Float[Tensor, "B 6"], trajectory: Trajectory) -> Float[Tensor, "B K 6"]:
    """Return the states at the moments of a spread: the start, and every `EVERY` steps except the last."""
    return torch.cat((start[:, None], trajectory.state[:, EVERY - 1 : -1 : EVERY]), dim=1)


def spread_inputs(
    vehicle: Vehicle, state: Float[Tensor, "B K 6"], control: Float[Tensor, "B K U"], terrain: Terrain
) -> Float[Tensor, "B K I"]:
    """Return the network's inputs at every moment: `MOTION`, present commands, mean code under the wheels.

    Args:
        control: command from each moment on.
        terrain: under the wheels, with the model's codes.
    """
    _, _, yaw, vx, vy, yaw_rate = state.unbind(dim=-1)
    known = terrain.known.to(vx.dtype)
    share = known.mean(dim=-1)
    normal = (terrain.normal * known[..., None]).sum(dim=-2) / known.sum(dim=-1).clamp(min=1)[..., None]
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    along = -(cos * normal[..., 0] + sin * normal[..., 1])
    across = sin * normal[..., 0] - cos * normal[..., 1]
    motion = (torch.hypot(vx, vy), yaw_rate.abs(), (vx * yaw_rate).abs(), along, across.abs(), 1 - share)
    present = [vehicle.control_columns.index(name) for name in vehicle.control]
    return torch.cat((torch.stack(motion, dim=-1), control[..., present], terrain.latent.mean(dim=-2)), dim=-1)


def inputs_along(
    vehicle: Vehicle, start: Float[Tensor, "B 6"], trajectory: Trajectory, control: Float[Tensor, "B T U"],
    source: TerrainSource,
) -> Float[Tensor, "B K I"]:  # fmt: skip
    """Return the network's inputs along a rollout.

    Args:
        start: state before the first step.
        control: of each step, in the vehicle's columns.
        source: terrain of the rollout.
    """
    state = states_at_moments(start, trajectory)
    read = [source.at(EVERY * k, moment) for k, moment in enumerate(state.unbind(dim=1))]
    terrain = Terrain(*(torch.stack([getattr(each, f.name) for each in read], dim=1) for f in fields(Terrain)))
    return spread_inputs(vehicle, state, control[:, ::EVERY], terrain)


class Spread(nn.Module):
    """Scales and degrees of freedom of a model's position errors.

    Args:
        inputs: number of inputs I (`inputs_of`).
        hidden: units of the network's layer.
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
        """Return scales along and across the heading, `INTERVAL` after each moment [m]."""
        return self._velocity(inputs).cumsum(dim=1) * INTERVAL

    def at_every_step(self, inputs: Float[Tensor, "B K I"]) -> Float[Tensor, "B _ 2"]:
        """Return scales after every step, `EVERY` per moment [m]."""
        return self._velocity(inputs).repeat_interleave(EVERY, dim=1).cumsum(dim=1) * DT

    def _velocity(self, inputs: Float[Tensor, "B K I"]) -> Float[Tensor, "B K 2"]:
        """Return scales of the velocity in the interval after each moment [m/s]."""
        rate = functional.softplus(self.layers((inputs - self.mean) / self.deviation))  # m/s^1.5
        begin = functional.softplus(self.start).square()
        return self.factor * (begin + rate.square().cumsum(dim=1) * INTERVAL).sqrt()

    def standardise_on(self, inputs: Float[Tensor, "B K I"]) -> None:
        """Store mean and deviation of training inputs; an input that hardly varies is not scaled."""
        flat = inputs.flatten(0, 1).double()
        deviation = flat.std(dim=0)
        self.mean.copy_(flat.mean(dim=0))
        self.deviation.copy_(torch.where(deviation > 1e-4, deviation, torch.ones_like(deviation)))


def inputs_of(vehicle: Vehicle, codes: int) -> int:
    """Return the number of inputs for a vehicle.

    Args:
        codes: length of the model's code.
    """
    return len(MOTION) + len(vehicle.control) + codes


def errors_in_heading(predicted: Float[Tensor, "B T 6"], target: Float[Tensor, "B T 6"]) -> Float[Tensor, "B K 2"]:
    """Return position errors along and across the predicted heading, every `INTERVAL` [m]."""
    at = slice(EVERY - 1, HORIZON_STEPS, EVERY)
    yaw, difference = predicted[:, at, 2], (target - predicted)[:, at, :2]
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    x, y = difference.unbind(dim=-1)
    return torch.stack((cos * x + sin * y, cos * y - sin * x), dim=-1)


def negative_log_likelihood(
    error: Float[Tensor, "*B 2"], scale: Float[Tensor, "*B 2"], freedom: Float[Tensor, ""]
) -> Float[Tensor, "*B"]:
    """Return the negative log-likelihood of errors under a bivariate t with `freedom` > 0 degrees of freedom.

    Args:
        error, scale: along and across [m].
    """
    tail = (freedom / 2 + 1) * torch.log1p((error / scale).square().sum(dim=-1) / freedom)
    return math.log(2 * math.pi) + scale.log().sum(dim=-1) + tail


def probability_within(squared: Float[np.ndarray, "*B"], freedom: float) -> Float[np.ndarray, "*B"]:
    """Return the probability of the region up to a squared distance from zero, in units of the scales."""
    return np.asarray(1 - (1 + squared / freedom) ** (-freedom / 2))


def radius(probability: float, freedom: float) -> float:
    """Return the radius of the region with a probability, in units of the scales."""
    return math.sqrt(freedom * ((1 - probability) ** (-2 / freedom) - 1))
