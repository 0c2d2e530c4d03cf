"""Scalar physics on batches of tensors, and the learned constants as a module."""

from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor, nn

from offpiste.core.channels import absent_value
from offpiste.core.conventions import DT
from offpiste.core.errors import DatasetError
from offpiste.core.state import Terrain
from offpiste.dynamics import bicycle
from offpiste.dynamics.bicycle import (
    RANGES,
    Constants,
    DriveTrain,
    Elementary,
    Force,
    constrained,
    forces,
    rates,
    reduced_inputs,
)
from offpiste.dynamics.vehicle import Vehicle

TORCH: Final = Elementary(torch.sin, torch.cos, torch.tanh, torch.atan, torch.maximum)
"""Elementary functions of tensors."""

UNKNOWN: Final = 1
"""Number of columns of `unknown_normals`."""


class BicycleConstants(nn.Module):
    """Unconstrained parameters of the bicycle, mapped by a sigmoid into the interval of each constant."""

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__()
        self.mass, self.wheelbase = vehicle.mass, vehicle.wheelbase
        columns = zip(*RANGES.values(), strict=True)
        low, high, initial = (torch.tensor(column, dtype=torch.float64) for column in columns)
        self.low: Tensor
        self.width: Tensor
        self.register_buffer("low", low.float(), persistent=False)
        self.register_buffer("width", (high - low).float(), persistent=False)
        self.raw = nn.Parameter(torch.logit((initial - low) / (high - low)).float())

    def forward(self) -> Constants:
        """Return the constants, each a scalar tensor."""
        scaled = self.low + self.width * torch.sigmoid(self.raw)
        values = dict(zip(RANGES, scaled.unbind(), strict=True))
        return constrained(values, self.mass, self.wheelbase, TORCH)._replace(mass=self.raw.new_tensor(self.mass))


def drive_train(
    vehicle: Vehicle, state: Float[Tensor, "*B 6"], actuators: Float[Tensor, "*B A"], control: Float[Tensor, "*B U"]
) -> DriveTrain:
    """Return the inputs of the force vector: measured where an actuator measures them, else in their reduced form.

    A missing throttle or brake command is 0, a missing gear is forward. Columns of absent channels are not read.

    Raises:
        DatasetError: the vehicle has neither a steering angle nor a steering command.
    """
    if not vehicle.steers:
        raise DatasetError("neither a steering angle nor a steering command", how="give one of them in the rig")
    measured = dict(zip(vehicle.actuator_columns, actuators.unbind(-1), strict=True))
    given = dict(zip(vehicle.control_columns, control.unbind(-1), strict=True))

    def commands(name: str) -> Tensor:
        return given[name] if name in vehicle.control else torch.full_like(state[..., 0], absent_value(name))

    reduced = reduced_inputs(commands, state[..., 3], vehicle.max_steer, TORCH)
    return reduced._replace(**{name: measured[actuator] for name, actuator in vehicle.measured_inputs.items()})


def mean_normal(terrain: Terrain, yaw: Float[Tensor, "*B"]) -> Float[Tensor, "*B 3"]:
    """Return the mean surface normal under the wheels in the planar body frame (eta of eq. 1)."""
    x, y, z = terrain.normal.mean(dim=-2).unbind(-1)
    return torch.stack(bicycle.body_normal(x, y, z, yaw, TORCH), dim=-1)


def unknown_normals(terrain: Terrain) -> Float[Tensor, "*B 1"]:
    """Return the fraction of the wheels whose surface normal is unknown; these count as vertical in `mean_normal`."""
    return (~terrain.known).to(terrain.normal.dtype).mean(dim=-1, keepdim=True)


def select_present(
    vehicle: Vehicle, actuators: Float[Tensor, "*B A"], control: Float[Tensor, "*B U"]
) -> Float[Tensor, "*B P"]:
    """Return the columns of actuators and control that the log has, in order."""
    kept_actuators = [i for i, name in enumerate(vehicle.actuator_columns) if name in vehicle.actuators]
    kept_control = [i for i, name in enumerate(vehicle.control_columns) if name in vehicle.control]
    return torch.cat((actuators[..., kept_actuators], control[..., kept_control]), dim=-1)


def parametric_forces(
    constants: Constants, state: Float[Tensor, "*B 6"], inputs: DriveTrain, normal: Float[Tensor, "*B 3"]
) -> Float[Tensor, "*B 4"]:
    """Return the force vector F (eq. 1)."""
    vx, vy, yaw_rate = state[..., 3:].unbind(-1)
    return torch.stack(forces(vx, vy, yaw_rate, inputs, normal[..., 2], constants, TORCH), dim=-1)


def advance(
    constants: Constants,
    state: Float[Tensor, "B 6"],
    steer: Float[Tensor, " B"],
    normal: Float[Tensor, "B 3"],
    force: Float[Tensor, "B 4"],
) -> Float[Tensor, "B 6"]:
    """Return the state after one step: h(F, x) (eq. 4) and forward Euler."""
    yaw, vx, vy, yaw_rate = state[..., 2:].unbind(-1)
    total = Force(*force.unbind(-1))
    change = rates(yaw, vx, vy, yaw_rate, steer, normal[..., 0], normal[..., 1], total, constants, TORCH)
    return state + DT * torch.stack(change, dim=-1)
