"""What the stages hand to each other: the past of a vehicle, the ground under it, its running state, its future."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class Terrain:
    """The ground under each wheel at one or several moments.

    Attributes:
        normal: unit surface normals in the world frame.
        latent: encoded terrain features, missing ones already filled; E = 0 for models without features.
    """

    normal: Float[Tensor, "*batch 4 3"]
    latent: Float[Tensor, "*batch 4 E"]


@dataclass(frozen=True)
class History:
    """The rows t-10 ... t-1 before a prediction; row t itself enters as the first step's input.

    Attributes:
        state: px, py [m], yaw [rad], vx, vy [m/s], yaw rate [rad/s].
        actuators: brake [0..1], steer [rad], steer rate [rad/s], engine [1000 rev/min]; NaN where absent.
        control: throttle [0..1], brake [0..1], steer [-1..1]; NaN where absent.
        extra: columns beyond these by name (`offpiste.dataset.columns`).
    """

    state: Float[Tensor, "B H 6"]
    actuators: Float[Tensor, "B H 4"]
    control: Float[Tensor, "B H 3"]
    terrain: Terrain
    extra: Mapping[str, Float[Tensor, "B H ..."]] = field(default_factory=dict)


@dataclass(frozen=True)
class ModelState:
    """All that a model remembers from one step to the next.

    Attributes:
        state: px, py [m], yaw [rad], vx, vy [m/s], yaw rate [rad/s].
        actuators: brake [0..1], steer [rad], steer rate [rad/s], engine [1000 rev/min]; NaN where absent.
        hidden, cell: recurrent state.
    """

    state: Float[Tensor, "B 6"]
    actuators: Float[Tensor, "B 4"]
    hidden: Float[Tensor, "B H"]
    cell: Float[Tensor, "B H"]

    def pack(self) -> Float[Tensor, "B P"]:
        """All of it in one row of P = 10 + 2 H numbers, as planners of other people want it."""
        return torch.cat((self.state, self.actuators, self.hidden, self.cell), dim=-1)

    @staticmethod
    def unpack(packed: Float[Tensor, "B P"]) -> "ModelState":
        """The inverse of `pack`."""
        size = (packed.shape[-1] - 10) // 2
        state, actuators, hidden, cell = packed.split((6, 4, size, size), dim=-1)
        return ModelState(state, actuators, hidden, cell)


@dataclass(frozen=True)
class Trajectory:
    """States and actuators after each step: index t holds time (t + 1) dt after the start."""

    state: Float[Tensor, "B T 6"]
    actuators: Float[Tensor, "B T 4"]


@runtime_checkable
class TerrainSource(Protocol):
    """Where a rollout asks for the ground under the wheels."""

    def at(self, t: int, state: Float[Tensor, "B 6"]) -> Terrain:
        """Ground at step `t` for a vehicle in `state`; fields are [B, 4, ...]."""
        ...


@dataclass(frozen=True)
class RecordedTerrain:
    """The ground that was under the recorded wheels: uses the step, not the predicted place."""

    terrain: Terrain

    def at(self, t: int, state: Float[Tensor, "B 6"]) -> Terrain:
        """Row `t` of the record; `state` is not looked at."""
        return Terrain(self.terrain.normal[:, t], self.terrain.latent[:, t])
