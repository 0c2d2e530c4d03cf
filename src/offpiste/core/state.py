"""Data passed between stages: history, terrain, model state, predicted trajectory."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from offpiste.core.conventions import ACTUATORS, STATE


def wrap_angle(angle: Tensor) -> Tensor:
    """Wrap an angle to [-pi, pi] [rad], differentiably."""
    return torch.atan2(torch.sin(angle), torch.cos(angle))


@dataclass(frozen=True)
class Terrain:
    """Terrain under each wheel at one or several times."""

    normal: Float[Tensor, "*batch 4 3"]  # unit surface normals in the world frame; straight up if not `known`
    known: Bool[Tensor, "*batch 4"]  # validity of the normals
    latent: Float[Tensor, "*batch 4 E"]  # encoded features, missing ones filled; E = 0 for models without features

    def rows(self, part: slice | int) -> "Terrain":
        """Select rows of a batch whose fields are [B, R, 4, ...]; one row gives [B, 4, ...]."""
        return Terrain(self.normal[:, part], self.known[:, part], self.latent[:, part])

    @staticmethod
    def of(normal: Float[Tensor, "*batch 4 3"]) -> "Terrain":
        """Make terrain without features from normals, which are NaN if unknown."""
        known = normal.isfinite().all(dim=-1)
        straight_up = normal.new_tensor([0.0, 0.0, 1.0])
        return Terrain(torch.where(known[..., None], normal, straight_up), known, normal[..., :0])


@dataclass(frozen=True)
class History:
    """Rows t-10 ... t-1 before a prediction; row t is the input of the first step."""

    state: Float[Tensor, "B H 6"]  # `conventions.STATE`
    actuators: Float[Tensor, "B H A"]  # in the columns of `Vehicle.actuator_columns`; NaN where absent
    control: Float[Tensor, "B H U"]  # in the columns of `Vehicle.control_columns`; NaN where absent
    terrain: Terrain
    extra: Mapping[str, Float[Tensor, "B H ..."]] = field(default_factory=dict)  # others (`offpiste.dataset.columns`)


@dataclass(frozen=True)
class ModelState:
    """State of a model between two steps."""

    state: Float[Tensor, "B 6"]  # `conventions.STATE`
    actuators: Float[Tensor, "B A"]  # in the columns of `Vehicle.actuator_columns`; NaN where absent
    recurrent: Float[Tensor, "B R"]  # states of the model's networks, which only these can read

    def pack(self) -> Float[Tensor, "B P"]:
        """Return one row of P = 6 + A + R numbers per sample, for planners whose state is a vector."""
        return torch.cat((self.state, self.actuators, self.recurrent), dim=-1)

    @staticmethod
    def unpack(packed: Float[Tensor, "B P"], actuators: int = len(ACTUATORS)) -> "ModelState":
        """Return the model state of packed rows with this number of actuator columns."""
        return ModelState(*packed.tensor_split((len(STATE), len(STATE) + actuators), dim=-1))


@dataclass(frozen=True)
class Trajectory:
    """States and actuators after each step; index t is at time (t + 1) dt after the start."""

    state: Float[Tensor, "B T 6"]
    actuators: Float[Tensor, "B T A"]


@runtime_checkable
class TerrainSource(Protocol):
    """Source of the terrain under the wheels in a rollout."""

    def at(self, t: int, state: Float[Tensor, "B 6"]) -> Terrain:
        """Return the terrain at step `t` for a vehicle in `state`; fields are [B, 4, ...]."""
        ...


@dataclass(frozen=True)
class RecordedTerrain:
    """Terrain under the recorded wheels, looked up by time step instead of position."""

    terrain: Terrain

    def at(self, t: int, state: Float[Tensor, "B 6"]) -> Terrain:
        """Return row `t`; `state` is ignored."""
        return self.terrain.rows(t)
